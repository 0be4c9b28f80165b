"""Compute the equations of periodic orbits of u' = f(u, p) by multiple shooting, for any integrator.

The unknowns are m points x_1 to x_m, evenly spaced in time, and the period T. The flow over T/m maps each point to the
next point and the last point to the first. The phase is arbitrary. The last equation therefore has the value zero, and
its gradient is the normalised field at the points. This equation keeps Newton's changes and tangents orthogonal to the
flow, like a Poincare section through each iterate, and requires no reference orbit. Where dF/du is singular, the left
null vector of dF/du has no component in the last equation, because the field is a null vector of all other equations.
"""

from typing import Any

import jax
import jax.numpy as jnp


def points_and_period(u, n_segments):
    """Split unknowns into points of shape (n_segments, n) and the period."""
    return u[:-1].reshape(n_segments, -1), u[-1]


def shooting_equations(system, param_names, z, constants) -> tuple[Any, Any]:
    """Compute (F, dF/dz) at z = (points, period, values of the named parameters)."""
    n_unknowns, n_segments = len(z) - len(param_names), system.segments * system.times
    points = points_and_period(z[:n_unknowns], n_segments)[0]

    def segment_end(segment_inputs):
        p = {
            **constants.fixed_params,
            **{name: segment_inputs[k - len(param_names)] for k, name in enumerate(param_names)},
        }
        end_point = system.fly(
            segment_inputs[: -1 - len(param_names)],
            segment_inputs[-1 - len(param_names)] / n_segments,
            p,
            constants.args,
        )
        return end_point, end_point

    all_segment_inputs = jnp.concatenate([points, jnp.tile(z[n_unknowns - 1 :], (n_segments, 1))], axis=1)
    segment_jacobians, segment_ends = jax.vmap(jax.jacfwd(segment_end, has_aux=True))(all_segment_inputs)
    state_size, shooting_gaps = points.shape[1], segment_ends - jnp.roll(points, -1, axis=0)
    p = {**constants.fixed_params, **{name: z[n_unknowns + k] for k, name in enumerate(param_names)}}
    field_vectors = jax.vmap(lambda x: jnp.asarray(system.function(x, p, constants.args)))(points).reshape(-1)
    jacobian = jnp.zeros((n_unknowns, len(z)), z.dtype)
    for k in range(n_segments):
        segment_slice, next_point_column = (
            slice(state_size * k, state_size * (k + 1)),
            state_size * ((k + 1) % n_segments),
        )
        jacobian = (
            jacobian.at[segment_slice, segment_slice]
            .set(segment_jacobians[k, :, :state_size])
            .at[segment_slice, n_unknowns - 1 :]
            .set(segment_jacobians[k, :, state_size:])
        )
        jacobian = jacobian.at[segment_slice, next_point_column : next_point_column + state_size].add(
            -jnp.eye(state_size)
        )
    jacobian = jacobian.at[-1, : n_unknowns - 1].set(field_vectors / jnp.linalg.norm(field_vectors))
    return jnp.append(shooting_gaps.reshape(-1), 0.0), jacobian


def period_doubling_matrix(system, jacobian):
    """Return the block of dF/dz for antiperiodically closed points; the block is singular if a multiplier is -1."""
    n_coordinates, n_segments = len(jacobian) - 1, system.segments * system.times
    state_size = n_coordinates // n_segments
    return (
        jacobian[:n_coordinates, :n_coordinates]
        .at[n_coordinates - state_size :, :state_size]
        .add(2.0 * jnp.eye(state_size))
    )


def transverse_monodromy(system, jacobian, field_vector):
    """Compute the monodromy matrix transverse to the field, shape (n - 1, n - 1).

    `jacobian` is dF/dz, `field_vector` the field at the first point. The eigenvalues of the result are the multipliers
    without the trivial multiplier. The monodromy matrix maps the direction of the field to itself, so that its
    transverse block is sufficient.
    """
    n_segments = system.segments * system.times
    state_size = (len(jacobian) - 1) // n_segments
    monodromy = jnp.eye(state_size)
    for segment_index in range(n_segments):
        segment_jacobian = jacobian[
            state_size * segment_index : state_size * (segment_index + 1),
            state_size * segment_index : state_size * (segment_index + 1),
        ]
        monodromy = (segment_jacobian + jnp.eye(state_size) if n_segments == 1 else segment_jacobian) @ monodromy
    field_norm = jnp.linalg.norm(field_vector)
    field_direction = field_vector / jnp.where(field_norm > 0, field_norm, 1.0)  # the field vanishes at a Hopf point
    householder_vector = field_direction.at[0].add(jnp.where(field_direction[0] < 0, -1.0, 1.0))
    transverse_basis = (
        jnp.eye(state_size)
        - 2.0 * jnp.outer(householder_vector, householder_vector) / (householder_vector @ householder_vector)
    )[:, 1:]  # Householder reflection
    return transverse_basis.T @ monodromy @ transverse_basis
