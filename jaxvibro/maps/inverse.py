"""Inverse of the stroboscopic map, by the same certified flight with time reversed.

In reversed time the motion (x, -v, -phase) obeys the same equations with damping -gamma, negated phases of the walls,
and restitution 1 / R. Speeds then grow at every impact, so that there is no chatter. The energy of a flight grows like
exp(2 gamma t), which the bound on its derivatives must allow for. The entry into a soft wall and the exit from it
change places. Within the wall the damping is -gamma2, or the law takes the negated rate of the depth, and the same
bounds hold.
"""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp

from ..compiled.blocks import run_in_blocks
from ..compiled.compiler_hints import choose, stage
from ..compiled.kernels import call_as_kernel
from ..flight import integrate, reversed_contact
from ..flight.coefficients import ContactLaw, check_validity, compute_coefficients
from ..flight.entry import start_path
from ..flight.flows import flow_of
from ..scene import check
from ..scene.codes import Status
from ..scene.soft_walls import effective_restitution
from ..scene.state import State
from .one_period import empty_results, state_and_impacts


def require_reversible(scene):
    """Refuse a scene whose map has no inverse or is too damped for time reversal.

    A soft wall with critical or larger damping takes all speed: a mass that leaves it has never been outside.

    Parameters
    ----------
    scene : Scene
        A single scene.

    Raises
    ------
    ArgumentError
        If a wall takes all speed (R = 0, or a soft wall with at least critical damping), or if the damping is not less
        than 1.
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
    """Compute the state one drive period earlier; to be called within jit.

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
    end, impacts = run_in_blocks(
        lambda arguments: call_as_kernel(_reversed_period, *arguments),
        (scene, reversed_state),
        lambda n_lanes: empty_results(n_lanes, 0, scene.dtype),
        min_lanes,
    )
    return State(end.x, -end.v, -end.phase, jnp.zeros_like(end.x)), impacts


def _reversed_period(scene, state):
    coeffs = reversed_coefficients(scene)
    path, entry_status = stage(start_path, coeffs, state, check_rules=_is_valid_reversed)
    path = path._replace(time_remaining=choose(entry_status == Status.OK, coeffs.period, 0.0))
    loop = integrate.initial_loop_state(coeffs, path, 0, coeffs.period)
    return state_and_impacts(
        coeffs, integrate.run_loop(coeffs, loop, integrate.loop_limits(coeffs, 1)), state, entry_status
    )


def reversed_coefficients(scene):
    """Compute the `FlowCoefficients` of a scene with time reversed."""
    coeffs = compute_coefficients(scene)
    walls = tuple(_reverse_wall(wall) for wall in coeffs.walls)
    reversed_coeffs = flow_of(coeffs).reverse_time(coeffs)._replace(walls=walls)
    contacts = coeffs.soft_flows
    if coeffs.contact_law is ContactLaw.LINEAR:
        pairs = zip(walls, contacts, strict=True)
        contacts = tuple(
            soft_flow and reversed_contact.reverse_time(reversed_coeffs, wall, soft_flow) for wall, soft_flow in pairs
        )
    elif coeffs.contact_law is ContactLaw.FORCE_LAW:
        contacts = tuple(soft_flow and wall for wall, soft_flow in zip(walls, contacts, strict=True))
    return reversed_coeffs._replace(soft_flows=contacts)


def _reverse_wall(wall):
    wall = replace(wall, sine=None if wall.sine is None else -wall.sine)
    if wall.restitution is not None:
        return replace(wall, restitution=1.0 / wall.restitution)
    if wall.law is not None:
        return replace(wall, law=replace(wall.law, function=_reverse_law(wall.law.function)))
    return replace(wall, damping=-wall.damping)


@lru_cache(256)
def _reverse_law(law_function):
    """Return the law of a wall under time reversal."""

    def reversed_law(depth, rate, params):
        return law_function(depth, -rate, params)

    return reversed_law


def _is_valid_reversed(coeffs):
    """Apply `check_validity` to a reversed scene."""
    walls = tuple(_wall_to_validate(wall) for wall in coeffs.walls)
    is_valid_scene, is_finite = check_validity(coeffs._replace(damping=-coeffs.damping, walls=walls))
    for wall in coeffs.walls:
        if wall.restitution is not None:
            is_valid_scene &= wall.restitution >= 1
            is_finite &= jnp.isfinite(wall.restitution)
    return is_valid_scene, is_finite


def _wall_to_validate(wall):
    """Return a reversed wall in a form that `check_validity` accepts, except for its restitution."""
    if wall.restitution is not None:
        return replace(wall, restitution=0.0 * wall.position)
    return wall if wall.law is not None else replace(wall, damping=-wall.damping)
