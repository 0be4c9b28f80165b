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
# # What lies between two motions that both last?
#
# The mass between two walls of the picture in the README knocks in four ways at A = 4.65, each for good; which one
# depends on how it started. We want to know how firmly it holds on to each, what lies between them, and how a motion
# ends when the drive grows.

# %%
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)


def keep(figure, name):
    """Save a picture beside the others."""
    figure.savefig(OUT / f"02_{name}.png", dpi=120)


scene = jv.make_scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## The motion from rest
#
# `find_orbit` follows a state until it has settled, sees after how many drive periods it comes back, and then solves
# for the times and speeds of the impacts. The residual is the error left in those equations: that of rounding.

# %%
orbit = jv.find_orbit(scene, jv.State(x=0.0, v=0.0))
print(f"{orbit.label}, x = {orbit.state.x:.12f}, v = {orbit.state.v:.12f} at phase 0, residual {orbit.residual:.0e}")
for time, side, speed in zip(orbit.impacts.time, orbit.impacts.side, orbit.impacts.speed, strict=True):
    print(f"  {'left' if side < 0 else 'right':6}at t = {time:.6f} with speed {speed:.6f}")

# %% [markdown]
# ## How firmly it holds
#
# A small disturbance of the state has become M times the disturbance a period later. M is the derivative of `strobe`:
# `monodromy` makes it as a product over flights and impacts, `jax.jacfwd` differentiates the program. The two share
# little, and agree.


# %%
def end(point, scene=scene):
    """The state (x, v) a period after a state (x, v) at phase 0."""
    state, _ = jv.strobe(scene, jv.State(point[0], point[1]))
    return jnp.array([state.x, state.v])


point = np.array([orbit.state.x, orbit.state.v])
matrix = np.asarray(jv.monodromy(scene, orbit.state))
apart = abs(matrix - jax.jacfwd(end)(point)).max()
print(matrix, f"product and differentiation differ by {apart:.0e}", sep="\n")

# %% [markdown]
# Its eigenvalues are the multipliers, which an `Orbit` brings along. Both are smaller than 1 in size, so a disturbance
# dies out: here it turns as it shrinks, to 0.42 of its size a period. Their product needs no orbit at all: the damping
# gives exp(-4 pi gamma / omega) a period, each impact the square of the restitution.

# %%
size = abs(orbit.multipliers[0])
known = np.exp(-4 * np.pi * float(scene.damping) / float(scene.frequency)) * float(scene.restitution) ** 4
print(f"multipliers {orbit.multipliers.round(6)}, size {size:.4f}; product {known:.6f}")

# %% [markdown]
# ## And when a number of the scene is a little different?
#
# Derivatives by the scene's numbers come in reverse mode, all at once: how far does the end of one period move, from
# the same start?

# %%
by_scene = jax.grad(lambda scene: end(point, scene)[0])(scene)
for name in ("amplitude", "frequency", "damping", "restitution"):
    print(f"d x / d {name:12}{float(getattr(by_scene, name)):9.4f}")

# %% [markdown]
# The orbit itself moves by another amount, as its start moves too: (1 - M) times its shift is the shift of that end.
# For the restitution, compared with the orbit of a slightly harder wall:

# %%
step = 1e-4
ends = jax.jacfwd(lambda value: end(point, scene.replace(restitution=value)))(0.7)
shift = np.linalg.solve(np.eye(2) - matrix, ends)
harder = jv.find_orbit(scene.replace(restitution=0.7 + step), orbit.state, periods=1, settle=0)
found = (np.array([harder.state.x, harder.state.v]) - point) / step
print(f"shift of x and v for a restitution larger by 1: by derivatives {shift}, by a second orbit {found}")

# %% [markdown]
# ## What repels
#
# A motion that repels can be found as well, from a state near it: with `settle=0` nothing is followed, Newton's method
# starts at once. Or all that 20 random starts come near, by `find_orbits`; only orbits of one drive period here.

# %%
near = jv.find_orbit(scene, jv.State(x=0.74, v=2.62), periods=1, settle=0)
orbits = jv.find_orbits(scene, max_period=1, starts=20)
for place, one in enumerate(orbits):
    twin = "itself" if one.mirror_of == place else one.mirror_of
    kind = "stable" if one.stable else "unstable"
    print(f"{place}: {one.label} {kind:9} larger multiplier {one.multipliers[0]:.6f}, mirror image {twin}")

# %%
figure, axes = plt.subplots(2, 4, figsize=(17, 8), layout="constrained")
for ax, one in zip(axes.flat, orbits, strict=False):
    jv.plot.orbit(one, ax)
axes.flat[-1].set_axis_off()
keep(figure, "orbits")

# %% [markdown]
# The four that last come in two pairs of mirror images. Between the two P111 lies a third one that is its own mirror
# image, and which no sweep shows: its larger multiplier is 2.333. A push off it of a millionth grows by that factor a
# period, and leads to one twin or, the other way, to the other.

# %%
(middle,) = (one for one in orbits if one.label == "P111" and not one.stable)
values, vectors = np.linalg.eig(np.asarray(jv.monodromy(scene, middle.state)))
away = 1e-6 * vectors[:, np.argmax(abs(values))].real
points = [np.array([middle.state.x, middle.state.v]) + sign * away for sign in (1.0, -1.0)]
states = jv.State(*np.stack(points, -1))
path = [np.stack([states.x, states.v], -1)]
for _ in range(60):
    states, _ = jv.strobe(scene, states)
    path.append(np.stack([states.x, states.v], -1))
path = np.array(path)
distance = np.linalg.norm(path - [middle.state.x, middle.state.v], axis=-1)

# %%
figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for k, (colour, marker, name) in enumerate((("#0072B2", "o", "one way"), ("#E69F00", "s", "the other way"))):
    look = {"marker": marker, "color": colour, "markersize": 7 - 3 * k}
    axes[0].semilogy(distance[:31, k], linestyle="none", label=f"pushed {name}", **look)
    axes[1].plot(path[:31, k, 0], linewidth=0.8, **look)
axes[0].semilogy(1e-6 * 2.333002 ** np.arange(17), color="black", linewidth=0.8, label="2.333 a period")
axes[0].set(xlabel="drive periods", ylabel="distance from the unstable P111", ylim=(5e-7, 10))
axes[1].set(xlabel="drive periods", ylabel="position $x$ at phase 0")
axes[1].set_title("grey: the twins, and dashed the one between", fontsize="medium")
for one in orbits[:3]:
    axes[1].axhline(one.state.x, color="0.55", linewidth=1.0, linestyle="-" if one.stable else "--", zorder=0)
axes[0].legend()
keep(figure, "between")

# %% [markdown]
# ## How a motion ends
#
# In the picture in the README the orange dots, which are the P111 that we found from rest, go on to A = 5.30 and no
# further, though its multipliers stay small: 0.42 in size there as well. The unstable P112 has to do with it. It is
# like that P111 but for one slow impact more, on the right wall. Both followed to larger A, each orbit from the one
# before:

# %%
amplitudes = (4.65, 4.8, 4.95, 5.1, 5.2, 5.25, 5.28, 5.295, 5.3)
lasting, slow = [orbit], [one for one in orbits if one.label == "P112" and not one.stable]
for amplitude in amplitudes[1:]:
    there = scene.replace(amplitude=amplitude)
    lasting.append(jv.find_orbit(there, lasting[-1].state, itinerary=("LR",), settle=0))
    slow.append(jv.find_orbit(there, slow[-1].state, itinerary=("RLR",), settle=0))
clear = np.array([one.least_clearance for one in lasting])
speeds = np.array([one.least_speed for one in slow])
larger = np.array([one.multipliers[0].real for one in slow])
print("    A   P111 turns short of the wall by   P112 least speed   P112 multiplier")
for row in zip(amplitudes, clear, speeds, larger, strict=True):
    print("{:6.3f}{:22.6f}{:25.6f}{:18.3f}".format(*row))

# %%
figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for some, line, colour, name in ((lasting, "o-", "#0072B2", "stable P111"), (slow, "o--", "#D55E00", "unstable P112")):
    inside = colour if some is lasting else "white"
    axes[0].plot(amplitudes, [one.state.x for one in some], line, color=colour, markerfacecolor=inside, label=name)
axes[0].set(xlabel="drive amplitude $A$", ylabel="position $x$ at phase 0")
axes[0].legend()
axes[1].loglog(speeds, larger, "o", color="#D55E00", markerfacecolor="white", zorder=3, label="unstable P112")
axes[1].loglog(
    speeds, larger[-1] * speeds[-1] / speeds, color="black", linewidth=0.8, label="proportional to 1 / speed"
)
axes[1].set(xlabel="speed of the slowest impact", ylabel="larger multiplier")
axes[1].legend()
keep(figure, "end")

# %% [markdown]
# The P111 turns nearer and nearer to the wall, the P112 hits it there slower and slower; at A = 5.304 both graze it,
# are one orbit, and are gone. An impact with the speed u makes M as large as 1/u, so the multiplier of the P112 grows
# beyond all bounds on the way: 1968 at A = 5.3.
#
# Beyond it `find_orbit` says that there is no such orbit, why, and what may help. And from rest at A = 5.4 the mass
# settles on no short motion at all:

# %%
reasons = []
for amplitude, start, more in (
    (5.31, slow[-1].state, {"itinerary": ("RLR",), "settle": 0}),
    (5.4, jv.State(x=0.0, v=0.0), {}),
):
    try:
        jv.find_orbit(scene.replace(amplitude=amplitude), start, **more)
    except jv.OrbitError as error:
        reasons.append(error.status)
        print(f"A = {amplitude}: {error}")

# %% [markdown]
# ## The answer
#
# Each of the four motions forgets a small push within a few periods: what is left shrinks to 0.42 or 0.40 of its size a
# period. Between them lie motions that repel, with multipliers of 2.33 and 4.76; from there the smallest push decides.
# A motion with small multipliers may end all the same, and without warning by them: the P111 does when it grazes the
# wall, together with the P112 that repels. What warns is the distance to the wall, `least_clearance`.

# %%
# What the text says holds, or this script fails.
assert apart < 1e-12 and abs(np.prod(orbit.multipliers) - known) < 1e-12
assert np.allclose(shift, found, rtol=1e-3) and abs(near.multipliers[0] - 2.333002) < 1e-6
assert sorted(one.label for one in orbits if one.stable) == ["P111", "P111", "P112", "P121"]
assert sorted(abs(one.multipliers[0]).round(6) for one in orbits if not one.stable) == [2.333002, 4.759687, 4.759687]
assert np.allclose(sorted(path[-1, :, 0]), sorted(one.state.x for one in orbits[:2]), atol=1e-9)
assert len(reasons) == 2 and "not admissible" in reasons[0] and "32 periods" in reasons[1]
assert all(one.label == "P111" and one.stable for one in lasting)
assert all(one.label == "P112" and not one.stable for one in slow) and abs(larger[-1] - 1967.68) < 0.01
assert clear[-1] < 0.002 and speeds[-1] < 0.003 and abs(slow[-1].state.x - lasting[-1].state.x) < 5e-4
