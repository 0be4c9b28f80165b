"""Define the equations of a chain of flights from impact to impact, and their derivatives.

The chain is not closed to a periodic orbit. A node is an impact (unknowns: the time and the speed before the impact) or
a free state at a given time (unknowns: x, v). The flight from a node must end at the next node: on the wall of the next
impact, at its time and with its speed, or in the next state. The equations ignore the walls during a flight. They are
therefore smooth in the unknowns and in every number of the scene, and a grazing is not a singularity. Chaos does not
amplify errors, whatever the length of the chain. `impact_prediction` checks whether a flight passes through a wall.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.persistent_jit import persistent_jit

from ..flight import flow, further_drive_terms
from ..flight.flight_coefficients import flow_coefficients
from ..flight.flow_dispatch import flow_of
from ..orbits.contact_maps import evaluate_contact_map
from ..orbits.wall_at_contact import wall_derivatives
from ..scene.scene import SIDES
from .shape_padding import pad_to_power_of_two, scene_with_tangents


class ChainNodes(NamedTuple):
    """Nodes of a chain in order of time.

    Attributes
    ----------
    sides : numpy.ndarray
        -1 or 1 for an impact, 0 for a free state. Array of shape (nodes,).
    free_state_times : numpy.ndarray
        Times of the free states. Array of shape (nodes,).
    time_or_x : numpy.ndarray
        Time of an impact, or x of a free state. Array of shape (nodes,).
    speed_or_v : numpy.ndarray
        Speed before an impact, or v of a free state. Array of shape (nodes,).
    """

    sides: Float[np.ndarray, " nodes"]
    free_state_times: Float[np.ndarray, " nodes"]
    time_or_x: Float[np.ndarray, " nodes"]
    speed_or_v: Float[np.ndarray, " nodes"]

    @property
    def times(self) -> Float[np.ndarray, " nodes"]:
        """Times of all nodes."""
        return np.where(self.sides == 0, self.free_state_times, self.time_or_x)


class FlightResiduals(NamedTuple):
    """Residuals of the flights of a chain.

    Attributes
    ----------
    values : numpy.ndarray
        Residuals of position and velocity at the end of each flight. Array of shape (flights, 2).
    derivatives : numpy.ndarray
        Derivatives of the residuals with respect to the two unknowns of the node, the two unknowns of the next node,
        the free parameters, and the phase. Array of shape (flights, 2, 4 + free + 1).
    """

    values: Float[np.ndarray, "flights 2"]
    derivatives: Float[np.ndarray, "flights 2 columns"]


def flight_residuals(scene, parameter_names, nodes, parameters, start_phase):
    """Return the `FlightResiduals` of nodes in a scene with the values `parameters` of the named parameters.

    `start_phase` is the phase of the drive at time 0.
    """
    n_nodes = len(nodes.sides)
    if n_nodes < 2:
        return FlightResiduals(np.zeros((0, 2)), np.zeros((0, 2, 5 + len(parameter_names))))
    changed_scene, scene_tangents = scene_with_tangents(scene, parameter_names, parameters)
    residuals, derivatives = (
        np.asarray(padded_result)
        for padded_result in _differentiate_flights(
            changed_scene, scene_tangents, *map(pad_to_power_of_two, nodes), np.asarray(float(start_phase))
        )
    )
    derivatives = np.concatenate([derivatives[: 4 + len(parameter_names)], derivatives[-1:]])
    return FlightResiduals(
        residuals[:, : n_nodes - 1].T, np.moveaxis(derivatives[:, :, : n_nodes - 1], (0, 1, 2), (2, 1, 0))
    )


def speeds_between_impacts(scene, nodes, start_phase):
    """Return the speeds at both ends of the flights that connect consecutive impacts.

    Returns two arrays of shape (flights,). The first holds the speed after the impact at the start of each flight,
    positive away from its wall. The second holds the speed before the impact at the end, positive into its wall. At an
    inner impact the two speeds violate the impact law if the times are not those of a motion of the scene. A contact
    phase of a soft wall is assumed to last half a free oscillation.
    """
    n_nodes, sides = len(nodes.sides), np.asarray(nodes.sides)
    contact_durations = sum(
        (
            np.where(sides == side_code, contact_duration, 0.0)
            for side_code, contact_duration in _estimate_contact_durations(scene)
        ),
        0.0 * sides,
    )
    padded_nodes = map(pad_to_power_of_two, nodes._replace(speed_or_v=contact_durations))
    speeds_after, speeds_before = (
        np.asarray(padded_result) for padded_result in _speeds_at_flight_ends(scene, *padded_nodes, start_phase)
    )
    return speeds_after[: n_nodes - 1], speeds_before[: n_nodes - 1]


def _estimate_contact_durations(scene):
    """Yield (side, estimated contact duration) of each soft wall: half a period of the free oscillation in contact."""
    for side, wall in scene.walls.items():
        if wall.soft:
            squared_frequency_inside = 1.0 + float(wall.stiffness) - float(scene.parameter(f"{side}.damping")) ** 2
            yield (1.0 if side == SIDES[1] else -1.0), np.pi / np.sqrt(max(squared_frequency_inside, 1.0))


@persistent_jit
def _differentiate_flights(scene, scene_tangents, sides, free_state_times, time_or_x, speed_or_v, start_phase):
    """Return the residuals, and their derivatives by the unknowns, along the scene tangents and by the phase."""
    node_and_next_unknowns = time_or_x, speed_or_v, jnp.roll(time_or_x, -1), jnp.roll(speed_or_v, -1)

    def stacked_residuals(time_or_x, speed_or_v, next_time_or_x, next_speed_or_v, scene, start_phase):
        return jnp.stack(
            _flight_end_residuals(
                scene, sides, free_state_times, (time_or_x, speed_or_v), (next_time_or_x, next_speed_or_v), start_phase
            )
        )

    def residual_derivative(*tangents):
        return jax.jvp(stacked_residuals, (*node_and_next_unknowns, scene, start_phase), tangents)[1]

    n_tangents = len(jax.tree.leaves(scene_tangents)[0])
    tangent_basis, node_ones = jnp.eye(4 + n_tangents + 1), jnp.ones_like(time_or_x)
    unknown_tangents = [tangent_basis[:, unknown_index, None] * node_ones for unknown_index in range(4)]
    tangents_with_zero_rows = jax.tree.map(lambda leaf: jnp.pad(leaf, (4, 1)), scene_tangents)
    residual_derivatives = jax.vmap(residual_derivative)(
        *unknown_tangents, tangents_with_zero_rows, tangent_basis[:, -1]
    )
    return stacked_residuals(*node_and_next_unknowns, scene, start_phase), residual_derivatives


def _flight_end_residuals(scene, sides, free_state_times, node_unknowns, next_unknowns, start_phase):
    """Return the residuals of position and velocity at the ends of the flights."""
    coeffs, next_sides = flow_coefficients(scene), jnp.roll(sides, -1)
    is_free_state, is_next_free_state = sides == 0, next_sides == 0
    start_times, end_times = (
        jnp.where(is_free_state, free_state_times, node_unknowns[0]),
        jnp.where(is_next_free_state, jnp.roll(free_state_times, -1), next_unknowns[0]),
    )
    drive_cosine, drive_sine = _drive_phasor(coeffs, start_phase, start_times)
    contact_map = evaluate_contact_map(
        coeffs, sides, drive_cosine, drive_sine, jnp.where(is_free_state, 0.0, node_unknowns[1])
    )
    contact_duration = (
        0.0 if contact_map.contact_time is None else jnp.where(is_free_state, 0.0, contact_map.contact_time)
    )
    x, v = (
        jnp.where(is_free_state, free_state_value, value_after_impact)
        for free_state_value, value_after_impact in zip(node_unknowns, contact_map.state, strict=True)
    )
    drive_cosine, drive_sine = (
        jnp.where(is_free_state, free_state_value, value_after_impact)
        for free_state_value, value_after_impact in zip((drive_cosine, drive_sine), contact_map.phasor, strict=True)
    )
    flight_time = jnp.maximum(end_times - start_times - contact_duration, 0.0)
    end_x, end_v = flow_of(coeffs).fly(coeffs, x, v, drive_cosine, drive_sine, flight_time)[:2]
    wall_position, wall_velocity = wall_derivatives(
        coeffs, next_sides, *_drive_phasor(coeffs, start_phase, end_times), 1
    )
    position_residual = end_x - jnp.where(is_next_free_state, next_unknowns[0], wall_position)
    velocity_residual = jnp.where(
        is_next_free_state, end_v - next_unknowns[1], next_sides * (end_v - wall_velocity) - next_unknowns[1]
    )
    return position_residual, velocity_residual


def _drive_phasor(coeffs, start_phase, time):
    """Return the cosine and sine of the phase of the drive at a time."""
    drive_angle = start_phase + coeffs.frequency * time
    return jnp.cos(drive_angle), jnp.sin(drive_angle)


@persistent_jit
def _speeds_at_flight_ends(scene, sides, free_state_times, impact_times, contact_durations, start_phase):
    """Compute the two arrays of `speeds_between_impacts` for padded nodes."""
    coeffs, next_sides, start_times = flow_coefficients(scene), jnp.roll(sides, -1), impact_times + contact_durations
    flight_time = jnp.maximum(jnp.roll(impact_times, -1) - start_times, 0.0)
    drive_cosine, drive_sine = _drive_phasor(coeffs, start_phase, start_times)
    x, wall_velocity = wall_derivatives(coeffs, sides, drive_cosine, drive_sine, 1)
    unforced_response, forced_response, _ = flow.doubling_responses(
        coeffs.series, coeffs.frequency, coeffs.damping, flight_time
    )
    drive_force_phasor = coeffs.amplitude * drive_cosine, coeffs.amplitude * drive_sine
    end_x_from_rest, _ = flow.apply_responses((unforced_response, forced_response), *drive_force_phasor, x, 0.0 * x)
    drive_term_responses = further_drive_terms.term_responses(
        coeffs.drive_terms, coeffs.frequency, coeffs.damping, flight_time
    )
    drive_terms_dx, drive_terms_dv = further_drive_terms.response_to_terms(
        coeffs.drive_terms, drive_term_responses, coeffs.frequency, drive_cosine, drive_sine
    )
    end_x_from_rest = end_x_from_rest + drive_terms_dx if coeffs.drive_terms else end_x_from_rest
    next_wall_position, next_wall_velocity = wall_derivatives(
        coeffs, next_sides, *_drive_phasor(coeffs, start_phase, jnp.roll(impact_times, -1)), 1
    )
    end_x_per_start_v = unforced_response[1]
    v = (next_wall_position - end_x_from_rest) / jnp.where(end_x_per_start_v == 0, 1.0, end_x_per_start_v)
    _, end_v = flow.apply_responses((unforced_response, forced_response), *drive_force_phasor, x, v)
    end_v = end_v + drive_terms_dv if coeffs.drive_terms else end_v
    return -sides * (v - wall_velocity), next_sides * (end_v - next_wall_velocity)
