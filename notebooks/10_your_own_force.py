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
# # User-defined forces
#
# This notebook replaces the linear spring and damper by other forces. It is for users with a nonlinear oscillator.
# Between the walls any smooth force that JAX can trace may act on the mass. The notebook has two examples: a stiffening
# spring, which modifies the behaviour of the linear scene, and a gear pair, which has no spring and behaves
# differently.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
COLOURS = ("#000000", "#0072B2", "#D55E00")


def keep(figure, name):
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"10_{name}.png", dpi=120)


# %% [markdown]
# ## A stiffening spring between two walls
#
# The force is a function of the time, x, v and its own parameters. It replaces -x - 2 damping v. The drive is not part
# of it.

# %%
OMEGA, R, DAMPING = 2.1, 0.7, 0.05
START = jv.State(x=0.9, v=-1.1)


def duffing(t, x, v, p):
    """Return the force of a spring with a linear and a cubic term, and of a damper."""
    return -x - p["cubic"] * x**3 - 2.0 * p["damping"] * v


force = jv.Force(duffing, {"cubic": 0.0, "damping": DAMPING})
scene = jv.make_scene(amplitude=2.0, frequency=OMEGA, restitution=R, walls=(-1.0, 1.0), force=force)
print("parameters:", ", ".join(scene.names))
print("dissipative (areas provably never grow):", scene.dissipative)

# %% [markdown]
# Without the cubic term the scene is the linear one. The linear scene has a closed-form solution between impacts, and
# the user-defined force is integrated by Taylor steps. Both methods give the same branch, P111 along the amplitude of
# the drive, with the same special points.

# %%
linear = jv.make_scene(2.0, OMEGA, DAMPING, R, (-1.0, 1.0))
exact = jv.follow(jv.find_orbit(linear, START), "amplitude", (0.0, 4.0))


def branch(cubic):
    """Return the branch of P111 along the amplitude."""
    return jv.follow(jv.find_orbit(scene.replace(**{"force.cubic": cubic}), START), "amplitude", (0.0, 4.0))


CUBIC = np.array([0.0, 0.5, 1.0])
branches = [branch(value) for value in CUBIC]
print(exact.table())
off = max(abs(one.value - two.value) for one, two in zip(exact.special, branches[0].special, strict=True))
print(f"largest difference of the special points by Taylor steps: {off:.0e}")

# %% [markdown]
# Next, the cubic coefficient increases. The saddle-node (SN), at which P111 disappears as the drive amplitude
# decreases, and the grazing (GR), at which the motion without impacts first touches the walls, both move to smaller
# amplitudes. The symmetry breaking (SB) moves to larger amplitudes.

# %%
KINDS = {"SN": "P111 ends", "GR": "P100 grazes", "SB": "P111 loses its symmetry"}
points = {kind: np.array([one.points(kind)[0].value for one in branches]) for kind in KINDS}
print("cubic  " + "".join(f"{kind:>14}" for kind in KINDS))
for k, value in enumerate(CUBIC):
    print(f"{value:5.2f}  " + "".join(f"{points[kind][k]:14.9f}" for kind in KINDS))

figure, ax = plt.subplots(figsize=(9, 5.5), layout="constrained")
for one, value, colour in zip(branches, CUBIC, COLOURS, strict=True):
    hits, edges = one.data["side"].values[:, 0] != 0, [each.place for each in one.special]
    for stable, style in ((True, "-"), (False, ":")):
        shown = one.stable == stable
        shown[edges] = True  # a special point belongs to the stable and to the unstable line
        speed = np.where(hits & shown, one.data["speed"].values[:, 0], np.nan)
        ax.plot(one.values, speed, style, color=colour, label=f"{value:g}" if stable else None)
    for kind, mark in (("SN", "o"), ("SB", "D")):
        point = one.points(kind)[0]
        ax.plot(point.value, one.data["speed"].values[point.place, 0], mark, color=colour, markersize=5)
    ax.plot(one.points("GR")[0].value, 0.0, "v", color=colour, markersize=7, clip_on=False)
ax.set(xlabel="drive amplitude $A$", ylabel="impact speed of P111", ylim=(0, None))
ax.legend(title="cubic term\n(dotted: unstable;\no SN, v GR, D SB)", fontsize="small")
keep(figure, "duffing")

# %% [markdown]
# The reason is that the frequency of the drive is above the natural frequency. A stiffening spring oscillates faster,
# closer to the frequency of the drive, and a smaller drive amplitude suffices.

# %% [markdown]
# ## A gear pair
#
# Two gears have a backlash 2 b, and x is the relative displacement of their teeth (after Karagiannis and Pfeiffer,
# Nonlinear Dynamics 2, 1991). The driving gear rotates unevenly, and a drag acts on the driven gear. No force pulls x
# to the middle:
#
#     x'' = -c0 - 2 damping v + A cos(omega t),    teeth at -b and b, restitution R
#
# This is the named force "polynomial" with c0 alone. There is no natural frequency, and the units of time and length
# are arbitrary.

# %%
C0, R_TEETH = 0.1, 0.6
drag = jv.Force("polynomial", {"c0": C0, "c1": 0.0, "damping": 0.0})
gears = jv.make_scene(amplitude=0.12, frequency=1.0, restitution=R_TEETH, walls=(-0.5, 0.5), force=drag)
rattle = jv.find_orbit(gears, jv.State(x=0.2, v=0.0))
print(rattle.label, "multipliers", rattle.multipliers)
family = jv.follow(rattle, "amplitude", (0.02, 0.24), stop="GR")
print(family.table())

# %% [markdown]
# In P110 the teeth separate once per period and return to the same flank. Between two impacts x is a parabola plus a
# cosine. Without damping, the amplitude at which rattling begins and the amplitude of its period doubling are therefore
# known in closed form:
#
#     SN: A = pi c0 (1 - R) / (1 + R)
#     PD: A^2 = (A at SN)^2 + (2 c0 (1 + R^2) / (1 + R)^2)^2

# %%
begins = np.pi * C0 * (1 - R_TEETH) / (1 + R_TEETH)
doubles = np.hypot(begins, 2 * C0 * (1 + R_TEETH**2) / (1 + R_TEETH) ** 2)
(fold,), (flip,) = (family.points(kind) for kind in ("SN", "PD"))
print(f"SN {fold.value:.13f}, closed form {begins:.13f}")
print(f"PD {flip.value:.13f}, closed form {doubles:.13f}")

# %% [markdown]
# The drive separates teeth in contact where A > c0, and not below. Rattling, however, persists down to 0.785 c0 once it
# exists: one shock makes a quiet gear rattle permanently. Above c0 the teeth separate in small bounces that decay
# before the end of the period. Up to about 1.46 c0 they stick to the flank in each period. The figure shows slow sweeps
# with increasing and decreasing amplitude:

# %%
values = np.linspace(0.06, 0.17, 56)
swept = {}
for told, order, start in (("up, from rest", values, jv.State(-0.5, 0.0)), ("down", values[::-1], jv.State(0.2, 0.0))):
    swept[told] = jv.sweep(gears, "amplitude", order, start, settle=100, keep=16)
figure, ax = plt.subplots(figsize=(9, 5.5), layout="constrained")
jv.plot.branch(family, "x", ax, colour="0.4")
for (told, data), colour, size in zip(swept.items(), ("#0072B2", "#D55E00"), (5, 2.5), strict=True):
    ax.plot(data["amplitude"], data["x"].values, "o", color=colour, markersize=size, label=told)
ax.axvline(C0, color="black", linewidth=0.8, linestyle="--", label="$A = c_0$")
ax.set(xlim=(0.06, 0.17), ylim=(-0.55, 0.55), xlabel="drive amplitude $A$", ylabel="relative displacement at phase 0")
handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
ax.legend(handles.values(), handles, fontsize="small", loc="upper left")
keep(figure, "gears")

# %% [markdown]
# ## Differences from the linear scene
#
# With a spring and a weak drive, the mass oscillates about the middle, and it reaches a wall as the amplitude of this
# oscillation grows. Without a spring nothing holds the mass in the middle. The quiet motion sticks to a flank, and
# rattling coexists with it and does not emanate from it. More drag and more damping raise the amplitude at which
# rattling begins. A larger restitution of the teeth lowers it, and so does a spring, which pulls x away from the flank
# towards the middle:

# %%
names = ["force.c0", "force.c1", "force.damping", "restitution"]
moves = jv.sensitivity(fold, names)
for name, value in zip(names, moves.values, strict=True):
    print(f"{name:>14}: derivative of the amplitude at which rattling begins {value:+.6f}")

# %% [markdown]
# With c1 = 1 the polynomial is a spring and a constant force. This is the linear scene about -c0, with walls that are
# shifted to the right by c0. The next cell computes the same motion in both scenes.

# %%
sprung = gears.replace(**{"force.c1": 1.0, "force.damping": 0.05, "amplitude": 0.8, "frequency": 1.6})
shifted = jv.make_scene(0.8, 1.6, 0.05, R_TEETH, (-0.5 + C0, 0.5 + C0))
pair = [jv.find_orbit(one, jv.State(place, 0.5)) for one, place in ((sprung, 0.0), (shifted, C0))]
print(pair[0].label, pair[0].multipliers, pair[1].multipliers)

# %%
# Checks: the script fails if a statement of the text does not hold.
assert scene.dissipative is True and gears.dissipative is True
assert off < 1e-11 and [one.kind for one in exact.special] == [one.kind for one in branches[0].special]
assert (np.diff(points["SN"]) < 0).all() and (np.diff(points["GR"]) < 0).all() and (np.diff(points["SB"]) > 0).all()
assert abs(fold.value - begins) < 1e-12 and abs(flip.value - doubles) < 1e-12
assert abs(moves.values[0] - begins / C0) < 1e-9
assert abs(moves.values[3] + 2 * np.pi * C0 / (1 + R_TEETH) ** 2) < 1e-9
assert (np.sign(moves.values) == [1, -1, 1, -1]).all()
up, down = (swept[told].sortby("amplitude")["x"].values.reshape(len(values), -1) for told in swept)
assert (up[values <= C0] == -0.5).all() and (down[values < fold.value] == -0.5).all()
settled = np.ptp(up, axis=1) < 1e-9
assert settled[values < 0.145].all() and up[values < 0.145].max() < -0.49 and not settled[values > 0.149].any()
assert down[(values > fold.value) & (values < flip.value)].min() > -0.36
assert pair[0].label == pair[1].label and abs(pair[0].multipliers - pair[1].multipliers).max() < 1e-11
