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
# # Impacts of a tube on its supports: scene, stroboscopic map and sweeps
#
# This notebook introduces the scene, the stroboscopic map, attractors and sweeps. It is for new users. The example is a
# tube of a heat exchanger that vibrates in the flow. The tube passes a baffle with a gap of 0.4 mm on either side.
# Three quantities are of interest: the exciting force at which impacts against the baffle begin, the number of impacts
# per drive period, and the impact speed.
#
# The first bending mode of the tube is modelled as a mass on a spring, and the hole in the baffle as a pair of rigid
# walls.

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
    figure.savefig(OUT / f"01_{name}.png", dpi=120)


# %% [markdown]
# ## The scene
#
# The model (scene) is given in SI units: modal mass, damping, stiffness, and a force of 5 N. `scene_from_physical`
# computes the dimensionless parameters. Lengths are in units of the gap d = 0.4 mm, time is in units of 1/w0.

# %%
MASS, STIFFNESS, PLAY, SPEED = 0.8, 8.0e3, 4.0e-4, 210.0  # kg, N/m, m, rad/s
scene = jv.scene_from_physical(
    mass=MASS,
    damping=8.0,
    stiffness=STIFFNESS,
    force=5.0,
    frequency=SPEED,
    restitution=0.7,
    walls=(-PLAY, PLAY),
)
for name in ("amplitude", "frequency", "damping", "restitution"):
    print(f"{name:12}{float(scene.parameter(name)):.4f}")

# %% [markdown]
# ## The stroboscopic map
#
# `strobe` is the stroboscopic (Poincaré) map. It advances a state at phase 0 of the drive by one drive period and
# counts the impacts. It records the first four impacts, or as many as `slots` specifies. It accepts one state or an
# array of states, and its results have the same shape. Here the initial position is 0, and the initial velocities range
# from -3 to 3.

# %%
speeds = np.linspace(-3.0, 3.0, 201)
states, impacts = jv.strobe(scene, jv.State(x=0.0, v=speeds))
figure, axes = plt.subplots(2, 1, figsize=(7, 6), layout="constrained", sharex=True)
axes[0].plot(speeds, states.x, ".", markersize=3, color="black")
axes[0].set_ylabel("position one period later, $x = X/d$")
axes[1].step(speeds, impacts.count, where="mid", color="black")
axes[1].set_yticks(range(3))
axes[1].set(xlabel=r"initial velocity, $v = \dot X/(d\,\omega_0)$", ylabel="impacts in the period")
keep(figure, "strobe")

# %% [markdown]
# ## Attractors
#
# `find_attractors` simulates many random initial states until their motions recur, and labels the attractors that they
# approach. The label P n p q denotes n drive periods with p impacts on the left wall and q on the right wall.

# %%
attractors = jv.find_attractors(scene, starts=100)
for one in attractors:
    print(f"{one.label}: {100 * one.share:.0f} % of the initial states")

# %% [markdown]
# At this force the tube has two attractors. Depending on its initial state, it vibrates permanently without impacts
# (P100) or with impacts (P111). `simulate` computes the trajectories for a figure: position against time, and velocity
# against position.

# %%
figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
motions = {}
for row, one in zip(axes, attractors, strict=True):
    motions[one.label] = jv.simulate(scene, one.state, periods=3, samples=300)
    jv.plot.trace(motions[one.label], scene, row[0])
    jv.plot.portrait(motions[one.label], scene, row[1])
    row[0].set_title(f"{one.label}: {motions[one.label].sizes['impact'] / 3:g} impacts per drive period")
keep(figure, "motions")

# %% [markdown]
# ## Onset and end of the impacts
#
# Two sweeps change the force slowly. The first increases it from 0, the second decreases it again. The markers are the
# attractors from above.

# %%
amplitudes = np.linspace(0.0, 4.0, 201)
up = jv.sweep(scene, "amplitude", amplitudes, jv.State(x=0.0, v=0.0), settle=150, keep=20)
down = jv.sweep(scene, "amplitude", amplitudes[::-1], jv.State(x=0.9, v=-1.1), settle=150, keep=20)
figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", sharey=True)
for ax, leg in zip(axes, (up, down), strict=True):
    jv.plot.diagram(leg, "x", ax)
    jv.plot.mark(attractors, float(scene.amplitude), "x", ax)
    ax.legend()
keep(figure, "sweep")

# %% [markdown]
# One more period, simulated from the last state of a sweep at each force, shows at which forces impacts occur. The
# force is the amplitude A times K d.


# %%
def knocking(leg):
    """Return the forces of a sweep with an impact in the period after the last recorded one."""
    last, values = leg.isel(period=-1), leg["amplitude"].values
    _, impacts = jv.strobe(scene.replace(amplitude=values), jv.State(x=last["x"].values, v=last["v"].values))
    return values[np.asarray(impacts.count) > 0] * STIFFNESS * PLAY


starts_at, stops_at = knocking(up).min(), knocking(down).min()
print(f"increasing force: impacts from {starts_at:.2f} N; decreasing force: impacts down to {stops_at:.2f} N")

# %% [markdown]
# ## Conclusions
#
# At 5 N an undisturbed tube vibrates without impacts. After a perturbation it may continue permanently with impacts,
# two per drive period, one on each side. If the force increases from 0, impacts begin at about twice this force. To end
# them, the force must decrease to about a seventh of its value at onset. The impact speed is:

# %%
hardest = motions["P111"]["speed"].values.max()
print(f"impact speed {hardest:.2f} d w0, that is {hardest * PLAY * np.sqrt(STIFFNESS / MASS) * 1e3:.0f} mm/s")

# Checks: the script fails if a statement of the text does not hold.
assert {one.label for one in attractors} == {"P100", "P111"}
assert motions["P111"].sizes["impact"] == 6 and motions["P100"].sizes["impact"] == 0
assert 1.9 < starts_at / 5.0 < 2.4 and 6 < starts_at / stops_at < 8
