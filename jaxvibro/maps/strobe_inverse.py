"""Inverse of the stroboscopic map, by certified flight with time reversed.

In reversed time the motion (x, -v, -phase) obeys the same equations with damping -gamma, negated phases of the walls
and of the further drive terms, and restitution 1 / R. Speeds do not decrease at an impact, so that there is no chatter.
The energy of a flight grows like exp(2 gamma t); the bounds on derivatives include this growth. Entry into a soft wall
and exit from the wall are exchanged. Within the wall the damping is -gamma2, or the contact law receives the negated
rate of the depth. The bounds are unchanged there.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import call_without_inlining
from ..compiled.lane_blocks import run_in_blocks
from ..contact.kinds import contact_of_wall, flow_of_scene, make_flow_coefficients
from ..flight.flight_coefficients import check_validity
from ..flight.path_start import start_path
from ..scene.state import State
from .reference_strobe import fly_once, make_empty_results


def require_reversible(scene):
    """Raise an error if the map of a scene has no inverse or the damping is too large for time reversal.

    A soft wall with critical or larger damping takes all of the speed.

    Parameters
    ----------
    scene : Scene
        A single scene.

    Raises
    ------
    ArgumentError
        If a wall takes all of the speed (R = 0, or a soft wall with critical or larger damping), or if the damping of
        the linear oscillator is not less than 1.
    """
    for side in scene.walls:
        contact_of_wall(scene, side).require_reversible(scene, side)
    flow_of_scene(scene).require_reversible(scene)


def strobe_backward(scene, state, min_lanes):
    """Compute the state one drive period earlier, within a jitted function.

    Parameters
    ----------
    scene : Scene
        Scene that passes `require_reversible`.
    state : State
        State whose leaves broadcast with those of `scene`. Its phase is kept.
    min_lanes : int
        Smallest number of lanes of a block.

    Returns
    -------
    start : State
        State one period earlier; `strobe` maps it to `state`.
    impacts : Impacts
        Impacts of the reversed motion, counted but not recorded.
    """
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    reversed_state = State(jnp.broadcast_to(state.x, shape), -state.v, -state.phase, jnp.zeros_like(state.x))
    reversed_end, impacts = run_in_blocks(
        lambda arguments: call_as_kernel(_run_reversed_period, *arguments),
        (scene, reversed_state),
        lambda n_lanes: make_empty_results(n_lanes, 0, scene.dtype),
        min_lanes,
    )
    return State(reversed_end.x, -reversed_end.v, -reversed_end.phase, jnp.zeros_like(reversed_end.x)), impacts


def _run_reversed_period(scene, state):
    coeffs = reversed_coefficients(scene)
    path, start_status = call_without_inlining(start_path, coeffs, state, check_scene_rules=_is_valid_reversed)
    return fly_once(coeffs, state, path, start_status, coeffs.period)


def reversed_coefficients(scene):
    """Compute the `FlowCoefficients` of a scene with time reversed."""
    coeffs = make_flow_coefficients(scene)
    reversed_coeffs = coeffs.flow.reverse_time(coeffs)._replace(walls=_reverse_walls(coeffs))
    return reversed_coeffs._replace(
        soft_flows=tuple(
            contact.reverse_wall_flow(reversed_coeffs, wall, wall_flow)
            for contact, wall, wall_flow in zip(
                coeffs.kinds.wall_contacts, reversed_coeffs.walls, coeffs.soft_flows, strict=True
            )
        )
    )


def _reverse_walls(coeffs):
    """Return the walls with time reversed."""
    return tuple(
        contact.reverse_wall(replace(wall, sine=None if wall.sine is None else -wall.sine))
        for contact, wall in zip(coeffs.kinds.wall_contacts, coeffs.walls, strict=True)
    )


def _is_valid_reversed(coeffs):
    """Apply `check_validity` to a reversed scene: to the scene from which it was made, and to 1 / R."""
    forward_coeffs = coeffs._replace(damping=-coeffs.damping, walls=_reverse_walls(coeffs))
    is_valid_scene, is_finite_scene = check_validity(forward_coeffs)
    for wall in coeffs.walls:
        if wall.restitution is not None:
            is_finite_scene &= jnp.isfinite(wall.restitution)
    return is_valid_scene, is_finite_scene
