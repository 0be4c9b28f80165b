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
# # How stiff must a stop be before restitution is right?
#
# A rubber buffer or a steel stop gives way. The mass stays in it for a while, and comes out slower. A rigid wall with a
# restitution R does the same in no time. When may one take it for the stop? Here both are computed beside each other:
# P111, the motion that hits both walls once a drive period, and the drive amplitude at which it is lost.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
START = jv.State(x=0.9, v=-1.1)
COLOURS = ("#D55E00", "#E69F00", "#009E73", "#56B4E9")


def keep(figure, name):
    """Save a picture beside the others."""
    figure.savefig(OUT / f"07_{name}.png", dpi=120)


rigid = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## A soft wall with a restitution
#
# Within a soft wall, x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t). Without a drive, and with the wall at 0,
# the mass is back after half a damped swing, with the part R_eff of its speed:
#
#     R_eff = exp(-pi z / sqrt(1 - z^2)),    z = gamma2 / sqrt(1 + k2)
#
# So a stiffer wall needs more damping to give back the same. `contact_damping` tells how much, `soften` puts such walls
# in place of the rigid ones:

# %%
for stiffness in (1e2, 1e4, 1e6):
    damping = jv.contact_damping(stiffness, 0.7)
    same, fixed = (jv.effective_restitution(stiffness, each) for each in (damping, 0.1))
    print(f"k2 {stiffness:7.0e}: gamma2 {damping:8.3f} gives {same:.3f} of the speed back, 0.1 gives {fixed:.5f}")
soft = jv.soften(rigid, 1e4)

# %% [markdown]
# The stiffness of all soft walls is the scene's parameter `hardness`, the decimal logarithm of k2. Naming it holds each
# wall's R_eff: `soft.replace(hardness=6.0)`. The response of P111 for four hardnesses, and for the rigid walls:

# %%
SHOWN = (2.0, 3.0, 4.0, 5.0)


def response(scene):
    """P111 along the drive amplitude, both ways from 2."""
    return jv.follow(jv.find_orbit(scene, START), "amplitude", (0.0, 2.5))


hard = response(rigid)
responses = [response(soft.replace(hardness=value)) for value in SHOWN]
figure, ax = plt.subplots(figsize=(9, 5.5), layout="constrained")
lines = [(hard, "black", "rigid, $R = 0.7$")]
lines += [(one, each, f"$k_2 = 10^{value:g}$") for one, each, value in zip(responses, COLOURS, SHOWN, strict=True)]
for branch, colour, told in lines:
    speed, stable = branch.data["speed"].values[:, 0], branch.stable
    ax.plot(branch.values, np.where(stable, speed, np.nan), color=colour, label=told)
    ax.plot(branch.values, np.where(stable, np.nan, speed), color=colour, linestyle="--")
    (fold,) = branch.points("SN")
    ax.plot(fold.value, branch.data["speed"].values[fold.place, 0], "o", color=colour)
ax.set(xlabel="drive amplitude $A$", ylabel="speed at which the mass comes to a wall", ylim=(0, None))
ax.legend(title="dashed: unstable; dots: saddle-nodes")
keep(figure, "response")

# %% [markdown]
# ## How fast does the difference vanish?
#
# The saddle-node (SN) is where P111 is lost as the drive weakens. Its distance to the rigid one, and how far times and
# speeds of the impacts and the multipliers are off at A = 2:

# %%
HARDNESSES = np.arange(3.0, 8.25, 0.5)
orbit = jv.find_orbit(rigid, START)
(fold,) = hard.points("SN")


def found_at(hardness):
    """(P111 at A = 2, the amplitude of its saddle-node) for a hardness."""
    own = jv.find_orbit(soft.replace(hardness=hardness), START)
    (end,) = jv.follow(own, "amplitude", (0.0, 2.5), direction="backward", stop="SN").points("SN")
    return own, end.value


def apart(own, other):
    """How far the impacts' times and speeds, and the multipliers, of two orbits are from each other."""
    pairs = [(np.sort(each.impacts.time), each.impacts.speed, each.multipliers) for each in (own, other)]
    return [abs(a - b).max() for a, b in zip(*pairs, strict=True)]


pairs = [found_at(value) for value in HARDNESSES]
folds = np.array([value for _, value in pairs])
gaps = np.column_stack([abs(folds - fold.value), [apart(own, orbit) for own, _ in pairs]])
NAMES = ("amplitude of the saddle-node", "times of impacts", "speeds of impacts", "multipliers")
high = HARDNESSES >= 5.0
slopes = np.polyfit(HARDNESSES[high], np.log10(gaps[high]), 1)[0]
figure, ax = plt.subplots(figsize=(8, 6), layout="constrained")
for gap, slope, told, colour, mark in zip(gaps.T, slopes, NAMES, COLOURS, "os^D", strict=True):
    ax.loglog(10.0**HARDNESSES, gap, color=colour, marker=mark, label=f"{told}: slope {slope:.3f}")
ends = np.array([1e3, 1e8])
ax.loglog(ends, 0.5 * gaps[-1, 1] * np.sqrt(1e8 / ends), "k:", label="slope -1/2")
ax.set(xlabel="stiffness of the walls $k_2$", ylabel="distance to what the rigid walls have")
ax.legend(title="slopes from $10^5$ to $10^8$")
keep(figure, "distance")
for told, slope in zip(NAMES, slopes, strict=True):
    print(f"{told}: {slope:+.4f}")

# %% [markdown]
# All fall like k2^(-1/2), which is how long the mass stays within a wall. In that time the drive turns on, and pushes
# where a rigid wall would be done already. Ten times closer takes walls a hundred times as stiff.
#
# The law also helps: of two soft computations the error can be taken away, twice that at 4 k2 less that at k2.

# %%
four = found_at(4.0 + np.log10(4.0))[1]
plain = folds[list(HARDNESSES).index(4.0)]
better = 2 * four - plain
print(f"SN rigid {fold.value:.6f}; k2 = 1e4 {plain:.6f}, 4e4 {four:.6f}, both together {better:.6f}")

# %% [markdown]
# ## Along the hardness
#
# P111 at A = 2 as the walls harden, a branch like any other. Left, the times: of arrival, and of leaving, which come
# together. Right, the multipliers, which say how fast a disturbance dies out.

# %%
branch = jv.follow(pairs[6][0], "hardness", (1.0, 8.0))
figure, axes = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
stay = np.pi / np.sqrt(1 + 10.0**branch.values - jv.contact_damping(10.0**branch.values, 0.7) ** 2)
arrived = branch.data["time"].values[:, branch.data["side"].values[0] == 1][:, 0]
period = 2 * np.pi / 2.1
arrived = np.mod(arrived + period / 2, period) - period / 2  # counted from phase 0 of the nearest period
axes[0].plot(branch.values, arrived, color=COLOURS[3], label="comes to the right wall")
axes[0].plot(branch.values, arrived + stay, color=COLOURS[0], label="leaves it, by half a free swing")
axes[0].axhline(orbit.impacts.time[orbit.impacts.side == 1][0], color="black", linestyle=":", label="rigid")
axes[0].set(ylabel="time $\\omega_0 t$")
for part, colour, told in (("real", COLOURS[0], "real part"), ("imag", COLOURS[3], "size of imaginary part")):
    larger = getattr(branch.multipliers[:, 0], part)
    axes[1].plot(branch.values, larger if part == "real" else abs(larger), color=colour, label=told)
    axes[1].axhline(abs(getattr(orbit.multipliers[0], part)) * (-1 if part == "real" else 1), color="black", ls=":")
axes[1].set(ylabel="multiplier of P111")
for ax in axes:
    ax.set(xlabel=jv.plot.style.parameter_label("hardness"))
    ax.legend()
keep(figure, "along_the_hardness")

# %% [markdown]
# ## What if the damping stays as it is?
#
# At a fixed gamma2 = 0.1 a stiffer wall has no time to take energy away. What it tends to is a rigid wall that gives
# all speed back, R = 1, and not any other:

# %%


def at_fixed_damping(hardness):
    """P111 where both walls have the damping 0.1."""
    fixed = {"left.damping": 0.1, "right.damping": 0.1}
    return jv.find_orbit(soft.replace(**fixed, hardness=hardness), START)


undamped = [at_fixed_damping(value) for value in HARDNESSES[high]]
elastic = jv.find_orbit(rigid.replace(restitution=1.0), undamped[-1].state, periods=1)
to_one, to_seven = (np.array([apart(one, each) for one in undamped])[:, 2] for each in (elastic, orbit))
for value, near, far in zip(HARDNESSES[high], to_one, to_seven, strict=True):
    print(f"k2 = 10^{value:g}: multipliers off those of R = 1 by {near:.5f}, of R = 0.7 by {far:.5f}")

# %% [markdown]
# ## The answer
#
# What rigid walls leave out is the time that the mass spends within a stop. For the amplitude at which P111 is lost, at
# this frequency and with R = 0.7, by the law:

# %%
constant = gaps[-1, 0] * np.sqrt(10.0 ** HARDNESSES[-1])
needed = {share: (constant / (share * fold.value)) ** 2 for share in (0.1, 0.01, 0.001)}
for share, stiffness in needed.items():
    stay = np.pi / np.sqrt(stiffness) / period
    print(f"within {share:6.1%}: k2 above {stiffness:.1e}; a stay takes {stay:.2%} of a period")

# %% [markdown]
# A stop 500 times as stiff as the spring changes the threshold by some ten per cent; for one per cent it must be 50,000
# times as stiff. Restitution alone does not say it: its damping must grow with its stiffness to be the same stop.

# %%
# What the text says holds, or this script fails.
assert abs(fold.value - 0.508057896812) < 1e-11
assert (abs(slopes + 0.5) < 0.01).all()
assert abs(better - fold.value) < 0.05 * abs(four - fold.value)
assert all(one.points("SN")[0].value > fold.value for one in responses)
assert branch.values[0] == 1.0 and branch.values[-1] == 8.0 and [one.kind for one in branch.special] == ["EP", "EP"]
assert max(apart(branch.orbit(-1), pairs[-1][0])) < 1e-9
assert abs(np.polyfit(HARDNESSES[high], np.log10(to_one), 1)[0] + 0.5) < 0.01 and to_seven.min() > 0.3
assert 4e4 < needed[0.01] < 6e4 and 4e2 < needed[0.1] < 6e2
