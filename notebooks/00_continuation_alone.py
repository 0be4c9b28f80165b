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
# # The package `continuation`: equilibria, maps and cycles
#
# This notebook applies numerical continuation to problems without impacts. It is for users who have equations of their
# own, written for JAX. `jaxvibro` continues orbits with the package `continuation`, which does not depend on any
# oscillator model. Here the package is used alone, on a chemical reaction, a map and a model of the atmosphere. Such
# equations require nothing else.

# %%
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import continuation as co
from continuation.shooting import periodic_orbits

jax.config.update("jax_enable_x64", True)
OUT = Path("out")
OUT.mkdir(exist_ok=True)

# %% [markdown]
# ## Equilibria and the Hopf point
#
# The Brusselator has two concentrations and two parameters. `equilibria` takes the right-hand side of u' = f. `trace`
# continues the equilibrium along b, starting from an approximate solution. In closed form the Hopf point (HB) is at
# b = 1 + a^2.


# %%
def brusselator(u, p, args):
    x, y = u
    return jnp.stack([p["a"] - (p["b"] + 1.0) * x + x * x * y, p["b"] * x - x * x * y])


branch = co.trace(co.equilibria(brusselator), [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0))
(hopf,) = branch.points("HB")
print(branch.table())

# %% [markdown]
# ## Periodic orbits that emanate from the Hopf point
#
# `periodic_orbits` formulates the periodic orbits of the same function as a multiple-shooting problem, which diffrax
# integrates. `switch` leaves the Hopf point. u contains the points of an orbit one after another and, as its last
# entry, the period.

# %%
(cycles,) = co.switch(hopf, orbits=periodic_orbits(brusselator, segments=4), first_step=0.05, largest_step=0.5)
print(f"{len(cycles)} orbits, all stable: {cycles.stable.all()}")
print(
    f"periods from {cycles.u[0, -1]:.6f} to {cycles.u[-1, -1]:.6f}, the last multiplier {cycles.eigenvalues[-1, 0]:.6f}"
)

figure, ax = plt.subplots(figsize=(8, 5), layout="constrained")
for stable, style in ((True, "-"), (False, ":")):
    ax.plot(branch.p["b"], np.where(branch.stable == stable, branch.u[:, 0], np.nan), style, color="black")
ax.plot(cycles.p["b"], cycles.u[:, :-1:2], color="#0072B2", linewidth=0.8)
ax.plot(hopf.p["b"], hopf.u[0], "o", color="#D55E00")
ax.set(xlabel="$b$", ylabel="$x$ of the equilibrium, and at four phases of the orbit")
figure.savefig(OUT / "00_brusselator.png", dpi=120)

# %% [markdown]
# ## Period doublings of a map
#
# `fixed_points` takes a map. At a period doubling (PD), `switch` continues along the orbit of twice the period.


# %%
def henon(u, p, args):
    return jnp.stack([1.0 - p["a"] * u[0] ** 2 + u[1], p["b"] * u[0]])


found = co.trace(co.fixed_points(henon), [0.5, 0.2], {"a": 0.2, "b": 0.3}, "a", (0.1, 1.06), stop=["PD"])
doublings = []
for _ in range(4):
    doublings.append(found.points("PD")[0].p["a"])
    (found,) = co.switch(found.points("PD")[0], stop=["PD"])
print("period doublings at", ", ".join(f"{value:.14g}" for value in doublings))

# %% [markdown]
# ## Bifurcation curves in two parameters
#
# `curve` continues a special point in two parameters and locates the codimension-two points on the curve. In this model
# of the atmosphere, a curve of Hopf points has three such points:
#
# - It begins at a Bogdanov-Takens point (BT).
# - At the generalised Hopf point (GH) the onset of the oscillations changes between soft (supercritical) and hard
#   (subcritical).
# - At the double Hopf point (HH) it meets another curve of Hopf points.


# %%
def lorenz84(u, p, args):
    x, y, z, w = u
    first = -y * y - z * z - 0.25 * x + 0.25 * p["F"] - 0.987 * w * w
    return jnp.stack([first, x * y - x * z - y + 0.25, x * y + x * z - z, -1.04 * w + 0.987 * w * x + p["T"]])


found = co.trace(co.equilibria(lorenz84), [1.0, 0.0, 0.0, 0.0], {"F": 1.0, "T": 0.04}, "F", (0.5, 4.0))
hopfs = co.curve(found.points("HB")[0], ("F", "T"), {"F": (0.0, 4.0), "T": (-0.5, 0.5)}, largest_step=0.05)
print(hopfs.table())

# %% [markdown]
# ## User-defined constraints
#
# `hold` keeps a function of the solution at a given value, in exchange for one more free parameter. Here the function
# is the ratio of the two concentrations of the Brusselator, which is b / a^2 at the equilibrium.

# %%
start = {"a": 1.0, "b": 1.5}
held = co.trace(
    co.equilibria(brusselator),
    [1.0, 1.5],
    start,
    ("b", "a"),
    {"a": (0.3, 2.0), "b": (0.5, 5.0)},
    hold={lambda u, p, args: u[1] / u[0]: 1.5},
)
print(held)

# %% [markdown]
# `save` stores a branch in a file, without its function. `load` takes the function again.

# %%
co.save(branch, OUT / "00_branch.npz")
again = co.load(OUT / "00_branch.npz", co.equilibria(brusselator))

# %%
# Checks: the script fails if a statement of the text does not hold.
assert abs(hopf.p["b"] - 2.0) < 1e-12 and cycles.stable.all() and abs(cycles.u[-1, -1] - 7.15691992117988) < 1e-10
assert np.allclose(doublings, [0.3675, 0.9125, 1.02585540507378, 1.05112566203517], rtol=0, atol=1e-12)
assert [one.kind for one in hopfs.special if one.kind != "EP"] == ["BT", "GH", "HH"]
assert np.allclose(held.p["b"] / held.p["a"] ** 2, 1.5, rtol=0, atol=1e-10)
assert np.array_equal(again.u, branch.u) and again.table() == branch.table()
