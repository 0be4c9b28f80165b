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
# # Parameter maps
#
# This notebook computes maps over two parameters, as papers on impact oscillators show them: the label of the motion at
# each cell of a grid, its Lyapunov exponent, the number of coexisting attractors, and their resistance to shocks. It is
# for users who need such figures. Each map takes one call, and a store saves its results during the computation.

# %%
import tempfile
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
    figure.savefig(OUT / f"12_{name}.png", dpi=120)


scene = jv.make_scene(amplitude=4.65, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))

# %% [markdown]
# ## Labels and loci
#
# Each cell starts from rest. A label has the same colour in every map: the hue denotes the number of periods, chaos is
# nearly black, and undecided cells are grey. Each locus is followed from one point of the branch of P111: the
# saddle-node at which it begins, and its symmetry breaking.

# %%
grid = {"amplitude": np.linspace(0.5, 6.0, 60), "frequency": np.linspace(1.6, 3.6, 60)}
store = jv.Store(Path(tempfile.mkdtemp()) / "map.zarr")
found = jv.map_parameters(scene, grid, store=store)
figure, axes = plt.subplots(figsize=(7, 6.5), layout="constrained")
jv.plot.map(found, axes)
names, bounds = ("frequency", "amplitude"), {"frequency": (1.6, 3.6), "amplitude": (0.5, 6.0)}
branch = jv.follow(jv.find_orbit(scene.replace(amplitude=2.5), jv.State(0.0, 0.0)), "amplitude", (0.5, 6.0))
for special in (branch.points("SN")[0], branch.points("SB")[0]):
    jv.plot.locus(jv.locus(special, names, bounds), axes)
keep(figure, "labels")

# %% [markdown]
# Below the saddle-node P111 does not exist. Where the map shows P100 above it, the state of rest lies in the basin of
# the motion without impacts. Undecided cells lie where motions settle arbitrarily slowly, as along the symmetry
# breaking. An interrupted study resumes from its store, and a repeated call costs nothing:

# %%
again = jv.map_parameters(scene, grid, store=store)
print("identical:", again.identical(found), "- undecided cells:", int((found.label == 0).sum()))

# %% [markdown]
# The exponent of the same map is positive where the motion is chaotic.

# %%
figure, axes = plt.subplots(figsize=(7, 5.5), layout="constrained")
jv.plot.map(found, axes, "exponent")
keep(figure, "exponents")

# %% [markdown]
# ## Hysteresis: attractors carried in both directions
#
# At each amplitude one motion is carried up and down the frequency. Where the two directions end on different motions
# there is hysteresis.

# %%
grid = {"amplitude": np.linspace(1.0, 6.0, 26), "frequency": np.linspace(2.2, 3.6, 36)}
carried = jv.map_parameters(scene, grid, along="frequency", quantities=("label",))
figure, panels = plt.subplots(1, 2, figsize=(12, 6), layout="constrained")
for way, axes, title in zip((1, -1), panels, ("increasing frequency", "decreasing frequency"), strict=True):
    jv.plot.map(carried.sel(way=way), axes)
    axes.set_title(title)
keep(figure, "both_ways")
apart = (carried.label.sel(way=1) != carried.label.sel(way=-1)).mean()
print(f"the two directions differ at {100 * float(apart):.1f} % of the cells")

# %% [markdown]
# ## Coexisting attractors, shares and minimal fatal shocks
#
# Many random initial states per cell give the number of attractors. Along one parameter, `fractions` follows each
# attractor under one name and gives its share (basin stability) with bounds. `shocks` adds the minimal fatal shock of
# each attractor: the smallest impulse that makes the motion leave it.

# %%
grid = {"amplitude": np.linspace(3.5, 6.0, 11), "frequency": np.linspace(1.9, 2.6, 15)}
many = jv.map_parameters(scene, grid, 40, ("attractors",))
figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
jv.plot.map(many, axes, "attractors")
keep(figure, "attractors")

# %%
shares = jv.fractions(scene, "amplitude", np.linspace(4.4, 5.2, 17), 100, shocks=1 << 12)
figure, (above, below) = plt.subplots(2, 1, figsize=(7.5, 8), layout="constrained", sharex=True)
jv.plot.fractions(shares, above)
for place in range(shares.sizes["attractor"]):
    label = "/".join(dict.fromkeys(text for text in shares.label.values[:, place] if text))
    below.plot(shares.amplitude, shares.least_shock.isel(attractor=place), ".-", label=label)
below.set(xlabel="drive amplitude A", ylabel="minimal fatal shock at phase 0 (length w0)")
below.legend(frameon=False, fontsize="small")
keep(figure, "shares_and_shocks")
