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
# # Parameter estimation from a record
#
# This notebook estimates parameters of a scene from measurements (`fit`), first from impact times and then from samples
# of the position. It is for experimenters. A microphone records the impacts of a mass on its stops. The times have an
# error of 1e-3, and the sound identifies the stop. Some impacts are missing from the record. The unknowns are the
# damping, the restitutions, the gap and the frequency. The scene is fitted to the times. The standard errors show how
# well each parameter is determined, and which parameters the record does not determine at all.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
NOISE = 1e-3


def keep(figure, name):
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"09_{name}.png", dpi=120)


def heard(scene, state, periods):
    """Return (times, sides) of all impacts in a number of drive periods."""
    times, sides, length = [], [], 2.0 * np.pi / float(scene.frequency)
    for k in range(periods):
        state, impacts = jv.strobe(scene, state, slots=32)
        count = int(impacts.count)
        times += list(np.asarray(impacts.time)[:count] + k * length)
        sides += list(np.asarray(impacts.side)[:count])
    return np.array(times), np.array(sides)


# %% [markdown]
# ## A synthetic record
#
# The record is synthetic, and its parameters are known. The motion is not periodic. Nearby motions diverge, and a
# single simulation from the initial state therefore does not explain the whole record. The record contains fifty
# impacts with noise, from which three are removed.

# %%
true = jv.make_scene(5.3, 1.75, 0.043, 0.7, (jv.Wall(-0.9, 0.83), jv.Wall(1.12, 0.71)))
times, sides = heard(true, jv.State(0.3, -0.9), 40)
times, sides = times[:50], sides[:50]
rng = np.random.default_rng(3)
lost = [4, 19, 37]
told = np.delete(times + NOISE * rng.normal(size=50), lost), np.delete(sides, lost)
data = jv.ImpactRecord(*told, sigma=NOISE)

# %% [markdown]
# ## The fit
#
# The initial guess differs from the true parameters by some per cent. The scale of each parameter states by how much it
# may differ.

# %%
begun = true.replace(
    **{"damping": 0.05, "left.restitution": 0.8, "right.restitution": 0.75, "right.position": 1.1, "frequency": 1.74}
)
free = {"damping": 0.01, "left.restitution": 0.1, "right.restitution": 0.1, "right.position": 0.1, "frequency": 0.05}
fit = jv.fit(begun, data, free)
print(fit.table())
assert fit.status == jv.FitStatus.OK
found = np.array([time for time, _ in fit.missed])
print("removed:", times[lost], "detected as missing:", found)
assert np.allclose(found, times[lost], atol=20 * NOISE)

# %%
errors = [(fit.values[name] - float(true.parameter(name))) / fit.sigma[name] for name in free]
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), layout="constrained")
above.errorbar(errors, range(len(free)), xerr=1.0, fmt="o", color="#0072B2", capsize=4)
above.axvline(0.0, color="black", linewidth=0.8)
above.set_yticks(range(len(free)), list(free))
above.set_xlabel("fitted minus true (standard errors)")
below.plot(data.times, fit.residuals, "o", color="#0072B2", markersize=4, label="recorded")
for time, _ in fit.missed:
    below.axvline(time, color="#D55E00", linewidth=1.0, linestyle=(0, (4, 2)))
below.plot([], [], color="#D55E00", linestyle=(0, (4, 2)), label="missing, detected by the fit")
below.set(xlabel=r"time $\omega_0 t$", ylabel="measured minus fitted (errors)")
below.legend(fontsize="small")
keep(figure, "fit")

# %% [markdown]
# The estimates are correlated, as the covariance shows. The 95 % ellipse of two of them contains the true pair.

# %%
pair = ["left.restitution", "damping"]
block = fit.covariance.sel(name=pair, other=pair).values
turned = np.linspace(0.0, 2.0 * np.pi, 200)
ring = np.linalg.cholesky(block) @ np.array([np.cos(turned), np.sin(turned)])
figure, ax = plt.subplots(figsize=(6, 4.5), layout="constrained")
for size, style in ((1.0, "-"), (2.448, "--")):
    shown = "1 sigma" if size == 1.0 else "95 %"
    ax.plot(*(np.array([[fit.values[name]] for name in pair]) + size * ring), style, color="#0072B2", label=shown)
ax.plot(*[float(true.parameter(name)) for name in pair], "*", color="black", markersize=10, label="true")
ax.set(xlabel="restitution of the left wall", ylabel=r"damping $\gamma$")
ax.legend(fontsize="small")
keep(figure, "ellipse")

# %% [markdown]
# ## Limits of a periodic record
#
# P111 hits each wall once per period, always at the same phases. Fifty such impacts contain no more information than
# two. `fit` refuses a larger number of free parameters and names the combinations that the record determines.

# %%
calm = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
orbit = jv.find_orbit(calm, jv.State(0.9, -1.1))
times, sides = heard(calm, jv.State(float(orbit.state.x), float(orbit.state.v)), 25)
record = jv.ImpactRecord(times + NOISE * rng.normal(size=len(times)), sides, sigma=NOISE)
try:
    jv.fit(calm, record, {"damping": 0.01, "restitution": 0.1, "right.position": 0.1})
except jv.ArgumentError as error:
    print(error)

# %% [markdown]
# ## Samples of the position
#
# A camera replaces the microphone and measures x twenty times per period. The right stop is soft, and its stiffness is
# unknown. The fit proceeds along the record and integrates the motion through all contact phases. It does not require
# the user to state which samples fall into a contact phase.

# %%
soft = jv.make_scene(2.2, 1.2, 0.05, 0.7, (jv.Wall(-0.8, 0.75), jv.Wall(0.9, stiffness=45.0, damping=0.4)))
times = 2.0 * np.pi / 1.2 / 20 * np.arange(301)
states, _ = jv.sample(soft, jv.State(0.1, 0.6), times)
seen = jv.SampleRecord(times, np.asarray(states.x) + NOISE * rng.normal(size=len(times)), sigma=NOISE)
free = {"damping": 0.01, "left.restitution": 0.1, "right.stiffness": 5.0, "right.damping": 0.1}
start = soft.replace(**{"damping": 0.055, "left.restitution": 0.7, "right.stiffness": 41.0, "right.damping": 0.35})
fit = jv.fit(start, seen, free)
print(fit.table())
assert fit.status == jv.FitStatus.OK
assert all(abs(fit.values[name] - float(soft.parameter(name))) < 4.0 * fit.sigma[name] for name in free)

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
above.plot(times, states.x, color="0.6", linewidth=0.9, label="true motion")
above.plot(times, seen.x, ".", color="#0072B2", markersize=4, label="measured")
above.axhline(0.9, color="black", linewidth=0.8, linestyle=(0, (4, 2)), label="soft stop")
above.set(ylabel="x")
above.legend(fontsize="small", loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0))
jv.plot.fit(fit, seen, below)
keep(figure, "samples")
