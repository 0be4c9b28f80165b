"""Equations of periodic orbits of u' = f(u, p) by multiple shooting, for any integrator.

Unknowns are m points x_1 to x_m, evenly spaced in time, and the period T. The flow over T/m maps each point to the next
and the last to the first. The phase is arbitrary: a last equation, whose value is always zero and whose gradient is the
field at the points, keeps Newton's changes and tangents orthogonal to the flow (a Poincare section through each
iterate). This needs no reference orbit, from which a branch would depart. Where the matrix is singular, its left null
vector has no component in the last equation, because the field is a null vector of all others.
"""

from typing import Any

import jax
import jax.numpy as jnp


def points_and_period(u, n_segments):
    """Split unknowns into points of shape (n_segments, n) and the period."""
    return u[:-1].reshape(n_segments, -1), u[-1]


def shooting_equations(system, names, z, constants) -> tuple[Any, Any]:
    """Compute (F, dF/dz) at z = (points, period, values of the names)."""
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
    """Return the block of dF/dz for the points with antiperiodic closure, which is singular if a multiplier is -1."""
    n_coordinates, n_segments = len(jacobian) - 1, system.segments * system.times
    n = n_coordinates // n_segments
    return jacobian[:n_coordinates, :n_coordinates].at[n_coordinates - n :, :n].add(2.0 * jnp.eye(n))


def transverse_monodromy(system, jacobian, field_vector):
    """Compute the monodromy matrix transverse to the field, shape (n - 1, n - 1).

    `jacobian` is dF/dz, `field_vector` the field at the first point.
    Its eigenvalues are the multipliers without the trivial one. The monodromy matrix maps the direction of the field to
    itself, so that its transverse block is sufficient.
    """
    n_segments = system.segments * system.times
    n = (len(jacobian) - 1) // n_segments
    monodromy = jnp.eye(n)
    for k in range(n_segments):
        segment_jacobian = jacobian[n * k : n * (k + 1), n * k : n * (k + 1)]
        monodromy = (segment_jacobian + jnp.eye(n) if n_segments == 1 else segment_jacobian) @ monodromy
    field_norm = jnp.linalg.norm(field_vector)
    field_direction = field_vector / jnp.where(field_norm > 0, field_norm, 1.0)  # the field vanishes at a Hopf point
    householder_vector = field_direction.at[0].add(jnp.where(field_direction[0] < 0, -1.0, 1.0))
    transverse_basis = (
        jnp.eye(n) - 2.0 * jnp.outer(householder_vector, householder_vector) / (householder_vector @ householder_vector)
    )[:, 1:]  # Householder reflection
    return transverse_basis.T @ monodromy @ transverse_basis
