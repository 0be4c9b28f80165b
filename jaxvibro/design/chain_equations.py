"""Define the equations of a chain of flights from impact to impact, and their derivatives.

The chain is not closed to an orbit. A node is an impact (unknowns: its time and the speed before it) or a free state at
a given time (unknowns: x, v). The flight from a node must end at the next: at an impact on its wall with its speed, or
in its state. The flight is free, so that the equations are smooth in the unknowns and in every number of the scene.
Chaos does not amplify errors, whatever the length of the chain, and a grazing is not a singularity. `next_impact`
checks whether a flight passes through a wall.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.persistent_jit import persistent_jit

from ..flight import drive, flow
from ..flight.coefficients import flow_coefficients
from ..flight.flows import flow_of
from ..orbits.saltation import evaluate_contact_map
from ..orbits.wall_at_contact import wall_derivatives
from ..scene.scene import SIDES
from .shape_padding import pad_to_power_of_two, scene_with_tangents


class Nodes(NamedTuple):
    """Nodes in order of time.

    `sides` is -1 or 1 for an impact, 0 for a free state. `state_times` are the times of free states. `first_unknown`
    and `second_unknown` are time and speed of an impact, or x and v of a state. Times count from phase 0 of the drive.
    """

    sides: Float[np.ndarray, " nodes"]
    state_times: Float[np.ndarray, " nodes"]
    first_unknown: Float[np.ndarray, " nodes"]
    second_unknown: Float[np.ndarray, " nodes"]

    @property
    def times(self) -> Float[np.ndarray, " nodes"]:
        """Times of all nodes."""
        return np.where(self.sides == 0, self.state_times, self.first_unknown)


class FlightResiduals(NamedTuple):
    """Residuals of flights, (flights, 2), and their derivatives, (flights, 2, 4 + numbers + 1).

    The derivatives are with respect to the two unknowns of the node, those of the next node, the free parameters, and
    the phase.
    """

    values: Float[np.ndarray, "flights 2"]
    derivatives: Float[np.ndarray, "flights 2 columns"]


def flight_residuals(scene, names, nodes, parameters, phase):
    """Return the `FlightResiduals` of nodes in a scene with other values of the named parameters.

    `phase` is that of the drive at time 0.
    """
    n_nodes = len(nodes.sides)
    if n_nodes < 2:
        return FlightResiduals(np.zeros((0, 2)), np.zeros((0, 2, 5 + len(names))))
    changed_scene, tangents = scene_with_tangents(scene, names, parameters)
    residuals, derivatives = (
        np.asarray(array)
        for array in _differentiate_flights(
            changed_scene, tangents, *map(pad_to_power_of_two, nodes), np.asarray(float(phase))
        )
    )
    derivatives = np.concatenate([derivatives[: 4 + len(names)], derivatives[-1:]])
    return FlightResiduals(
        residuals[:, : n_nodes - 1].T, np.moveaxis(derivatives[:, :, : n_nodes - 1], (0, 1, 2), (2, 1, 0))
    )


def connecting_speeds(scene, nodes, phase):
    """Return the speeds of the flights that connect consecutive impacts.

    The first array holds the speed after each node, the second the speed before the next, (flights,) each. Positive
    speeds point away from the wall and into the wall. Both arrays give the speed of an inner impact. They disagree if
    the times are not those of the scene. A contact phase of a soft wall is taken to last half a free oscillation.
    """
    n_nodes, sides = len(nodes.sides), np.asarray(nodes.sides)
    contact_durations = sum(
        (np.where(sides == sign, contact_duration, 0.0) for sign, contact_duration in _contact_half_periods(scene)),
        0.0 * sides,
    )
    padded_nodes = map(pad_to_power_of_two, nodes._replace(second_unknown=contact_durations))
    speeds_after, speeds_before = (np.asarray(array) for array in _compute_speeds(scene, *padded_nodes, phase))
    return speeds_after[: n_nodes - 1], speeds_before[: n_nodes - 1]


def _contact_half_periods(scene):
    """Yield (side, contact duration) of each soft wall."""
    for side, wall in scene.walls.items():
        if wall.soft:
            squared_frequency = 1.0 + float(wall.stiffness) - float(scene.parameter(f"{side}.damping")) ** 2
            yield (1.0 if side == SIDES[1] else -1.0), np.pi / np.sqrt(max(squared_frequency, 1.0))


@persistent_jit
def _differentiate_flights(scene, tangents, sides, state_times, first_unknown, second_unknown, phase):
    """Return residuals and their derivatives in the unknowns, along the scene tangents, and in the phase."""
    node_unknowns = first_unknown, second_unknown, jnp.roll(first_unknown, -1), jnp.roll(second_unknown, -1)

    def residuals(first_unknown, second_unknown, next_first, next_second, scene, phase):
        return jnp.stack(
            _fly_between_nodes(
                scene, sides, state_times, (first_unknown, second_unknown), (next_first, next_second), phase
            )
        )

    def derivative_along(*tangent):
        return jax.jvp(residuals, (*node_unknowns, scene, phase), tangent)[1]

    n_tangents = len(jax.tree.leaves(tangents)[0])
    identity, ones = jnp.eye(4 + n_tangents + 1), jnp.ones_like(first_unknown)
    unknown_tangents = [identity[:, k, None] * ones for k in range(4)]
    scene_tangents = jax.tree.map(lambda leaf: jnp.pad(leaf, (4, 1)), tangents)
    derivatives = jax.vmap(derivative_along)(*unknown_tangents, scene_tangents, identity[:, -1])
    return residuals(*node_unknowns, scene, phase), derivatives


def _fly_between_nodes(scene, sides, state_times, node_unknowns, next_unknowns, phase):
    """Return the residuals of position and velocity at the ends of the flights."""
    coeffs, next_sides = flow_coefficients(scene), jnp.roll(sides, -1)
    is_state, next_is_state = sides == 0, next_sides == 0
    start_times, end_times = (
        jnp.where(is_state, state_times, node_unknowns[0]),
        jnp.where(next_is_state, jnp.roll(state_times, -1), next_unknowns[0]),
    )
    cosine, sine = _drive_phasor(coeffs, phase, start_times)
    contact_map = evaluate_contact_map(coeffs, sides, cosine, sine, jnp.where(is_state, 0.0, node_unknowns[1]))
    contact_duration = 0.0 if contact_map.contact_time is None else jnp.where(is_state, 0.0, contact_map.contact_time)
    x, v = (
        jnp.where(is_state, state_value, impact_value)
        for state_value, impact_value in zip(node_unknowns, contact_map.state, strict=True)
    )
    cosine, sine = (
        jnp.where(is_state, state_value, impact_value)
        for state_value, impact_value in zip((cosine, sine), contact_map.phasor, strict=True)
    )
    flight_time = jnp.maximum(end_times - start_times - contact_duration, 0.0)
    end_x, end_v = flow_of(coeffs).fly(coeffs, x, v, cosine, sine, flight_time)[:2]
    wall_position, wall_velocity = wall_derivatives(coeffs, next_sides, *_drive_phasor(coeffs, phase, end_times), 1)
    position_residual = end_x - jnp.where(next_is_state, next_unknowns[0], wall_position)
    velocity_residual = jnp.where(
        next_is_state, end_v - next_unknowns[1], next_sides * (end_v - wall_velocity) - next_unknowns[1]
    )
    return position_residual, velocity_residual


def _drive_phasor(coeffs, phase, time):
    """Return the cosine and sine of the phase of the drive at a time."""
    angle = phase + coeffs.frequency * time
    return jnp.cos(angle), jnp.sin(angle)


@persistent_jit
def _compute_speeds(scene, sides, state_times, impact_times, contact_durations, phase):
    """Compute the two arrays of `connecting_speeds` for padded nodes."""
    coeffs, next_sides, start_times = flow_coefficients(scene), jnp.roll(sides, -1), impact_times + contact_durations
    flight_time = jnp.maximum(jnp.roll(impact_times, -1) - start_times, 0.0)
    cosine, sine = _drive_phasor(coeffs, phase, start_times)
    x, wall_velocity = wall_derivatives(coeffs, sides, cosine, sine, 1)
    free_flow, forced_flow, _ = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, flight_time)
    force = coeffs.amplitude * cosine, coeffs.amplitude * sine
    x_from_rest, _ = flow.apply_responses((free_flow, forced_flow), *force, x, 0.0 * x)
    term_responses = drive.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, flight_time)
    dx, dv = drive.forced_response(coeffs.drive_terms, term_responses, coeffs.frequency, cosine, sine)
    x_from_rest = x_from_rest + dx if coeffs.drive_terms else x_from_rest
    next_wall_position, next_wall_velocity = wall_derivatives(
        coeffs, next_sides, *_drive_phasor(coeffs, phase, jnp.roll(impact_times, -1)), 1
    )
    x_per_velocity = free_flow[1]
    v = (next_wall_position - x_from_rest) / jnp.where(x_per_velocity == 0, 1.0, x_per_velocity)
    _, end_v = flow.apply_responses((free_flow, forced_flow), *force, x, v)
    end_v = end_v + dv if coeffs.drive_terms else end_v
    return -sides * (v - wall_velocity), next_sides * (end_v - next_wall_velocity)
