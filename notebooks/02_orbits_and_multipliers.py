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
# # Periodic orbits and Floquet multipliers
#
# This notebook computes stable and unstable periodic orbits with their Floquet multipliers. It is for users with
# coexisting attractors. The example is the oscillator between two walls of the figure in the README. At A = 4.65 it has
# four attractors with impacts, and the initial state selects one of them. The notebook determines how fast
# perturbations of each attractor decay, which orbits lie between the attractors, and how a stable orbit disappears as
# the drive amplitude increases.

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
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"02_{name}.png", dpi=120)


scene = jv.make_scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## The orbit reached from rest
#
# `find_orbit` simulates a state until it has settled and determines after how many drive periods it recurs. It then
# solves for the times and speeds of the impacts. The residual is the remaining error of these equations, here of the
# order of rounding.

# %%
orbit = jv.find_orbit(scene, jv.State(x=0.0, v=0.0))
print(f"{orbit.label}, x = {orbit.state.x:.12f}, v = {orbit.state.v:.12f} at phase 0, residual {orbit.residual:.0e}")
for time, side, speed in zip(orbit.impacts.time, orbit.impacts.side, orbit.impacts.speed, strict=True):
    print(f"  {'left' if side < 0 else 'right':6}at t = {time:.6f} with speed {speed:.6f}")

# %% [markdown]
# ## Stability
#
# The monodromy matrix M maps a small perturbation of the state to the perturbation one period later. M is the
# derivative of `strobe`. `monodromy` computes it as a product over flights and impacts, and `jax.jacfwd` differentiates
# the program. The two methods share little code, and their results agree.


# %%
def end(point, scene=scene):
    """Return the state (x, v) one period after a state (x, v) at phase 0."""
    state, _ = jv.strobe(scene, jv.State(point[0], point[1]))
    return jnp.array([state.x, state.v])


point = np.array([orbit.state.x, orbit.state.v])
matrix = np.asarray(jv.monodromy(scene, orbit.state))
apart = abs(matrix - jax.jacfwd(end)(point)).max()
print(matrix, f"product and differentiation differ by {apart:.0e}", sep="\n")

# %% [markdown]
# The eigenvalues of M are the Floquet multipliers. An `Orbit` contains them. Both are smaller than 1 in modulus, and a
# perturbation therefore decays. Here it rotates and shrinks to 0.42 of its size per period. The product of the
# multipliers is known without the orbit: the damping contributes exp(-4 pi gamma / omega) per period, and each impact
# contributes the square of the restitution.

# %%
size = abs(orbit.multipliers[0])
known = np.exp(-4 * np.pi * float(scene.damping) / float(scene.frequency)) * float(scene.restitution) ** 4
print(f"multipliers {orbit.multipliers.round(6)}, modulus {size:.4f}; product {known:.6f}")

# %% [markdown]
# ## Sensitivity to the parameters
#
# Reverse-mode differentiation gives the derivatives by all parameters of the scene at once. The next cell
# differentiates the state after one period for a fixed initial state:

# %%
by_scene = jax.grad(lambda scene: end(point, scene)[0])(scene)
for name in ("amplitude", "frequency", "damping", "restitution"):
    print(f"d x / d {name:12}{float(getattr(by_scene, name)):9.4f}")

# %% [markdown]
# The orbit itself shifts by a different amount, because its initial state shifts too. (1 - M) times the shift of the
# orbit equals the shift of the final state for a fixed initial state. The next cell computes the shift for the
# restitution and compares it with the orbit at a slightly larger restitution:

# %%
step = 1e-4
ends = jax.jacfwd(lambda value: end(point, scene.replace(restitution=value)))(0.7)
shift = np.linalg.solve(np.eye(2) - matrix, ends)
harder = jv.find_orbit(scene.replace(restitution=0.7 + step), orbit.state, periods=1, settle=0)
found = (np.array([harder.state.x, harder.state.v]) - point) / step
print(f"derivative of x and v by the restitution: {shift}, by finite differences {found}")

# %% [markdown]
# ## Unstable orbits
#
# `find_orbit` also finds an unstable orbit, from a state near it. With `settle=0` it simulates no transient and starts
# Newton's method at once. `find_orbits` finds the orbits that trajectories from 20 random initial states approach. Here
# it is restricted to orbits of one drive period.

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
# The four stable orbits form two pairs of mirror images. A third P111 lies between the two stable ones. It is its own
# mirror image, and no sweep shows it: its larger multiplier is 2.333. A perturbation of 1e-6 grows by this factor per
# period. It leads to one of the two stable P111 and, in the opposite direction, to the other.

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
for k, (colour, marker, name) in enumerate((("#0072B2", "o", "+1e-6"), ("#E69F00", "s", "-1e-6"))):
    look = {"marker": marker, "color": colour, "markersize": 7 - 3 * k}
    axes[0].semilogy(distance[:31, k], linestyle="none", label=f"perturbation {name}", **look)
    axes[1].plot(path[:31, k, 0], linewidth=0.8, **look)
axes[0].semilogy(1e-6 * 2.333002 ** np.arange(17), color="black", linewidth=0.8, label="factor 2.333 per period")
axes[0].set(xlabel="drive periods", ylabel="distance from the unstable P111", ylim=(5e-7, 10))
axes[1].set(xlabel="drive periods", ylabel="position $x$ at phase 0")
axes[1].set_title("grey: P111, stable (solid) and unstable (dashed)", fontsize="medium")
for one in orbits[:3]:
    axes[1].axhline(one.state.x, color="0.55", linewidth=1.0, linestyle="-" if one.stable else "--", zorder=0)
axes[0].legend()
keep(figure, "between")

# %% [markdown]
# ## Disappearance of a stable orbit
#
# The orange dots in the figure of the README are the P111 that is reached from rest. They end at A = 5.30, although the
# multipliers remain small: their modulus is 0.42 there as well. The cause is the unstable P112. It resembles this P111,
# with one additional slow impact on the right wall. The next cell follows both orbits to larger A, each from the orbit
# at the previous value:

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
print("     A   P111 min. clearance  P112 least impact speed   P112 multiplier")
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
# As A increases, the P111 turns ever closer to the wall, and the impact of the P112 on this wall becomes ever slower.
# At A = 5.304 both orbits graze the wall and coincide. Beyond this value neither exists. An impact of speed u makes M
# of order 1/u. The multiplier of the P112 therefore grows without bound towards the grazing; it is 1968 at A = 5.3.
#
# Beyond the grazing `find_orbit` reports that no such orbit exists, with the reason and a possible remedy. From rest at
# A = 5.4 the mass does not settle on any orbit of short period:

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
# ## Conclusions
#
# A small perturbation of each of the four attractors decays within a few periods, to 0.42 or 0.40 of its size per
# period. Unstable orbits with multipliers of 2.33 and 4.76 lie between the attractors. On an unstable orbit the
# smallest perturbation decides which attractor is reached.
#
# A stable orbit with small multipliers may nevertheless disappear, and its multipliers give no warning. The P111
# disappears when it grazes the wall, together with the unstable P112. The quantity that gives warning is the distance
# to the wall, `least_clearance`.

# %%
# Checks: the script fails if a statement of the text does not hold.
assert apart < 1e-12 and abs(np.prod(orbit.multipliers) - known) < 1e-12
assert np.allclose(shift, found, rtol=1e-3) and abs(near.multipliers[0] - 2.333002) < 1e-6
assert sorted(one.label for one in orbits if one.stable) == ["P111", "P111", "P112", "P121"]
assert sorted(abs(one.multipliers[0]).round(6) for one in orbits if not one.stable) == [2.333002, 4.759687, 4.759687]
assert np.allclose(sorted(path[-1, :, 0]), sorted(one.state.x for one in orbits[:2]), atol=1e-9)
assert len(reasons) == 2 and "not admissible" in reasons[0] and "32 periods" in reasons[1]
assert all(one.label == "P111" and one.stable for one in lasting)
assert all(one.label == "P112" and not one.stable for one in slow) and abs(larger[-1] - 1967.68) < 0.01
assert clear[-1] < 0.002 and speeds[-1] < 0.003 and abs(slow[-1].state.x - lasting[-1].state.x) < 5e-4
