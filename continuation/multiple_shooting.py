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


def points_and_period(u, n_segments):
    """(points, (count, n); the period)."""
    return u[:-1].reshape(n_segments, -1), u[-1]


def shooting_equations(system, names, z, constants) -> tuple[Any, Any]:
    """(F, dF/dz) at z = (points, period, values of the names)."""
    n_unknowns, n_segments = len(z) - len(names), system.segments * system.times
    points = points_and_period(z[:n_unknowns], n_segments)[0]

    def segment_end(segment_inputs):
        p = {**constants.fixed_params, **{name: segment_inputs[k - len(names)] for k, name in enumerate(names)}}
        end_point = system.fly(
            segment_inputs[: -1 - len(names)], segment_inputs[-1 - len(names)] / n_segments, p, constants.args
        )
        return end_point, end_point

    all_segment_inputs = jnp.concatenate([points, jnp.tile(z[n_unknowns - 1 :], (n_segments, 1))], axis=1)
    segment_jacobians, end_points = jax.vmap(jax.jacfwd(segment_end, has_aux=True))(all_segment_inputs)
    n, shooting_gaps = points.shape[1], end_points - jnp.roll(points, -1, axis=0)
    p = {**constants.fixed_params, **{name: z[n_unknowns + k] for k, name in enumerate(names)}}
    field_vectors = jax.vmap(lambda x: jnp.asarray(system.function(x, p, constants.args)))(points).reshape(-1)
    jacobian = jnp.zeros((n_unknowns, len(z)), z.dtype)
    for k in range(n_segments):
        block, next_column = slice(n * k, n * (k + 1)), n * ((k + 1) % n_segments)
        jacobian = (
            jacobian.at[block, block]
            .set(segment_jacobians[k, :, :n])
            .at[block, n_unknowns - 1 :]
            .set(segment_jacobians[k, :, n:])
        )
        jacobian = jacobian.at[block, next_column : next_column + n].add(-jnp.eye(n))
    jacobian = jacobian.at[-1, : n_unknowns - 1].set(field_vectors / jnp.linalg.norm(field_vectors))
    return jnp.append(shooting_gaps.reshape(-1), 0.0), jacobian


def antiperiodic_jacobian(system, jacobian):
    """Of dF/dz the part of the points, with which the orbit would come back to its negative: singular where a
    multiplier is -1."""
    n_coordinates, n_segments = len(jacobian) - 1, system.segments * system.times
    n = n_coordinates // n_segments
    return jacobian[:n_coordinates, :n_coordinates].at[n_coordinates - n :, :n].add(2.0 * jnp.eye(n))


def transverse_monodromy(system, jacobian, field_vector):
    """The matrix, (n - 1, n - 1), whose eigenvalues are the multipliers but for that of the field's own direction, 1;
    jacobian: dF/dz; field_vector: the field at the first point.

    It is the monodromy matrix's block across the field, which that leaves unchanged."""
    n_segments = system.segments * system.times
    n = (len(jacobian) - 1) // n_segments
    monodromy = jnp.eye(n)
    for k in range(n_segments):
        segment_jacobian = jacobian[n * k : n * (k + 1), n * k : n * (k + 1)]
        monodromy = (segment_jacobian + jnp.eye(n) if n_segments == 1 else segment_jacobian) @ monodromy
    field_norm = jnp.linalg.norm(field_vector)
    field_direction = field_vector / jnp.where(field_norm > 0, field_norm, 1.0)  # none at a Hopf point
    householder_vector = field_direction.at[0].add(jnp.where(field_direction[0] < 0, -1.0, 1.0))
    transverse_basis = (
        jnp.eye(n) - 2.0 * jnp.outer(householder_vector, householder_vector) / (householder_vector @ householder_vector)
    )[:, 1:]  # Householder's reflection
    return transverse_basis.T @ monodromy @ transverse_basis
