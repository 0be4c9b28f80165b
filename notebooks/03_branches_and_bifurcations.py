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
# # Branches of periodic orbits and their bifurcations
#
# This notebook follows branches of periodic orbits along a parameter and locates their bifurcations. It is for users
# who want to know where and why a motion jumps. The example is the figure in the README. As the drive amplitude changes
# slowly, the attractor changes gradually, and at some amplitudes the motion jumps. It jumps at one amplitude as the
# drive amplitude increases, and at another as it decreases. The notebook computes these amplitudes exactly and
# identifies the bifurcations.

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
    figure.savefig(OUT / f"03_{name}.png", dpi=120)


scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## A branch along the drive amplitude
#
# At A = 2 an orbit that hits each wall once per drive period is stable. `follow` continues this orbit along the
# amplitude in both directions, through stable and unstable parts (numerical continuation). The table of the branch
# lists the special points.

# %%
orbit = jv.find_orbit(scene, jv.State(x=0.9, v=-1.1))
main = jv.follow(orbit, "amplitude", (0.0, 6.0))
print(main.table())

# %% [markdown]
# The table, read from its end:
#
# - At A = 6 the symmetric P111, whose impacts on both walls are alike, is unstable. It becomes stable at a symmetry
#   breaking (SB) at A = 3.544.
# - Its impacts become slower as A decreases, down to a saddle-node (SN) at 0.508. There the branch turns round and
#   returns to larger A, unstable.
# - At the grazing (GR) at 3.416 the speeds of the impacts vanish, and the orbit coincides with P100, which touches no
#   wall. The entry "P100< P111<" states that both orbits exist on the side of smaller A. Beyond the grazing neither
#   exists.
#
# The figure shows the branch over two sweeps, one with decreasing and one with increasing A. Thick lines are stable,
# dashed lines unstable. The arrows mark the jumps.

# %%
amplitudes = np.linspace(0.0, 6.0, 301)
starts = jv.State(x=np.array([0.9, 0.0]), v=np.array([-1.1, 0.0]))
swept = jv.sweep(scene, "amplitude", np.stack([amplitudes[::-1], amplitudes], axis=-1), starts, settle=150, keep=20)


def over_sweeps(variable, ax, *branches):
    """Plot branches over the sweeps."""
    jv.plot.diagram(swept, variable, ax)
    for branch in branches:
        jv.plot.branch(branch, variable, ax)


figure, axes = plt.subplots(2, 1, figsize=(11, 8.5), layout="constrained", sharex=True)
for variable, ax in zip("xv", axes, strict=True):
    over_sweeps(variable, ax, main)
jv.plot.mark_points([main], axes[0])
axes[0].set_xlabel("")
axes[0].legend()
for value, before, after in ((0.508, 1.46, 0.02), (3.416, 0.13, 2.23)):
    axes[1].annotate("", (value, after), (value, before), arrowprops={"arrowstyle": "->", "color": "#D55E00"})
keep(figure, "main")

# %% [markdown]
# Between 0.508 and 3.416 two attractors coexist, and an unstable orbit lies between them. As A increases, the mass
# follows P100 to the grazing, where it must jump. As A decreases, the mass follows P111 to the saddle-node and jumps
# there. This is the hysteresis.
#
# The next cell reads the values of the jumps from the sweeps. Without impacts the motion is proportional to A, which
# identifies P100.

# %%
grazing, fold, breaking = (main.points(kind)[0] for kind in ("GR", "SN", "SB"))
free = grazing.meets[0]
falling, rising = (swept.isel(lane=k) for k in range(2))


def is_free(leg):
    """Test for each value of a sweep if the motion is P100."""
    return abs(leg["v"].values[:, -1] / free.state.v - leg["amplitude"].values / free.scene.amplitude) < 0.01


free_up, free_down = (leg["amplitude"].values[is_free(leg)].max() for leg in (rising, falling))
print(f"increasing A: P100 up to {free_up:.2f}; decreasing A: P100 from {free_down:.2f} on")

# %% [markdown]
# The sweeps jump between 3.38 and 3.40, and between 0.52 and 0.50. The first jump is slightly early, because P100 is
# stable up to 3.416. Each step of 0.02 perturbs the motion, and at 3.40 P100 turns at a distance of 0.005 from the
# walls. The branch is free of such perturbations.
#
# ## Symmetry breaking
#
# No motion jumps at the symmetry breaking. P111 becomes unstable, and two other orbits emanate from it, mirror images
# of each other. `switch` follows both. The table is that of the branch that later hits the right wall twice:

# %%
one, twin = sorted(jv.switch(breaking), key=lambda half: half.segments[-1].label)
print(one.table())

# %% [markdown]
# The new orbit is stable up to a grazing at 5.304, where it meets an unstable P112. This P112 originates in a
# saddle-node at 4.525. The stable P112 from the same saddle-node has a period doubling (PD) at 4.787. `switch`
# continues from this point as well, and `stop` ends the new branch at its own period doubling. The multiplier 1 in the
# first line of its table is the square of the multiplier -1 of P112.

# %%
(doubling,) = one.points("PD")
(double,) = jv.switch(doubling, stop="PD")
print(double.table())

# %%
figure, ax = plt.subplots(figsize=(11, 5.5), layout="constrained")
over_sweeps("x", ax, main, one, twin, double)
ax.set(xlim=(3.48, 6.0), ylim=(-0.75, 1.02))
jv.plot.mark_points([main, one, double], ax)
ax.legend(loc="lower left", ncols=2, fontsize="small")
keep(figure, "all")

# %% [markdown]
# The sweep with increasing A jumps a second time, at a grazing: it follows P111 up to 5.28, and at 5.30 no two of the
# 20 recorded periods are equal. Such a motion is on no branch, because a branch contains orbits of one period. None of
# the located points marks the return of the sweep with decreasing A to P111, between 5.04 and 5.02.
#
# Neither sweep shows P112, although it is stable from 4.525 to 4.787. Each point of a branch is an `Orbit`. The figure
# shows this P112 and the two orbits that end by grazing.

# %%
touching, slow = one.points("GR")[0].meets
born, lost = (one.points(kind)[0].place for kind in ("SN", "PD"))
unseen = one.orbit((born + lost) // 2)
figure, axes = plt.subplots(1, 3, figsize=(13, 4.5), layout="constrained")
for ax, each in zip(axes, (free, touching, unseen), strict=True):
    jv.plot.orbit(each, ax)
    ax.set_title(f"{each.label} at A = {each.scene.amplitude:.3f}")
keep(figure, "orbits")

# %% [markdown]
# ## Multipliers along the branches
#
# An orbit is stable as long as both multipliers are smaller than 1 in modulus. The left panel shows the multipliers of
# P100 and of the symmetric P111, the right panel those of the asymmetric P111 and of P112:

# %%
figure, axes = plt.subplots(1, 2, figsize=(13, 5), layout="constrained", sharey=True)
colours = {"P100": "#E69F00", "P111": "#0072B2", "P112": "#D55E00"}
for ax, branch in zip(axes, (main, one), strict=True):
    for part in branch.segments:
        places = slice(part.first, part.last + 1)
        lines = ax.semilogy(branch.values[places], abs(branch.multipliers[places]), color=colours[part.label])
        lines[0].set_label(part.label)
    ax.axhline(1.0, color="black", linewidth=0.8)
    ax.set(xlabel="drive amplitude $A$", ylim=(1e-4, 1e4))
    jv.plot.mark_points([branch], ax)
    ax.legend(loc="lower left")
axes[0].set_ylabel("modulus of the multipliers")
keep(figure, "multipliers")

# %% [markdown]
# At SN, SB and PD the modulus of one multiplier passes through 1. Before the two grazings the stable orbits show
# nothing of the kind: the modulus is 0.86 where P100 ends and 0.42 where P111 ends. The multipliers of the unstable
# orbits have a pole at the grazing. Near 5.304 the larger multiplier of P112 is 5.57 / speed, with the speed of its
# slowest impact. At 3.416 the speeds of two impacts vanish at once, and the larger multiplier is 48.2 / speed^2.
#
# The times and speeds of the impacts, for which `follow` solves, have no such pole. The curves of P111 and P112 join at
# a corner, and the speed of the additional impact grows linearly from 0:

# %%
figure, axes = plt.subplots(1, 2, figsize=(13, 4.5), layout="constrained")
turns = np.mod(one.data["time"].values * float(scene.frequency) / (2 * np.pi), 1.0)
for part in one.segments:
    here = slice(part.first, min(part.last, born) + 1)  # P112 up to its saddle-node
    for ax, values in zip(axes, (turns, one.data["speed"].values), strict=True):
        lines = ax.plot(one.values[here], values[here], ".-", color=colours[part.label], markersize=4)
        lines[0].set_label(part.label)
axes[0].set(ylabel="impact times, in drive periods", ylim=(0.0, 1.0))
axes[1].set(ylabel=r"impact speeds$\,/\,(d\,\omega_0)$")
for ax in axes:
    ax.set(xlabel="drive amplitude $A$", xlim=(4.5, 5.35))
    ax.legend(loc="lower left")
keep(figure, "grazing")

# %% [markdown]
# ## Other parameters, monitors and files
#
# Any parameter of the scene can replace the amplitude. Along the frequency from 1 to 4, at A = 2, P111 is unstable
# between two symmetry breakings, and stable below and above them:

# %%
by_frequency = jv.follow(orbit, "frequency", (1.0, 4.0))
print(by_frequency.table())

# %% [markdown]
# A monitor is a user-defined test function of a point. Its sign changes are located as special points. The monitor
# below locates the value of A at which the largest impact speed is 2. The branch ends there, because `stop` names the
# monitor. (`initial` is required because P100 has no impact speeds.)

# %%
fast = {"speed 2": lambda point: point.speeds.max(initial=0.0) - 2.0}
reached = jv.follow(orbit, "amplitude", (0.0, 6.0), direction="forward", monitors=fast, stop="speed 2")
print(reached.table())

# %% [markdown]
# A branch can be saved to a file, loaded and extended. Up to A = 8 the symmetric P111 stays unstable:

# %%
main.save(OUT / "03_main.nc", force=True)
again = jv.load_branch(OUT / "03_main.nc")
longer = jv.extend(again, (0.0, 8.0))
print(longer.table())

# %% [markdown]
# ## Conclusions
#
# The motion jumps where its branch ends or turns round:
#
# | A | bifurcation | motion |
# |---|---|---|
# | 0.508057896812 | saddle-node of P111 | jumps to P100 as A decreases |
# | 3.416460156361 | P100 grazes both walls | jumps to P111 as A increases |
# | 3.543892249375 | symmetry breaking of P111 | continues as one of two asymmetric P111, without a jump |
# | 5.304177743857 | the asymmetric P111 grazes a wall | jumps to a motion without a short period as A increases |
#
# Both jumps at increasing A are grazings, of which the multipliers give no warning. In addition, a stable P112 and its
# mirror image exist from 4.525079701581 to 4.787450372300, and orbits of twice their period are stable up to
# 4.929889076580. No sweep reaches these orbits.

# %%
# Checks: the script fails if a statement of the text does not hold.
for special, value in (
    (fold, 0.508057896812),
    (grazing, 3.416460156361),
    (breaking, 3.543892249375),
    (one.points("GR")[0], 5.304177743857),
    (one.points("SN")[0], 4.525079701581),
    (doubling, 4.787450372300),
    (double.points("PD")[0], 4.929889076580),
):
    assert abs(special.value - value) < 1e-11, special
assert [each.kind for each in main.special] == ["EP", "GR", "SN", "SB", "EP"]
assert [each.kind for each in one.special] == ["EP", "GR", "SN", "PD", "EP"]
assert [each.label for each in grazing.meets] == ["P100", "P111"] and touching.stable and not slow.stable
assert all(each.scene.amplitude < grazing.value for each in grazing.meets)
assert all(each.scene.amplitude < one.points("GR")[0].value for each in (touching, slow))

# Stability of each orbit between the special points.
stable = main.stable
assert stable[: grazing.place].all() and not stable[grazing.place : fold.place].any()
assert stable[fold.place + 1 : breaking.place].all() and not stable[breaking.place + 1 :].any()
assert one.stable[1 : one.points("GR")[0].place].all() and one.stable[born + 1 : lost].all()
assert not one.stable[one.points("GR")[0].place + 1 : born].any() and not one.stable[lost + 1 :].any()
assert double.stable[1:-1].all() and np.allclose(twin.values, one.values) and twin.segments[-1].label == "P121"
assert (unseen.label, unseen.stable) == ("P112", True) and np.allclose(double.multipliers[0, 0], 1.0)

# The sweeps: the values of the jumps, the motions after them, and P111 where P112 is stable too.
assert np.allclose((free_up, free_down), (3.38, 0.50)) and abs(1 - 3.40 / grazing.value - 0.005) < 0.0005
down, up = falling["x"].values[::-1], rising["x"].values
assert np.isclose(*(leg[np.isclose(amplitudes, 3.40), -1] for leg in (down, up)))
lasting = slice(0, one.segments[0].last + 1)
known = np.interp(amplitudes, one.values[lasting], one.data["x"].values[lasting, 0])
for leg, end in ((down, 5.02), (up, 5.28)):
    repeats = np.ptp(leg, axis=-1) < 0.1
    assert np.isclose(amplitudes[np.argmin(repeats)], end + 0.02)
    alike = (amplitudes > 4.5) & (amplitudes < end + 0.01)
    assert abs(leg[alike, -1] - known[alike]).max() < 0.005
assert len(np.unique(up[np.isclose(amplitudes, 5.30)].round(4))) == 20

# Multipliers at the grazings; the speed of the additional impact.
assert abs(abs(free.multipliers[0]) - 0.86) < 0.005 and abs(abs(touching.multipliers[0]) - 0.42) < 0.005
pole, double_pole = abs(slow.multipliers[0]) * slow.least_speed, abs(grazing.meets[1].multipliers[0])
assert abs(pole - 5.57) < 0.005 and abs(double_pole * grazing.meets[1].least_speed ** 2 - 48.2) < 0.05
near = one.segments[1].first + np.array([1, 2])
slopes = one.data["least_speed"].values[near] / (one.points("GR")[0].value - one.values[near])
assert abs(slopes[1] / slopes[0] - 1) < 0.01

# Other parameters, monitors and files.
low, high = (each.place for each in by_frequency.points("SB"))
assert by_frequency.stable[:low].all() and by_frequency.stable[high + 1 :].all()
assert not by_frequency.stable[low + 1 : high].any() and len(by_frequency.special) == 4
assert abs(reached.orbit(-1).impacts.speed.max() - 2.0) < 1e-9 and "speed 2" in reached.reason["last"]
assert again.data.equals(main.data) and longer.values[-1] == 8.0 and len(longer.special) == len(main.special)
assert not longer.stable[len(main) :].any()
