"""Periodic orbits of u' = f(u, p) by multiple shooting: the algebra, whatever flies along the field.

Unknowns are points x_1 ... x_m, evenly spread in time, and the period T. Each is to fly in T / m to the next, the last
to the first. Any shift of the phase gives as good an orbit: a last equation, whose value is always zero and whose
gradient is the field at the points, keeps Newton's changes and tangents across it (a Poincare section through each
iterate). No reference orbit is needed, which a branch would outgrow; where the matrix is singular its left null vector
has no part in that equation, as the field is a null vector of all others.
"""

from typing import Any

import jax
import jax.numpy as jnp


def points_of(u, count):
    """(points, (count, n); the period)."""
    return u[:-1].reshape(count, -1), u[-1]


def equations(system, names, z, given) -> tuple[Any, Any]:
    """(F, dF/dz) at z = (points, period, values of the names)."""
    size, count = len(z) - len(names), system.segments * system.times
    points = points_of(z[:size], count)[0]

    def end(numbers):
        p = {**given.others, **{name: numbers[k - len(names)] for k, name in enumerate(names)}}
        reached = system.fly(numbers[: -1 - len(names)], numbers[-1 - len(names)] / count, p, given.args)
        return reached, reached

    many = jnp.concatenate([points, jnp.tile(z[size - 1 :], (count, 1))], axis=1)
    slopes, ends = jax.vmap(jax.jacfwd(end, has_aux=True))(many)
    n, gaps = points.shape[1], ends - jnp.roll(points, -1, axis=0)
    p = {**given.others, **{name: z[size + k] for k, name in enumerate(names)}}
    ways = jax.vmap(lambda x: jnp.asarray(system.function(x, p, given.args)))(points).reshape(-1)
    whole = jnp.zeros((size, len(z)), z.dtype)
    for k in range(count):
        rows, after = slice(n * k, n * (k + 1)), n * ((k + 1) % count)
        whole = whole.at[rows, rows].set(slopes[k, :, :n]).at[rows, size - 1 :].set(slopes[k, :, n:])
        whole = whole.at[rows, after : after + n].add(-jnp.eye(n))
    whole = whole.at[-1, : size - 1].set(ways / jnp.linalg.norm(ways))
    return jnp.append(gaps.reshape(-1), 0.0), whole


def flipped(system, slopes):
    """Of dF/dz the part of the points, with which the orbit would come back to its negative: singular where a
    multiplier is -1."""
    size, count = len(slopes) - 1, system.segments * system.times
    n = size // count
    return slopes[:size, :size].at[size - n :, :n].add(2.0 * jnp.eye(n))


def multiplied(system, slopes, way):
    """The matrix, (n - 1, n - 1), whose eigenvalues are the multipliers but for that of the field's own direction, 1;
    slopes: dF/dz; way: the field at the first point.

    It is the monodromy matrix's block across the field, which that leaves unchanged."""
    count = system.segments * system.times
    n = (len(slopes) - 1) // count
    monodromy = jnp.eye(n)
    for k in range(count):
        own = slopes[n * k : n * (k + 1), n * k : n * (k + 1)]
        monodromy = (own + jnp.eye(n) if count == 1 else own) @ monodromy
    length = jnp.linalg.norm(way)
    unit = way / jnp.where(length > 0, length, 1.0)  # none at a Hopf point
    normal = unit.at[0].add(jnp.where(unit[0] < 0, -1.0, 1.0))
    across = (jnp.eye(n) - 2.0 * jnp.outer(normal, normal) / (normal @ normal))[:, 1:]  # Householder's reflection
    return across.T @ monodromy @ across
