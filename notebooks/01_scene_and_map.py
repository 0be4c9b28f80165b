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
# # Does the tube hit its supports, and how often?
#
# A tube of a heat exchanger shakes in the flow. Where it passes a baffle it has some play: 0.4 mm to either side. We
# want to know at which shaking force it starts to knock against the baffle, how often it then does, and how hard.
#
# The tube's first bending mode moves like a mass on a spring, the baffle's hole is a pair of rigid walls.

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
    """Save a picture beside the others."""
    figure.savefig(OUT / f"01_{name}.png", dpi=120)


# %% [markdown]
# ## The scene
#
# In SI units: modal mass, damping, stiffness, and a force of 5 N. `scene_from_physical` makes the numbers that the
# rest works with: lengths in units of the play d = 0.4 mm, time in 1/w0.

# %%
MASS, STIFFNESS, PLAY, SPEED = 0.8, 8.0e3, 4.0e-4, 210.0  # kg, N/m, m, rad/s
scene = jv.scene_from_physical(
    mass=MASS,
    damping=8.0,
    stiffness=STIFFNESS,
    force=5.0,
    frequency=SPEED,
    restitution=0.7,
    walls=(-PLAY, PLAY),
)
for name in ("amplitude", "frequency", "damping", "restitution"):
    print(f"{name:12}{float(scene.parameter(name)):.4f}")

# %% [markdown]
# ## One drive period
#
# `strobe` takes a state at phase 0 of the drive one period further, counts the impacts on the way, and records four of
# them, or as many as `slots` asks for. It takes many states as easily as one, and what comes back has the shape of what
# went in. Here: from the middle, with velocities from -3 to 3.

# %%
speeds = np.linspace(-3.0, 3.0, 201)
states, impacts = jv.strobe(scene, jv.State(x=0.0, v=speeds))
figure, axes = plt.subplots(2, 1, figsize=(7, 6), layout="constrained", sharex=True)
axes[0].plot(speeds, states.x, ".", markersize=3, color="black")
axes[0].set_ylabel("position a period later, $x = X/d$")
axes[1].step(speeds, impacts.count, where="mid", color="black")
axes[1].set_yticks(range(3))
axes[1].set(xlabel=r"velocity at the start, $v = \dot X/(d\,\omega_0)$", ylabel="impacts in that period")
keep(figure, "strobe")

# %% [markdown]
# ## All that it settles on
#
# `find_attractors` takes many random starts, runs them on until they recur, and names what it found: P n p q is n drive
# periods with p impacts on the left and q on the right wall.

# %%
attractors = jv.find_attractors(scene, starts=100)
for one in attractors:
    print(f"{one.label}: {100 * one.share:.0f} % of the starts")

# %% [markdown]
# So at this force the tube swings freely for good, or knocks for good, depending on how it started: P100 and P111.
# `simulate` gives the trajectories for a picture: position against time, and velocity against position.

# %%
figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
motions = {}
for row, one in zip(axes, attractors, strict=True):
    motions[one.label] = jv.simulate(scene, one.state, periods=3, samples=300)
    jv.plot.trace(motions[one.label], scene, row[0])
    jv.plot.portrait(motions[one.label], scene, row[1])
    row[0].set_title(f"{one.label}: {motions[one.label].sizes['impact'] / 3:g} impacts a drive period")
keep(figure, "motions")

# %% [markdown]
# ## At which force it starts, and at which it stops
#
# A sweep: the force rises from 0, slowly, and falls again. The signs are the attractors from above.

# %%
amplitudes = np.linspace(0.0, 4.0, 201)
up = jv.sweep(scene, "amplitude", amplitudes, jv.State(x=0.0, v=0.0), settle=150, keep=20)
down = jv.sweep(scene, "amplitude", amplitudes[::-1], jv.State(x=0.9, v=-1.1), settle=150, keep=20)
figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", sharey=True)
for ax, leg in zip(axes, (up, down), strict=True):
    jv.plot.diagram(leg, "x", ax)
    jv.plot.mark(attractors, float(scene.amplitude), "x", ax)
    ax.legend()
keep(figure, "sweep")

# %% [markdown]
# Whether it knocks at a force can be read off the impacts of one more period from where a sweep has settled. The force
# is the amplitude A times K d.


# %%
def knocking(leg):
    """The forces of a sweep at which there is an impact in the period after the last one kept."""
    last, values = leg.isel(period=-1), leg["amplitude"].values
    _, impacts = jv.strobe(scene.replace(amplitude=values), jv.State(x=last["x"].values, v=last["v"].values))
    return values[np.asarray(impacts.count) > 0] * STIFFNESS * PLAY


starts_at, stops_at = knocking(up).min(), knocking(down).min()
print(f"rising, the knocking starts at {starts_at:.2f} N; falling, it goes on down to {stops_at:.2f} N")

# %% [markdown]
# ## The answer
#
# At 5 N a tube that is left alone swings freely. One that gets a push may go on knocking for good, twice a drive
# period, once at each side. By itself the knocking starts at about twice that force; to stop it again the force has to
# fall to about a seventh of where it started. How hard it knocks:

# %%
hardest = motions["P111"]["speed"].values.max()
print(f"impact speed {hardest:.2f} d w0, that is {hardest * PLAY * np.sqrt(STIFFNESS / MASS) * 1e3:.0f} mm/s")

# What the text says holds, or this script fails.
assert {one.label for one in attractors} == {"P100", "P111"}
assert motions["P111"].sizes["impact"] == 6 and motions["P100"].sizes["impact"] == 0
assert 1.9 < starts_at / 5.0 < 2.4 and 6 < starts_at / stops_at < 8
