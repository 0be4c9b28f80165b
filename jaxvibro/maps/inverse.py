"""The way back: the state a drive period before, by the same certified flight with time reversed.

In -t the motion (x, -v, -phase) obeys the same equations with damping -gamma, the walls' phases negated and restitution
1 / R. Speeds then grow at every impact, so that no hops die out (`impact.chatters` never holds), and the energy of a
flight grows like exp(2 gamma t), which the bound on its derivatives has to allow for. A soft wall is entered where it
was left, and left where it was entered: between, its own damping is -gamma2, or its law that of the depth's negated
rate, and the same bounds hold.
"""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp

from ..compiled.blocks import in_blocks
from ..compiled.compiler_hints import choose, stage
from ..compiled.kernels import one_kernel
from ..flight import integrate, reversed_contact
from ..flight.coefficients import Stays, frame, is_valid
from ..flight.entry import enter
from ..flight.flows import flow_of
from ..scene import check
from ..scene.codes import Status
from ..scene.soft_walls import effective_restitution
from ..scene.state import State
from .one_period import blank, finish


def require_reversible(scene):
    """Refuse a single scene with a wall that takes all speed, as it has no way back, and one that is too damped.

    A soft wall from critical damping on takes all speed: what comes out of it was never outside.
    """
    for side, wall in scene.walls.items():
        if wall.soft and wall.law is None and scene.force is None:
            damping = scene.parameter(f"{side}.damping")
            if not effective_restitution(wall.stiffness, damping) > 0:
                raise check.ArgumentError(f"{side}.damping", "must be less than critical on the way back", damping)
        bounce = scene.bounce(side)
        if bounce == 0:
            raise check.ArgumentError(
                f"{side}.restitution", "must be greater than 0, else the map has no inverse", bounce
            )
    if scene.force is None and not scene.damping < 1:
        raise check.ArgumentError("damping", "must be less than 1 on the way back", scene.damping)


def backward(scene, state, least):
    """(State, Impacts) a drive period before a state, in blocks of so many lanes at least; inside jit.

    scene: one that `require_reversible`; state: leaves that broadcast, at their phase, which comes back. `strobe` leads
    from the result to the state. Impacts: of the reversed motion, in its order, none recorded but counted.
    """
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    turned = State(jnp.broadcast_to(state.x, shape), -state.v, -state.phase, jnp.zeros_like(state.x))
    end, impacts = in_blocks(
        lambda given: one_kernel(_through, *given), (scene, turned), lambda count: blank(count, 0, scene.dtype), least
    )
    return State(end.x, -end.v, -end.phase, jnp.zeros_like(end.x)), impacts


def _through(scene, state):
    built = reversed_frame(scene)
    path, fault = stage(enter, built, state, rules=_rules)
    path = path._replace(to_go=choose(fault == Status.OK, built.period, 0.0))
    told = integrate.begin(built, path, 0, built.period)
    return finish(built, integrate.run(built, told, integrate.cap(built, 1)), state, fault)


def reversed_frame(scene):
    """The `Frame` of a scene with time reversed."""
    built = frame(scene)
    walls = tuple(_reversed(wall) for wall in built.walls)
    back = flow_of(built).reversed_in_time(built)._replace(walls=walls)
    contacts = built.contacts
    if built.stays is Stays.SPRING:
        pairs = zip(walls, contacts, strict=True)
        contacts = tuple(soft and reversed_contact.reversed_in_time(back, wall, soft) for wall, soft in pairs)
    elif built.stays is Stays.PUSHED:
        contacts = tuple(soft and wall for wall, soft in zip(walls, contacts, strict=True))
    return back._replace(contacts=contacts)


def _reversed(wall):
    wall = replace(wall, sine=None if wall.sine is None else -wall.sine)
    if wall.restitution is not None:
        return replace(wall, restitution=1.0 / wall.restitution)
    if wall.law is not None:
        return replace(wall, law=replace(wall.law, function=_backwards(wall.law.function)))
    return replace(wall, damping=-wall.damping)


@lru_cache(256)
def _backwards(function):
    """The law of a wall as it is seen with time reversed."""

    def law(depth, rate, numbers):
        return function(depth, -rate, numbers)

    return law


def _rules(frame):
    """`is_valid` of the reversed scene."""
    walls = tuple(_plain(wall) for wall in frame.walls)
    valid, finite = is_valid(frame._replace(damping=-frame.damping, walls=walls))
    for wall in frame.walls:
        if wall.restitution is not None:
            valid &= wall.restitution >= 1
            finite &= jnp.isfinite(wall.restitution)
    return valid, finite


def _plain(wall):
    """A reversed wall as `is_valid` may judge it, but for its restitution."""
    if wall.restitution is not None:
        return replace(wall, restitution=0.0 * wall.position)
    return wall if wall.law is not None else replace(wall, damping=-wall.damping)
