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
# # Which start ends where, and what lies between?
#
# At one amplitude the oscillator between two walls has several motions that last. Which of them it settles on depends
# on where it starts. Here we draw that for figure 5 of Cheng and Xu (2007), find what separates the starts, and look
# for the chaos that the paper shows.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvibro as jv

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)
X, V = np.linspace(-1.0, 1.0, 161), np.linspace(-4.0, 4.0, 241)


def keep(figure, name):
    """Save a picture beside the others."""
    figure.savefig(OUT / f"05_{name}.png", dpi=120)


# %% [markdown]
# ## What lasts
#
# The paper's figure is at A = 4.65. Two hundred random starts settle on four motions, two pairs of mirror images. None
# is chaotic: their largest Lyapunov exponents are negative.

# %%
scene = jv.make_scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
attractors = jv.find_attractors(scene)
for one in attractors:
    print(f"{one.label}: {100 * one.share:.1f} % of the starts, largest exponent {one.exponent:+.3f} a period")

# %% [markdown]
# ## Which start ends where
#
# `basins` runs each start of a grid until it is certain where it ends.

# %%
basins = jv.basins(scene, X, V, attractors=attractors)
for name, share, error in zip(
    basins["name"].values, basins["fraction"].values, basins["fraction_error"].values, strict=True
):
    print(f"{name}: {100 * share:.2f} +- {100 * error:.2f} % of the starts")
print(f"dimension of the boundary {basins.attrs['boundary_dimension']:.2f}")

# %% [markdown]
# ## What lies between
#
# Between two basins lies a curve of starts that end on neither: they come to an unstable motion, a saddle. There are
# three: the symmetric P111, which lost its stability at 3.544, and the two partners of P112 and P121, born with them at
# 4.525. All are on the branches of figure 4.

# %%
diagram = jv.explore(scene, "amplitude", (0.0, 6.0), max_period=1)
saddles = []
for branch in diagram.branches:
    ahead = branch.values - float(scene.amplitude)
    for place in np.flatnonzero(ahead[:-1] * ahead[1:] <= 0):
        orbit = jv.find_orbit(scene, branch.orbit(int(place)).state, periods=1, settle=0)
        if orbit.multipliers[0].real > 1:
            saddles.append(orbit)
            print(f"{orbit.label} at ({orbit.state.x:.6f}, {orbit.state.v:.6f}): multipliers {orbit.multipliers.real}")

# %%
figure, ax = plt.subplots(figsize=(6, 8), layout="constrained")
jv.plot.basins(basins, ax)
for orbit in saddles:
    jv.plot.manifold(jv.manifold(orbit, "stable", length=30.0, phase=0.0), ax)
keep(figure, "basins")

# %% [markdown]
# The curves are the saddles' stable manifolds, grown backward in time from the saddles: they are the edges of the
# basins. The paper says so of the symmetric saddle alone; the smaller basins are bounded by the two others.
#
# The unstable manifolds lead from each saddle to the motions on both sides of it:

# %%
figure, ax = plt.subplots(figsize=(6, 8), layout="constrained")
jv.plot.basins(basins, ax)
for orbit in saddles:
    jv.plot.manifold(jv.manifold(orbit, "unstable", length=8.0, phase=0.0), ax)
keep(figure, "unstable")

# %% [markdown]
# ## Where is the chaos?
#
# The Lyapunov exponents tell, along the amplitude. Each value starts from the same state, on the way to P112 where that
# lasts. Where the larger exponent is above 0, nearby motions part: chaos.

# %%
values = np.linspace(4.55, 5.45, 46)
start = next(one for one in attractors if one.label == "P112").state
spectrum = jv.spectrum(scene, "amplitude", values, start, error=0.02)
figure, ax = plt.subplots(figsize=(8, 4.5), layout="constrained")
jv.plot.spectrum(spectrum, ax)
keep(figure, "spectrum")
chaotic = spectrum["exponent"].values[:, 0] > 3 * spectrum["error"].values[:, 0]
print("chaotic at A =", ", ".join(f"{value:.2f}" for value in values[chaotic]))

# %% [markdown]
# ## The answer
#
# The paper's figure 5 is said to be at A = 4.65 and shows a chaotic attractor in white. At 4.65 there is none: P112
# and P121 are still periodic there. They double their periods from 4.787 on and become chaotic before 5.0, where the
# chaotic sets have the basins that P112 and P121 had: `jaxvibro paper fig5` draws both.
