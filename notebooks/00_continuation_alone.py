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
# # What if there is no wall at all?
#
# `jaxvibro` follows orbits with a package that knows no oscillator, `continuation`. Here it is used alone, on a
# chemical reaction, a map and a model of the atmosphere: equations of your own, written for JAX, need nothing more.

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
# ## Equilibria, and where they begin to swing
#
# The Brusselator is two concentrations and two parameters. `equilibria` takes the right side of u' = f; `trace` follows
# the equilibrium along b, from about a guess. In closed form the Hopf point (HB) is at b = 1 + a^2.


# %%
def brusselator(u, p, args):
    x, y = u
    return jnp.stack([p["a"] - (p["b"] + 1.0) * x + x * x * y, p["b"] * x - x * x * y])


branch = co.trace(co.equilibria(brusselator), [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0))
(hopf,) = branch.points("HB")
print(branch.table())

# %% [markdown]
# ## The oscillations that are born there
#
# `periodic_orbits` of the same function makes multiple shooting of it, flown by diffrax; `switch` leaves the Hopf
# point. u holds the points of an orbit one after another, and at its end the period.

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
ax.set(xlabel="$b$", ylabel="$x$ at rest, and at four phases of the oscillation")
figure.savefig(OUT / "00_brusselator.png", dpi=120)

# %% [markdown]
# ## A map that doubles its period
#
# `fixed_points` takes a map. `switch` leaves a period doubling (PD) for the orbit of twice as many times.


# %%
def henon(u, p, args):
    return jnp.stack([1.0 - p["a"] * u[0] ** 2 + u[1], p["b"] * u[0]])


found = co.trace(co.fixed_points(henon), [0.5, 0.2], {"a": 0.2, "b": 0.3}, "a", (0.1, 1.06), stop=["PD"])
doublings = []
for _ in range(4):
    doublings.append(found.points("PD")[0].p["a"])
    (found,) = co.switch(found.points("PD")[0], stop=["PD"])
print("doublings at", ", ".join(f"{value:.14g}" for value in doublings))

# %% [markdown]
# ## Two parameters
#
# `curve` follows a special point in two parameters, and locates what is special on its way: in this model of the
# atmosphere a curve of Hopf points begins at a Bogdanov-Takens point (BT), changes at GH from a soft beginning of the
# oscillations to a hard one or back, and meets another such curve (HH).


# %%
def lorenz84(u, p, args):
    x, y, z, w = u
    first = -y * y - z * z - 0.25 * x + 0.25 * p["F"] - 0.987 * w * w
    return jnp.stack([first, x * y - x * z - y + 0.25, x * y + x * z - z, -1.04 * w + 0.987 * w * x + p["T"]])


found = co.trace(co.equilibria(lorenz84), [1.0, 0.0, 0.0, 0.0], {"F": 1.0, "T": 0.04}, "F", (0.5, 4.0))
hopfs = co.curve(found.points("HB")[0], ("F", "T"), {"F": (0.0, 4.0), "T": (-0.5, 0.5)}, largest_step=0.05)
print(hopfs.table())

# %% [markdown]
# ## A number of yours that is to stay
#
# `hold` keeps a function of the solution at a value, for one parameter more: here of the Brusselator the ratio of both
# concentrations, which is b / a^2 at rest.

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
# A branch is kept in a file; its function is given again.

# %%
co.save(branch, OUT / "00_branch.npz")
again = co.load(OUT / "00_branch.npz", co.equilibria(brusselator))

# %%
# What the text says holds, or this script fails.
assert abs(hopf.p["b"] - 2.0) < 1e-12 and cycles.stable.all() and abs(cycles.u[-1, -1] - 7.15691992117988) < 1e-10
assert np.allclose(doublings, [0.3675, 0.9125, 1.02585540507378, 1.05112566203517], rtol=0, atol=1e-12)
assert [one.kind for one in hopfs.special if one.kind != "EP"] == ["BT", "GH", "HH"]
assert np.allclose(held.p["b"] / held.p["a"] ** 2, 1.5, rtol=0, atol=1e-10)
assert np.array_equal(again.u, branch.u) and again.table() == branch.table()
