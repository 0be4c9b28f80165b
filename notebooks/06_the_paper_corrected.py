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
# # Reproduction of a paper: claims and verdicts
#
# This notebook shows how `jaxvibro paper` recomputes the figures of Cheng and Xu (2007) and compares each claim with
# the computed numbers. It is for readers of the paper and for users who want to verify jaxvibro. The paper shows
# figures of an oscillator between two walls and states numbers read from them. The notebook covers the formulas and the
# case of one wall. The complete reproduction takes some minutes:
#
#     jaxvibro paper            # all figures and claims, into out/paper/report.html
#     jaxvibro paper fig5       # one figure

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv
from jaxvibro.reproduction.closed_forms import (
    grazing_amplitude,
    single_wall_fold,
    symmetric_fold,
    symmetric_orbit_state,
)

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)

# %% [markdown]
# ## Formulas
#
# A claim has a printed value, a computed value with an error bar, and a verdict that follows from both. A printed
# number agrees if the computed one lies within half a unit of its last digit. A claim in words holds if its number is
# in the range that the words state. "Printed" refers to our copy of the paper, which is a scan. Rows marked "ours" are
# not claims of the paper.

# %%
report = jv.paper(["formulas"], OUT / "paper")


def show(claims):
    """Print each claim with its verdict, and the reason if it is not right."""
    for one in claims:
        printed = f", printed {one.printed}" if one.printed else ""
        print(f"{one.figure:12s} {'(ours) ' if one.ours else ''}{one.text}{printed}")
        print(f"{'':12s} computed {one.value:.12g} +- {one.error:.1g}: {one.verdict}")
        if one.reason and not one.is_right:
            print(f"{'':12s} {one.reason}")


show(one for one in report.claims if one.figure.startswith("("))

# %% [markdown]
# ## Onset of P111
#
# The paper gives the amplitude at which the symmetric P111 begins as the double root A_c of an equation for its impact
# speed u. The double root is a saddle-node only if it has u > 0, because a mass cannot arrive at a wall with a negative
# speed. The sign of u is that of sin(pi r / omega) with r = sqrt(1 - gamma^2), which the paper does not state. It is
# positive for omega above r, and again from r / 3 to r / 2, from r / 5 to r / 4, ...

# %%
DAMPING, RESTITUTION = 0.05, 0.7
frequencies = np.linspace(0.2, 2.6, 800)
folds, speeds = jax.vmap(symmetric_fold, (0, None, None))(frequencies, DAMPING, RESTITUTION)
figure, (ax, below) = plt.subplots(2, 1, figsize=(6, 6), sharex=True, layout="constrained")
ax.plot(frequencies, np.where(speeds > 0, folds, np.nan), color="#0072B2", label="$A_c$, a saddle-node")
ax.plot(frequencies, np.where(speeds > 0, np.nan, folds), color="#0072B2", linestyle=":", label="$A_c$ with u < 0")
ax.plot(frequencies, np.hypot(1 - frequencies**2, 2 * DAMPING * frequencies), color="black", label="grazing of P100")
below.plot(frequencies, np.sign(speeds), color="#0072B2", label="sign of u")
sine = np.sin(np.pi * np.sqrt(1 - DAMPING**2) / frequencies)
below.plot(frequencies, sine, color="0.5", label=r"$\sin(\pi r / \omega)$")
ax.set(ylabel="drive amplitude $A$", ylim=(0, 3))
below.set(xlabel=r"drive frequency $\omega$")
for each in (ax, below):
    each.legend(frameon=False)
figure.savefig(OUT / "06_where_p111_begins.png", dpi=120)

# %% [markdown]
# The branch through the attractor at a larger amplitude confirms this. At 1.5 it has the saddle-node at A_c. At 0.8
# P111 has no saddle-node.

# %%
for frequency, high in ((1.5, 3.0), (0.8, 0.6)):
    scene = jv.make_scene(2.0, frequency, DAMPING, RESTITUTION, (-1.0, 1.0))
    diagram = jv.explore(scene, "amplitude", (0.0, high), max_period=1)
    found = [one.value for one in diagram.points("SN") if one.label == "P111"]
    exact, speed = (float(one) for one in symmetric_fold(frequency, DAMPING, RESTITUTION))
    print(f"frequency {frequency}: A_c = {exact:.12f} with u = {speed:+.3f}; saddle-nodes of P111 found: {found}")

# %% [markdown]
# At frequency 0.4, in the first of the intervals below r (r / 3 to r / 2), P111 exists slightly above A_c, where P100
# has not yet grazed.

# %%
begin, speed = (float(one) for one in symmetric_fold(0.4, DAMPING, RESTITUTION))
scene = jv.make_scene(begin + 1e-3, 0.4, DAMPING, RESTITUTION, (-1.0, 1.0))
orbit = jv.find_orbit(scene, symmetric_orbit_state(scene), periods=1, settle=0)
print(
    f"frequency 0.4: A_c = {begin:.6f} with u = {speed:+.3f}; P100 grazes at"
    f" {float(grazing_amplitude(0.4, DAMPING)):.6f}"
)
print(f"    at A = {float(scene.amplitude):.6f} {orbit.label} is {'stable' if orbit.stable else 'unstable'}")

# %% [markdown]
# ## One wall
#
# For one wall the paper states that "the condition is the same". The condition has the same form, but with a full
# period and the opposite sign: P101 begins in a saddle-node where sin(r T) < 0.

# %%
for frequency in (1.5, 0.55, 2.1):
    exact, speed = (float(one) for one in single_wall_fold(frequency, DAMPING, RESTITUTION))
    turn = 2 * np.pi * np.sqrt(1 - DAMPING**2) / frequency
    signs = f"sin(r T) = {np.sin(turn):+.3f}, sin(r T / 2) = {np.sin(turn / 2):+.3f}, u = {speed:+.3f}"
    print(f"frequency {frequency}: {signs}")
    scene = jv.make_scene(2.0, frequency, DAMPING, RESTITUTION, (None, 1.0))
    diagram = jv.explore(scene, "amplitude", (0.0, 4.0), max_period=1)
    found = [one.value for one in diagram.points("SN") if one.label == "P101"]
    print(f"    A_c = {exact:.12f}; saddle-nodes of P101 found: {found}")

# %% [markdown]
# ## Conclusions
#
# | statement of the paper, as in our copy | correct statement |
# |---|---|
# | gamma = C / (M w0) | C / (2 M w0) |
# | A_c = 1.334 at frequency 2.1, damping 0.05, restitution 0.7 | 0.508057896812 |
# | P111 begins at A_c | where sin(pi r / omega) > 0; elsewhere at the grazing, without hysteresis |
# | A_c and the grazing meet near frequency 1 | at r / m; hysteresis above r and in every second interval below |
# | multipliers are eigenvalues of P | of M, the product of all P and Q |
# | one wall: the condition is the same | sin(r T) < 0 instead of sin(r T / 2) > 0 |
