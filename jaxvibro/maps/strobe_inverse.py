"""Inverse of the stroboscopic map, by certified flight with time reversed.

In reversed time the motion (x, -v, -phase) obeys the same equations with damping -gamma, negated phases of the walls
and of the further drive terms, and restitution 1 / R. Speeds do not decrease at an impact, so that there is no chatter.
The energy of a flight grows like exp(2 gamma t); the bounds on derivatives include this growth. Entry into a soft wall
and exit from the wall are exchanged. Within the wall the damping is -gamma2, or the contact law receives the negated
rate of the depth. The bounds are unchanged there.
"""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..compiled.lane_blocks import run_in_blocks
from ..flight import integration_loop, reversed_contact
from ..flight.flight_coefficients import ContactLaw, check_validity, make_flow_coefficients
from ..flight.flow_dispatch import flow_of
from ..flight.path_start import start_path
from ..scene import check
from ..scene.codes import Status
from ..scene.soft_walls import effective_restitution
from ..scene.state import State
from .reference_strobe import make_empty_results, state_and_impacts


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
    for side, wall in scene.walls.items():
        if wall.soft and wall.law is None and scene.force is None:
            damping = scene.parameter(f"{side}.damping")
            if not effective_restitution(wall.stiffness, damping) > 0:
                raise check.ArgumentError(f"{side}.damping", "must be less than critical for the inverse map", damping)
        restitution = scene.bounce(side)
        if restitution == 0:
            raise check.ArgumentError(f"{side}.restitution", "must be greater than 0 for the inverse map", restitution)
    if scene.force is None and not scene.damping < 1:
        raise check.ArgumentError("damping", "must be less than 1 for the inverse map", scene.damping)


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
    path = path._replace(time_remaining=choose(start_status == Status.OK, coeffs.period, 0.0))
    loop_state = integration_loop.initial_loop_state(coeffs, path, 0, coeffs.period)
    return state_and_impacts(
        coeffs,
        integration_loop.run_loop(coeffs, loop_state, integration_loop.loop_limits(coeffs, 1)),
        state,
        start_status,
    )


def reversed_coefficients(scene):
    """Compute the `FlowCoefficients` of a scene with time reversed."""
    coeffs = make_flow_coefficients(scene)
    reversed_walls = tuple(_reverse_wall(wall) for wall in coeffs.walls)
    reversed_coeffs = flow_of(coeffs).reverse_time(coeffs)._replace(walls=reversed_walls)
    reversed_soft_flows = coeffs.soft_flows
    if coeffs.contact_law is ContactLaw.LINEAR:
        walls_with_soft_flows = zip(reversed_walls, reversed_soft_flows, strict=True)
        reversed_soft_flows = tuple(
            soft_flow and reversed_contact.reverse_time(reversed_coeffs, wall, soft_flow)
            for wall, soft_flow in walls_with_soft_flows
        )
    elif coeffs.contact_law is ContactLaw.FORCE_LAW:
        reversed_soft_flows = tuple(
            soft_flow and wall for wall, soft_flow in zip(reversed_walls, reversed_soft_flows, strict=True)
        )
    return reversed_coeffs._replace(soft_flows=reversed_soft_flows)


def _reverse_wall(wall):
    wall = replace(wall, sine=None if wall.sine is None else -wall.sine)
    if wall.restitution is not None:
        return replace(wall, restitution=1.0 / wall.restitution)
    if wall.law is not None:
        return replace(wall, law=replace(wall.law, function=_reverse_wall_law(wall.law.function)))
    return replace(wall, damping=-wall.damping)


@lru_cache(256)
def _reverse_wall_law(law_function):
    """Return the law of a wall under time reversal."""

    def reversed_law(depth, depth_rate, law_params):
        return law_function(depth, -depth_rate, law_params)

    return reversed_law


def _is_valid_reversed(coeffs):
    """Apply `check_validity` to a reversed scene."""
    walls_to_validate = tuple(_wall_for_validity_check(wall) for wall in coeffs.walls)
    is_valid_scene, is_finite_scene = check_validity(coeffs._replace(damping=-coeffs.damping, walls=walls_to_validate))
    for wall in coeffs.walls:
        if wall.restitution is not None:
            is_valid_scene &= wall.restitution >= 1
            is_finite_scene &= jnp.isfinite(wall.restitution)
    return is_valid_scene, is_finite_scene


def _wall_for_validity_check(reversed_wall):
    """Return a reversed wall in a form that `check_validity` accepts, except for its restitution."""
    if reversed_wall.restitution is not None:
        return replace(reversed_wall, restitution=0.0 * reversed_wall.position)
    return reversed_wall if reversed_wall.law is not None else replace(reversed_wall, damping=-reversed_wall.damping)
