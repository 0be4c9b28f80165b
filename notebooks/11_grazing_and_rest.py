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
# # Grazing and complete chatter
#
# This notebook treats grazing and sticking as points of a branch. It is for users whose continuation would otherwise
# end where a mass just touches a wall or comes to rest on it. It covers the unfolding of a resonant grazing, compared
# with its closed form, the period adding that follows a grazing, and bounces whose number increases until the mass
# sticks to the wall (complete chatter).

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
BLACK, BLUE, RED, GREY = "#000000", "#0072B2", "#D55E00", "#999999"


def keep(figure, name):
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"11_{name}.png", dpi=120)


# %% [markdown]
# ## The unfolding of a resonant grazing
#
# One wall is at 1. As the drive amplitude increases, the mass grazes the wall (GR). With the frequency as the second
# parameter the grazing is a curve. On this curve, at the frequency 2 sqrt(1 - damping^2), there is a point at which the
# contact has no effect on the position one period later: the resonant grazing (RG). The loci of the saddle-nodes and of
# the period doublings of the orbit with the impact begin there.

# %%
DAMPING, R, DISTANCE = 0.05, 0.7, 1.0
NAMES = "amplitude", "frequency"
scene = jv.make_scene(amplitude=0.1, frequency=1.9, damping=DAMPING, restitution=R, walls=(None, DISTANCE))
touch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 6.0), stop="GR").points("GR")[0]
grazing = jv.locus(touch, NAMES, {"amplitude": (0.0, 20.0), "frequency": (1.6, 2.4)})
(point,) = grazing.points("RG")
folds, doublings = jv.switch(point)
print(grazing.table())
print(f"2 sqrt(1 - damping^2) = {2.0 * np.sqrt(1.0 - DAMPING**2):.12g}")

# %% [markdown]
# Both loci leave the curve of grazings tangentially, along parabolas (Simpson and Ghosh, arXiv 2602.22797). For one
# wall the coefficients of the parabolas are known in closed form, with an independent derivation in docs/loci.md. Here
# m = n = 1:


# %%
def touching(omega):
    """Return the amplitude at which the mass grazes the wall, in closed form."""
    return DISTANCE * np.sqrt((1.0 - omega**2) ** 2 + 4.0 * DAMPING**2 * omega**2)


centre = point.values["frequency"]
e = -np.exp(-2.0 * np.pi * DAMPING / centre)
q = 2.0 * np.pi * (1.0 + R) * e / centre
folding = -0.5 * touching(centre) * (q / ((1.0 - e) * (1.0 + R * e))) ** 2
doubling = touching(centre) * (q / (1.0 - e)) ** 2
doubling *= 1.0 / (1.0 - R * e) ** 2 + (1.0 + R * e) ** 2 / (2.0 * (1.0 - R * e) ** 4)

figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for found, bend, colour, name in ((folds, folding, BLUE, "saddle-nodes"), (doublings, doubling, RED, "doublings")):
    amplitude, omega = found.values.T
    off = np.linspace(0.0, 0.1, 101) * np.sign(omega[-1] + omega[0] - 2.0 * centre)
    axes.plot(omega - centre, amplitude - touching(omega), color=colour, label=f"{name}, continuation")
    axes.plot(off, bend * off**2, color=colour, linestyle=(0, (4, 3)), alpha=0.7, label=f"{name}, closed form")
axes.axhline(0.0, color=BLACK, linewidth=1, label="grazing")
axes.set(
    xlim=(-0.1, 0.1), ylim=(-0.35, 0.15), xlabel="frequency minus that of the RG", ylabel="amplitude minus that of GR"
)
axes.legend(frameon=False, fontsize=8)
keep(figure, "resonant_grazing")

# %% [markdown]
# The parabolas are local approximations. The ratio of the computed locus to its parabola tends to 1 as the distance
# from the point decreases.

# %%
for found, bend, name in ((folds, folding, "SN"), (doublings, doubling, "PD")):
    amplitude, omega = found.values.T
    away = abs(omega - centre)
    near = np.argsort(away)[[k for k in (1, 2, 4, 8) if k < len(away)]]
    ratios = (amplitude - touching(omega))[near] / (bend * away[near] ** 2)
    print(name, *(f"{ratio:.5f} at {far:.2g}" for ratio, far in zip(ratios, away[near], strict=True)), sep="  ")

# %% [markdown]
# ## Dynamics beyond a grazing
#
# Beyond a grazing a motion may jump, become chaotic, or hit the wall once in an ever smaller number of periods. The
# signs of a few quantities at the point predict which of these occurs (`scenario`). In this example, under strong
# damping, the grazing is followed by orbits with one impact in n periods, where n decreases with the distance from the
# grazing (period adding). `period_adding` predicts the value at which each of these orbits touches the wall once more,
# and then finds this value by continuation.

# %%
damped = jv.make_scene(amplitude=5.0, frequency=2.1, damping=1.2, restitution=0.7, walls=(None, 1.0))
quiet = jv.find_orbit(damped, jv.State(0.0, 0.0))
told = jv.period_adding(jv.follow(quiet, "amplitude", (4.0, 7.0)).points("GR")[0], longest=7)
print(told.scenario.table())
print(told.table())

figure, axes = plt.subplots(figsize=(6, 4.2), layout="constrained")
value, count = told.scenario.special.value, [window.returns for window in told.windows]
axes.semilogy(count, [window.found - value for window in told.windows], "o", color=RED, label="by continuation")
axes.semilogy(
    count, [window.predicted - value for window in told.windows], "+", color=BLACK, markersize=10, label="by the map"
)
axes.set(xlabel="number n of periods with one impact", ylabel="amplitude beyond the grazing")
axes.legend(frameon=False)
keep(figure, "period_adding")

# %% [markdown]
# ## Complete chatter
#
# A drive of lower frequency presses the mass against the wall for part of the period. There the mass bounces, and the
# speed of each impact is R times that of the previous one. With increasing drive amplitude the number of bounces grows,
# and each additional impact appears in a grazing. Finally, infinitely many bounces fit into the time before the
# release, and the mass sticks to the wall: P1-0-inf. The branch passes through the point at which the chatter is just
# complete (CH).

# %%
slow = jv.make_scene(amplitude=1.42, frequency=0.5, damping=0.05, restitution=0.5, walls=(None, 0.5))
resting = jv.find_orbit(slow, jv.State(0.0, 0.0))
branch = jv.follow(resting, "amplitude", (1.3, 1.45))
(complete,) = branch.points("CH")
print(branch.table())

# %% [markdown]
# The distance of the grazings from the CH decreases, asymptotically by one factor per bounce, which depends on R only.
# Let q be the root of (1 + q) (3 q - 1)^2 = 8 R q between 1/3 and 1. The factor is mu = (1 + q)^2 / (2 q^2 (3 q - 1))
# (Nordmark and Piiroinen, 2009).

# %%
roots = np.roots(np.polyadd(np.polymul([1.0, 1.0], [9.0, -6.0, 1.0]), [-8.0 * 0.5, 0.0]))
(q,) = [root.real for root in roots if abs(root.imag) < 1e-12 and 1 / 3 < root.real < 1]
mu = (1.0 + q) ** 2 / (2.0 * q**2 * (3.0 * q - 1.0))
hops = np.sort([one.value for one in branch.points("GR")])
left_over = complete.value - hops
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
times = np.linspace(0.0, 2.0 * np.pi / 0.5, 4000)
states, _ = jv.sample(resting.scene, resting.state, times)
left.plot(times, states.x, color=BLUE)
left.axhline(0.5, color=BLACK, linewidth=1)
left.set(xlabel="t", ylabel="x", title=f"{resting.label} at amplitude 1.42")
right.semilogy(left_over, "o", color=RED, label="grazings, continuation")
right.semilogy(left_over[-1] * mu ** np.arange(len(hops))[::-1], color=GREY, label=f"factor {mu:.5f} per bounce")
right.set(xlabel="number of the grazing", ylabel="distance in amplitude from complete chatter")
right.legend(frameon=False)
keep(figure, "complete_chatter")
print("factors:", np.round(left_over[:-1] / left_over[1:], 5))

# %% [markdown]
# In two parameters the CH is a curve (its locus). On one side of it the mass sticks once per period, on the other side
# it only bounces.

# %%
where = jv.locus(complete, ("amplitude", "restitution"), {"amplitude": (0.5, 3.0), "restitution": (0.05, 0.7)})
print(where.table())
figure, axes = plt.subplots(figsize=(6, 4.2), layout="constrained")
axes.plot(*where.values.T, color=BLUE)
axes.fill_between(where.values[:, 0], where.values[:, 1], 0.05, color=BLUE, alpha=0.12, linewidth=0)
axes.text(0.62, 0.2, "sticks", transform=axes.transAxes)
axes.text(0.15, 0.85, "bounces", transform=axes.transAxes)
axes.set(xlabel="amplitude", ylabel="R", xlim=(0.5, 3.0), ylim=(0.05, 0.7))
keep(figure, "where_it_rests")
