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
# # Loci and the region of hysteresis
#
# This notebook continues bifurcations in two parameters (loci) and computes the region in which two motions coexist. It
# is for users who need stability boundaries in a plane of parameters. At one frequency of the drive, the previous
# notebook finds two coexisting attractors in a range of amplitudes: P100, which touches no wall, and P111, which hits
# both walls. Here this range is computed for all frequencies, with its dependence on the damping and on the restitution
# of the walls. The result is figure 12 of Cheng and Xu (2007).

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
PAIR = ("amplitude", "frequency")
BOUNDS = {"amplitude": (0.0, 9.0), "frequency": (0.6, 3.0)}


def keep(figure, name):
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"04_{name}.png", dpi=120)


# %% [markdown]
# ## The two boundaries
#
# Along the amplitude, P111 begins at a saddle-node (SN) and P100 ends at a grazing (GR). Both are special points of one
# branch:

# %%
scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))


def edges(scene):
    """Return the SN of P111 and the GR of P100 along the amplitude, from an orbit just below the grazing."""
    grazing = np.hypot(1 - scene.frequency**2, 2 * scene.damping * scene.frequency)  # equation (8)
    orbit = jv.find_orbit(scene.replace(amplitude=0.9 * grazing), jv.State(x=0.9, v=-1.1), periods=1)
    branch = jv.follow(orbit, "amplitude", (0.0, 6.0))
    return branch.points("SN")[0], branch.points("GR")[0]


fold, grazing = edges(scene)
print(f"P100 and P111 coexist from A = {fold.value:.6f} to {grazing.value:.6f} at frequency 2.1")

# %% [markdown]
# `locus` continues a special point along two parameters, such that it remains a point of the same kind:

# %%
folds, grazings = (jv.locus(point, PAIR, BOUNDS) for point in (fold, grazing))
print(folds.table())
print(grazings.table())

# %% [markdown]
# The saddle-node does not exist at all frequencies. Its locus ends on the locus of the grazing (GR), at a frequency
# just below 1, the natural frequency. On the locus of the grazing this point is reported as a resonant grazing (RG).
# The region of hysteresis lies between the two loci:

# %%
figure, ax = plt.subplots(figsize=(9, 6), layout="constrained")
for locus in (folds, grazings):
    jv.plot.locus(locus, ax)
jv.plot.region(folds, grazings, "P100 and P111", ax)
ax.legend()
keep(figure, "region")

# %% [markdown]
# ## Comparison with sweeps
#
# Sweeps at two frequencies, with decreasing (blue) and increasing (orange) amplitude, test the result. One frequency is
# above the point at which the loci meet, the other below it. The vertical lines mark the loci at these frequencies.

# %%
frequencies = (1.5, 0.8)
spans = ((0.0, 2.0), (0.2, 0.6))
legs, figure = [], plt.figure(figsize=(12, 4.5), layout="constrained")
for ax, frequency, (low, high) in zip(figure.subplots(1, 2), frequencies, spans, strict=True):
    values = np.linspace(low, high, 401)
    here, rest = scene.replace(frequency=frequency), jv.State(x=np.zeros(2), v=np.zeros(2))
    legs.append(jv.sweep(here, "amplitude", np.stack([values[::-1], values], -1), rest, settle=300, keep=4))
    jv.plot.diagram(legs[-1], "v", ax)
    for locus, style in ((folds, "-"), (grazings, ":")):
        across, up = locus.values[np.argsort(locus.values[:, 1])].T
        if up[0] <= frequency:
            ax.axvline(np.interp(frequency, up, across), color="black", linestyle=style)
    ax.set_title(f"frequency {frequency}")
keep(figure, "sweeps")

# %% [markdown]
# At 1.5 the two sweeps differ between the lines and nowhere else. At 0.8 no motion with impacts persists where P100
# exists, although just below the grazing its transient may last hundreds of periods. Beyond the grazing other motions
# follow each other in close succession.
#
# ## Influence of damping and restitution
#
# The next cell repeats the computation for three dampings and for three restitutions. The grazing does not depend on
# the restitution, because P100 has no impacts.

# %%
DAMPINGS, RESTITUTIONS = (0.05, 0.35, 0.65), (0.5, 0.7, 0.9)
COLOURS = ("#0072B2", "#E69F00", "#000000")


def both(scene):
    """Return the loci of both boundaries."""
    return [jv.locus(point, PAIR, BOUNDS) for point in edges(scene)]


damped = [both(scene.replace(damping=value)) for value in DAMPINGS]
softer = [both(scene.replace(restitution=value)) for value in RESTITUTIONS]
figure, axes = plt.subplots(1, 2, figsize=(14, 6), layout="constrained", sharey=True)
for pair, value, colour in zip(damped, DAMPINGS, COLOURS, strict=True):
    for locus in pair:
        jv.plot.locus(locus, axes[0], colour)
    jv.plot.region(*pair, f"{value:g}", axes[0], colour)
edge = softer[0][1]
for k, ((locus, _), colour) in enumerate(zip(softer, COLOURS, strict=True)):
    jv.plot.locus(locus, axes[1], colour)
    jv.plot.region(locus, edge, ", ".join(f"{value:g}" for value in RESTITUTIONS[k:]), axes[1], colour)
    edge = locus
jv.plot.locus(softer[0][1], axes[1])
for ax, name in zip(axes, ("damping", "restitution"), strict=True):
    ax.set_title(f"regions of P100 and P111, labelled by {name}")
axes[1].set_ylabel("")
keep(figure, "damping_and_restitution")

# %% [markdown]
# The region shrinks as the damping increases and as the restitution decreases. The next cell computes its width in
# amplitude, averaged over the frequencies from 1 to 3:

# %%
grid = np.linspace(1.0, 3.0, 201)


def width(pair):
    """Return the mean difference of the two amplitudes over the frequencies from 1 to 3."""
    low, high = (np.interp(grid, *one.values[np.argsort(one.values[:, 1])].T[::-1]) for one in pair)
    return float(np.mean(high - low))


for name, pairs, values in (("damping", damped, DAMPINGS), ("restitution", softer, RESTITUTIONS)):
    for pair, value in zip(pairs, values, strict=True):
        print(f"{name} {value:4.2f}: {width(pair):.3f}")

# %% [markdown]
# ## Conclusions
#
# P100 and P111 coexist between the saddle-node of P111 and the grazing of P100, if the frequency is above the value at
# which the two loci meet. At this value half a drive period equals half a period of the free oscillator: the frequency
# is sqrt(1 - gamma^2), for any restitution.
#
# | damping | frequency at which the loci meet |
# |---|---|
# | 0.05 | 0.998749 |
# | 0.35 | 0.936750 |
# | 0.65 | 0.759934 |
#
# At lower frequencies this saddle-node does not exist, down to 0.6, the lowest frequency examined. The existence of
# P111 does not imply its stability: at a symmetry breaking, whose locus also crosses the region, it is replaced by
# asymmetric motions.

# %%
# Checks: the script fails if a statement of the text does not hold.
assert abs(fold.value - 0.508057896812) < 1e-11 and abs(grazing.value - 3.416460156361) < 1e-11
assert [one.kind for one in folds.special] == ["GR", "EP"] and [one.kind for one in grazings.special] == [
    "EP",
    "RG",
    "EP",
]
for pairs, dampings, restitutions in ((damped, DAMPINGS, 3 * [0.7]), (softer, 3 * [0.05], RESTITUTIONS)):
    for (first, second), damping in zip(pairs, dampings, strict=True):
        meeting = np.sqrt(1.0 - damping**2)
        (end,), (met,) = first.points("GR"), second.points("RG")
        assert abs(end.values["frequency"] - meeting) < 1e-9 and abs(met.values["frequency"] - meeting) < 1e-9
        amplitude, frequency = second.values.T
        forced = np.sqrt((1 - frequency**2) ** 2 + (2 * damping * frequency) ** 2)
        assert abs(amplitude - forced).max() < 1e-11  # equation (8)
    assert all(float(first.scene.restitution) == value for (first, _), value in zip(pairs, restitutions, strict=True))
for pairs, way in ((damped, -1), (softer, 1)):
    assert (np.diff([width(pair) for pair in pairs]) * way > 0).all()

# The sweeps differ between the loci and nowhere else, up to one or two steps.
falling, rising = (legs[0]["v"].values[:, k, -1] for k in range(2))
amplitudes = np.linspace(*spans[0], 401)
differ = amplitudes[abs(falling[::-1] - rising) > 0.1]
low, high = (np.interp(1.5, *one.values[np.argsort(one.values[:, 1])].T[::-1]) for one in (folds, grazings))
assert low - 0.01 < differ.min() < low + 0.02 and high - 0.02 < differ.max() < high + 0.01
assert np.allclose(np.diff(differ), amplitudes[1] - amplitudes[0])
rising = legs[1]["v"].values[:, 1, -1]
below = np.linspace(*spans[1], 401) < np.interp(0.8, *grazings.values[np.argsort(grazings.values[:, 1])].T[::-1])
left = {name: legs[1][name].values[::-1, 0, -1][below] for name in ("x", "v")}
lasting, _ = jv.strobe(here.replace(amplitude=np.linspace(*spans[1], 401)[below]), jv.State(**left), periods=10_000)
assert abs(lasting.v - rising[below]).max() < 1e-9 and np.ptp(legs[1]["v"].values[300:], axis=-1).max() > 0.1
