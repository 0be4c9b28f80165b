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
# # Which numbers made this record?
#
# A microphone hears a mass hit its stops: times, known to a thousandth, and from the sound which stop it was. Some
# hits were not heard. Which damping, which restitutions, which gap is that? The scene is fitted to the times; the
# errors tell how well each number is known, and what the record does not say at all.

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
    """Save a picture beside the others."""
    figure.savefig(OUT / f"09_{name}.png", dpi=120)


def heard(scene, state, periods):
    """(times, sides) of all impacts of some drive periods."""
    times, sides, length = [], [], 2.0 * np.pi / float(scene.frequency)
    for k in range(periods):
        state, impacts = jv.strobe(scene, state, slots=32)
        count = int(impacts.count)
        times += list(np.asarray(impacts.time)[:count] + k * length)
        sides += list(np.asarray(impacts.side)[:count])
    return np.array(times), np.array(sides)


# %% [markdown]
# ## A record that we make ourselves, so that the answer is known
#
# The motion is not periodic: neighbouring ones part, so that no single flight from the start explains it all. Fifty
# impacts are kept, with noise, and three of them are lost.

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
# It begins with numbers that are some per cent off; a scale says by how much each may be.

# %%
begun = true.replace(
    **{"damping": 0.05, "left.restitution": 0.8, "right.restitution": 0.75, "right.position": 1.1, "frequency": 1.74}
)
free = {"damping": 0.01, "left.restitution": 0.1, "right.restitution": 0.1, "right.position": 0.1, "frequency": 0.05}
fit = jv.fit(begun, data, free)
print(fit.table())
assert fit.status == jv.FitStatus.OK
found = np.array([time for time, _ in fit.missed])
print("lost:", times[lost], "found:", found)
assert np.allclose(found, times[lost], atol=20 * NOISE)

# %%
errors = [(fit.values[name] - float(true.parameter(name))) / fit.sigma[name] for name in free]
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), layout="constrained")
above.errorbar(errors, range(len(free)), xerr=1.0, fmt="o", color="#0072B2", capsize=4)
above.axvline(0.0, color="black", linewidth=0.8)
above.set_yticks(range(len(free)), list(free))
above.set_xlabel("fitted less true (standard errors)")
below.plot(data.times, fit.residuals, "o", color="#0072B2", markersize=4, label="heard")
for time, _ in fit.missed:
    below.axvline(time, color="#D55E00", linewidth=1.0, linestyle=(0, (4, 2)))
below.plot([], [], color="#D55E00", linestyle=(0, (4, 2)), label="lost, and found by the fit")
below.set(xlabel=r"time $\omega_0 t$", ylabel="measured less fitted (errors)")
below.legend(fontsize="small")
keep(figure, "fit")

# %% [markdown]
# The numbers hang together: the covariance tells how. Its ellipse of two of them holds the true pair.

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
# ## What a settled record does not say
#
# P111 hits each wall once a period, at the same phases for ever: fifty impacts say no more than two. More free numbers
# than that are refused, and the combinations that the record does hold are named.

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
# ## A camera in place of a microphone
#
# x is measured twenty times a period, and the right stop is soft: how stiff is it? The fit goes along the record and
# flies through every contact; which samples fall into one need not be known.

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
above.plot(times, seen.x, ".", color="#0072B2", markersize=4, label="seen")
above.axhline(0.9, color="black", linewidth=0.8, linestyle=(0, (4, 2)), label="soft stop")
above.set(ylabel="x")
above.legend(fontsize="small", loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0))
jv.plot.fit(fit, seen, below)
keep(figure, "samples")
