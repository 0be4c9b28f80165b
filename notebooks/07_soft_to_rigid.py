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
# # Soft walls and the limit of rigid walls
#
# This notebook compares soft walls with rigid walls and measures how fast their difference vanishes as the stiffness
# increases. It is for users who must decide if a restitution describes a compliant stop well enough. A rubber buffer or
# a steel stop yields: the mass stays in it for a while and leaves it with a smaller speed. A rigid wall with a
# restitution R has the same effect instantaneously. The comparison uses P111, the motion that hits both walls once per
# drive period, and the drive amplitude at which it disappears.

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
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"07_{name}.png", dpi=120)


rigid = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## A soft wall with a given restitution
#
# Inside a soft wall, x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t). Without a drive, and with the wall at 0,
# the mass leaves the wall after half a damped oscillation, with the fraction R_eff of its speed:
#
#     R_eff = exp(-pi z / sqrt(1 - z^2)),    z = gamma2 / sqrt(1 + k2)
#
# A stiffer wall therefore needs more damping for the same restitution. `contact_damping` computes this damping, and
# `soften` replaces the rigid walls by such soft walls:

# %%
for stiffness in (1e2, 1e4, 1e6):
    damping = jv.contact_damping(stiffness, 0.7)
    same, fixed = (jv.effective_restitution(stiffness, each) for each in (damping, 0.1))
    print(f"k2 {stiffness:7.0e}: gamma2 {damping:8.3f} gives R_eff = {same:.3f}, gamma2 0.1 gives {fixed:.5f}")
soft = jv.soften(rigid, 1e4)

# %% [markdown]
# The stiffness of all soft walls is the parameter `hardness` of the scene, the decimal logarithm of k2. If it changes,
# R_eff of each wall stays constant: `soft.replace(hardness=6.0)`. The figure shows the response of P111 for four
# hardnesses, and for the rigid walls:

# %%
SHOWN = (2.0, 3.0, 4.0, 5.0)


def response(scene):
    """Return the branch of P111 along the drive amplitude, in both directions from 2."""
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
ax.set(xlabel="drive amplitude $A$", ylabel="impact speed", ylim=(0, None))
ax.legend(title="dashed: unstable; dots: saddle-nodes")
keep(figure, "response")

# %% [markdown]
# ## Rate of convergence
#
# P111 disappears at the saddle-node (SN) as the drive amplitude decreases. The next cell computes the differences
# between soft and rigid walls: in the amplitude of the SN, and in the impact times, impact speeds and multipliers at
# A = 2.

# %%
HARDNESSES = np.arange(3.0, 8.25, 0.5)
orbit = jv.find_orbit(rigid, START)
(fold,) = hard.points("SN")


def found_at(hardness):
    """Return P111 at A = 2 and the amplitude of its saddle-node for a hardness."""
    own = jv.find_orbit(soft.replace(hardness=hardness), START)
    (end,) = jv.follow(own, "amplitude", (0.0, 2.5), direction="backward", stop="SN").points("SN")
    return own, end.value


def apart(own, other):
    """Return the largest differences of impact times, impact speeds and multipliers between two orbits."""
    pairs = [(np.sort(each.impacts.time), each.impacts.speed, each.multipliers) for each in (own, other)]
    return [abs(a - b).max() for a, b in zip(*pairs, strict=True)]


pairs = [found_at(value) for value in HARDNESSES]
folds = np.array([value for _, value in pairs])
gaps = np.column_stack([abs(folds - fold.value), [apart(own, orbit) for own, _ in pairs]])
NAMES = ("amplitude of the saddle-node", "impact times", "impact speeds", "multipliers")
high = HARDNESSES >= 5.0
slopes = np.polyfit(HARDNESSES[high], np.log10(gaps[high]), 1)[0]
figure, ax = plt.subplots(figsize=(8, 6), layout="constrained")
for gap, slope, told, colour, mark in zip(gaps.T, slopes, NAMES, COLOURS, "os^D", strict=True):
    ax.loglog(10.0**HARDNESSES, gap, color=colour, marker=mark, label=f"{told}: slope {slope:.3f}")
ends = np.array([1e3, 1e8])
ax.loglog(ends, 0.5 * gaps[-1, 1] * np.sqrt(1e8 / ends), "k:", label="slope -1/2")
ax.set(xlabel="stiffness of the walls $k_2$", ylabel="difference from rigid walls")
ax.legend(title="slopes from $10^5$ to $10^8$")
keep(figure, "distance")
for told, slope in zip(NAMES, slopes, strict=True):
    print(f"{told}: {slope:+.4f}")

# %% [markdown]
# All differences decrease like k2^(-1/2), as does the time that the mass stays inside a wall. In this time the phase of
# the drive advances, and the drive acts while an impact on a rigid wall would already be over. To reduce the difference
# by a factor of ten, the walls must be a hundred times as stiff.
#
# The power law also permits extrapolation. From two soft computations the leading error cancels: twice the value at
# 4 k2 minus the value at k2.

# %%
four = found_at(4.0 + np.log10(4.0))[1]
plain = folds[list(HARDNESSES).index(4.0)]
better = 2 * four - plain
print(f"SN rigid {fold.value:.6f}; k2 = 1e4 {plain:.6f}, 4e4 {four:.6f}, extrapolated {better:.6f}")

# %% [markdown]
# ## A branch along the hardness
#
# P111 at A = 2 is followed along the hardness like along any other parameter. The left panel shows the times at which
# the mass reaches and leaves a wall, which approach each other. The right panel shows the multipliers, which determine
# how fast a perturbation decays.

# %%
branch = jv.follow(pairs[6][0], "hardness", (1.0, 8.0))
figure, axes = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
stay = np.pi / np.sqrt(1 + 10.0**branch.values - jv.contact_damping(10.0**branch.values, 0.7) ** 2)
arrived = branch.data["time"].values[:, branch.data["side"].values[0] == 1][:, 0]
period = 2 * np.pi / 2.1
arrived = np.mod(arrived + period / 2, period) - period / 2  # relative to phase 0 of the nearest period
axes[0].plot(branch.values, arrived, color=COLOURS[3], label="reaches the right wall")
axes[0].plot(branch.values, arrived + stay, color=COLOURS[0], label="leaves it, after half a free oscillation")
axes[0].axhline(orbit.impacts.time[orbit.impacts.side == 1][0], color="black", linestyle=":", label="rigid")
axes[0].set(ylabel="time $\\omega_0 t$")
for part, colour, told in (("real", COLOURS[0], "real part"), ("imag", COLOURS[3], "absolute imaginary part")):
    larger = getattr(branch.multipliers[:, 0], part)
    axes[1].plot(branch.values, larger if part == "real" else abs(larger), color=colour, label=told)
    axes[1].axhline(abs(getattr(orbit.multipliers[0], part)) * (-1 if part == "real" else 1), color="black", ls=":")
axes[1].set(ylabel="multiplier of P111")
for ax in axes:
    ax.set(xlabel=jv.plot.style.parameter_label("hardness"))
    ax.legend()
keep(figure, "along_the_hardness")

# %% [markdown]
# ## Stiffening at constant damping
#
# At a constant gamma2 = 0.1, the contact with a stiffer wall is too short to dissipate energy. The limit is a rigid
# wall that returns the full speed, R = 1, and no other:

# %%


def at_fixed_damping(hardness):
    """Return P111 for walls with the damping 0.1."""
    fixed = {"left.damping": 0.1, "right.damping": 0.1}
    return jv.find_orbit(soft.replace(**fixed, hardness=hardness), START)


undamped = [at_fixed_damping(value) for value in HARDNESSES[high]]
elastic = jv.find_orbit(rigid.replace(restitution=1.0), undamped[-1].state, periods=1)
to_one, to_seven = (np.array([apart(one, each) for one in undamped])[:, 2] for each in (elastic, orbit))
for value, near, far in zip(HARDNESSES[high], to_one, to_seven, strict=True):
    print(f"k2 = 10^{value:g}: multipliers differ from R = 1 by {near:.5f}, from R = 0.7 by {far:.5f}")

# %% [markdown]
# ## Conclusions
#
# Rigid walls neglect the time that the mass spends inside a stop. By the power law, the amplitude at which P111
# disappears requires the following stiffnesses, at this frequency and with R = 0.7:

# %%
constant = gaps[-1, 0] * np.sqrt(10.0 ** HARDNESSES[-1])
needed = {share: (constant / (share * fold.value)) ** 2 for share in (0.1, 0.01, 0.001)}
for share, stiffness in needed.items():
    stay = np.pi / np.sqrt(stiffness) / period
    print(f"within {share:6.1%}: k2 above {stiffness:.1e}; a contact phase takes {stay:.2%} of a period")

# %% [markdown]
# A stop 500 times as stiff as the spring changes this amplitude by about ten per cent. For one per cent it must be
# 50,000 times as stiff. The restitution alone does not determine this. For a stop to keep its restitution, its damping
# must grow with its stiffness.

# %%
# Checks: the script fails if a statement of the text does not hold.
assert abs(fold.value - 0.508057896812) < 1e-11
assert (abs(slopes + 0.5) < 0.01).all()
assert abs(better - fold.value) < 0.05 * abs(four - fold.value)
assert all(one.points("SN")[0].value > fold.value for one in responses)
assert branch.values[0] == 1.0 and branch.values[-1] == 8.0 and [one.kind for one in branch.special] == ["EP", "EP"]
assert max(apart(branch.orbit(-1), pairs[-1][0])) < 1e-9
assert abs(np.polyfit(HARDNESSES[high], np.log10(to_one), 1)[0] + 0.5) < 0.01 and to_seven.min() > 0.3
assert 4e4 < needed[0.01] < 6e4 and 4e2 < needed[0.1] < 6e2
