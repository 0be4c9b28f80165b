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
# # Basins of attraction, invariant manifolds and chaos
#
# This notebook computes basins of attraction, the invariant manifolds that bound them, and Lyapunov exponents. It is
# for users with coexisting attractors. At one amplitude the oscillator between two walls has several attractors, and
# the initial state determines which of them it approaches. The notebook computes the basins for figure 5 of Cheng and
# Xu (2007), finds the sets that separate them, and searches for the chaos that the paper shows.

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
    """Save a figure to the output folder."""
    figure.savefig(OUT / f"05_{name}.png", dpi=120)


# %% [markdown]
# ## Attractors
#
# The figure of the paper is at A = 4.65. Two hundred random initial states approach four attractors, two pairs of
# mirror images. None is chaotic: their largest Lyapunov exponents are negative.

# %%
scene = jv.make_scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
attractors = jv.find_attractors(scene)
for one in attractors:
    print(f"{one.label}: {100 * one.share:.1f} % of initial states, largest exponent {one.exponent:+.3f} per period")

# %% [markdown]
# ## Basins of attraction
#
# `basins` simulates each initial state of a grid until its attractor is certain.

# %%
basins = jv.basins(scene, X, V, attractors=attractors)
for name, share, error in zip(
    basins["name"].values, basins["fraction"].values, basins["fraction_error"].values, strict=True
):
    print(f"{name}: {100 * share:.2f} +- {100 * error:.2f} % of initial states")
print(f"dimension of the basin boundary {basins.attrs['boundary_dimension']:.2f}")

# %% [markdown]
# ## Saddles between the basins
#
# Two basins are separated by a curve of initial states that approach neither attractor. They approach an unstable
# orbit, a saddle. There are three saddles: the symmetric P111, which loses its stability at 3.544, and the unstable
# partners of P112 and P121, which originate with them in saddle-nodes at 4.525. All three are on the branches of figure
# 4.

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
# The curves are the stable manifolds of the saddles, grown backward in time from the saddles. They are the boundaries
# of the basins. The paper states this for the symmetric saddle only; the other two saddles bound the smaller basins.
#
# The unstable manifolds lead from each saddle to the attractors on both sides of it:

# %%
figure, ax = plt.subplots(figsize=(6, 8), layout="constrained")
jv.plot.basins(basins, ax)
for orbit in saddles:
    jv.plot.manifold(jv.manifold(orbit, "unstable", length=8.0, phase=0.0), ax)
keep(figure, "unstable")

# %% [markdown]
# ## Lyapunov exponents
#
# The Lyapunov exponents along the amplitude (`spectrum`) show where chaos occurs. All values use the same initial
# state, which leads to P112 where that orbit is stable. Where the larger exponent is positive, nearby motions diverge:
# the motion is chaotic.

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
# ## Conclusions
#
# According to the paper, its figure 5 is at A = 4.65. It shows a chaotic attractor in white. At 4.65 there is none,
# because P112 and P121 are still periodic there. They have period doublings from 4.787 on and become chaotic before
# 5.0, where the chaotic attractors have the basins that P112 and P121 had. `jaxvibro paper fig5` draws both amplitudes.
