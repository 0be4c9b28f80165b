# ---
# jupyter:
#   jupytext:
#     formats: py:percent,ipynb
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Margin, sensitivity and placement of bifurcations
#
# This notebook computes the distance from a design to the nearest bifurcation, the sensitivity of the bifurcation, and
# the smallest change of the design that moves it. It is for users who design a vibro-impact system. The example is a
# machine that runs on P111: the mass hits both stops once per drive period. The parameters are known to within
# tolerances. The design requires three results:
#
# - the change of the parameters that first ends this motion, and its size in tolerances;
# - the parameters that move the bifurcation;
# - the smallest change that moves the bifurcation to a harmless value.
#
# A located bifurcation is a root of equations and therefore has derivatives by all parameters of the scene. Each of the
# three results takes one call.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)


def keep(figure, name):
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"08_{name}.png", dpi=120)


scene = jv.make_scene(amplitude=1.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
orbit = jv.find_orbit(scene, jv.State(x=0.9, v=-1.1))
print(orbit)

# %% [markdown]
# ## The margin
#
# Each parameter has a tolerance: 0.1 for the amplitude of the drive, 0.05 for its frequency. The distance to a
# bifurcation (`margin`) is measured in tolerances, as the root of the sum of their squares.

# %%
tolerances = {"amplitude": 0.1, "frequency": 0.05}
near = jv.margin(orbit, free=tolerances)
print(near.table())

# %% [markdown]
# At the nearest point the bifurcation curve touches the ellipse of this distance. The curve is the locus of the same
# saddle-node, continued from the branch. No point of it is nearer.

# %%
branch = jv.follow(orbit, "amplitude", bounds=(0.0, 6.0))
(fold,) = branch.points("SN")
locus = jv.locus(fold, ("amplitude", "frequency"), {"amplitude": (0.1, 3.0), "frequency": (1.5, 3.0)})

figure, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
jv.plot.margin(near, ax)
jv.plot.locus(locus, ax)
ax.set(xlim=(0.0, 2.0), ylim=(1.7, 2.7))
ax.legend(fontsize="small", loc="upper right")
keep(figure, "margin")

offsets = [(locus.data[name].values - float(scene.parameter(name))) / unit for name, unit in tolerances.items()]
nearest = np.hypot(*offsets).min()
print(f"nearest computed point of the locus: {nearest:.6f}; margin: {near.distance:.6f}")
assert near.distance <= nearest

# %% [markdown]
# For more parameters the figure shows the change of each one, in its tolerances, that leads to the nearest point.

# %%
more = tolerances | {"damping": 0.01, "restitution": 0.02, "right.position": 0.02}
wide = jv.margin(orbit, free=more)
print(wide.table())
figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
jv.plot.margin(wide, ax)
keep(figure, "changes")

# %% [markdown]
# ## Sensitivity
#
# `sensitivity` computes the derivatives of the amplitude below which P111 does not exist, by all parameters of the
# scene.

# %%
print(f"the saddle-node is at A = {fold.value:.6f}")
print(jv.sensitivity(fold).to_series())

# %% [markdown]
# ## The smallest change of the design
#
# P111 should exist down to A = 0.4. `place` computes the required change of the right stop, the restitution and the
# damping.

# %%
placed = jv.place(fold, "amplitude", 0.4, free={"right.position": 0.1, "restitution": 0.05, "damping": 0.01})
print(placed.table())

# %% [markdown]
# Between the saddle-node and the amplitude at which the motion without impacts grazes, both motions are stable: there
# is hysteresis. Its width is the difference of two located points. The width is itself a function of the scene and may
# be placed too.

# %%
rest = jv.find_orbit(scene.replace(amplitude=0.5), jv.State(x=0.0, v=0.0))
grazing = jv.follow(rest, "amplitude", (0.1, 6.0), stop="GR").points("GR")[0]
upper, lower = jv.located(grazing, wall="right"), jv.located(fold)


def width(scene):
    """Return the width of the range of amplitudes in which both motions are stable."""
    return upper(scene) - lower(scene)


print(f"width {float(width(scene)):.6f}, derivative by the damping {float(jax.grad(width)(scene).damping):+.6f}")
halved = jv.place(width, None, 0.5 * float(width(scene)), free={"frequency": 0.1, "damping": 0.05}, scene=scene)
print(halved.table())

# %%
figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for told, each, colour in (("original", scene, "#0072B2"), ("halved", halved.scene, "#D55E00")):
    there = float(lower(each)), float(upper(each))
    ax.axvspan(*there, color=colour, alpha=0.25, label=f"both stable, {told}: {there[1] - there[0]:.4g}")
    motion = jv.find_orbit(each.replace(amplitude=2.0), jv.State(x=0.9, v=-1.1))
    jv.plot.branch(jv.follow(motion, "amplitude", (0.2, 3.5)), "x", ax, colour)
ax.legend(fontsize="small")
keep(figure, "width")

# %% [markdown]
# ## Bifurcations in a box of parameters
#
# `search` finds the points in a box of drive parameters at which an attractor has a period doubling. It requires no
# initial orbit.

# %%
box = {"amplitude": (0.5, 6.0), "frequency": (1.8, 2.6)}
found = jv.search(scene, "PD", {"amplitude": 1.0, "frequency": 0.5}, box, starts=400, max_period=1)
print(found.table())
for point in found.points[:2]:
    print(point.label, point.normal_form.criticality, point.normal_form.consequence)
