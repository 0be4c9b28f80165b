"""Impacts one after the other, not closed to an orbit: what each flight leaves open, and how that changes.

A node is an impact (unknown: its time, and the speed before it) or a free state at a given time (unknown: x, v). The
flight from a node has to end at the next one: at an impact on its wall and with its speed, at a state in that state. As
the flight is free, both are smooth in the unknowns and in every number of the scene: nothing is chaotic here, however
long the chain, and a grazing is no singularity. Whether a flight passes through a wall is asked apart (`first_return`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.persistent_jit import persistent_jit

from ..flight import drive, flow
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..orbits.meeting_wall import way
from ..orbits.saltation import meeting
from ..scene.scene import SIDES
from .few_programs import filled, with_ways


class Nodes(NamedTuple):
    """Nodes in order of time. sides: -1, 1 of an impact, 0 a free state; when: the time of a free state; first, second:
    time and speed of an impact, x and v of a state. Times since the drive was at phase 0."""

    sides: Float[np.ndarray, " nodes"]
    when: Float[np.ndarray, " nodes"]
    first: Float[np.ndarray, " nodes"]
    second: Float[np.ndarray, " nodes"]

    @property
    def times(self) -> Float[np.ndarray, " nodes"]:
        """Of all nodes."""
        return np.where(self.sides == 0, self.when, self.first)


class Left(NamedTuple):
    """values: (flights, 2), what is to be zero; by: its derivatives by the node's own two unknowns, by the next one's,
    by the free numbers and by the phase, (flights, 2, 4 + numbers + 1)."""

    values: Float[np.ndarray, "flights 2"]
    by: Float[np.ndarray, "flights 2 columns"]


def left(scene, names, nodes, numbers, phase):
    """The `Left` of nodes in a scene whose numbers of these names are others, the drive's phase at time 0 too."""
    count = len(nodes.sides)
    if count < 2:
        return Left(np.zeros((0, 2)), np.zeros((0, 2, 5 + len(names))))
    there, ways = with_ways(scene, names, numbers)
    values, by = (np.asarray(one) for one in _left(there, ways, *map(filled, nodes), np.asarray(float(phase))))
    by = np.concatenate([by[: 4 + len(names)], by[-1:]])
    return Left(values[:, : count - 1].T, np.moveaxis(by[:, :, : count - 1], (0, 1, 2), (2, 1, 0)))


def aimed(scene, nodes, phase):
    """(speed after the node, speed before the next), (flights,) each and towards the wall's inside and outside: with
    which a flight goes from one impact's time and place to the next's. What both say of an impact's speed differs
    where times are not those of the scene. A stay within a soft wall takes half a swing, as if nothing else pulled."""
    count, sides = len(nodes.sides), np.asarray(nodes.sides)
    stays = sum((np.where(sides == sign, span, 0.0) for sign, span in _half_swings(scene)), 0.0 * sides)
    given = map(filled, nodes._replace(second=stays))
    after, before = (np.asarray(one) for one in _aimed(scene, *given, phase))
    return after[: count - 1], before[: count - 1]


def _half_swings(scene):
    """(side, how long the mass is within) of soft walls."""
    for side, wall in scene.walls.items():
        if wall.soft:
            spare = 1.0 + float(wall.stiffness) - float(scene.parameter(f"{side}.damping")) ** 2
            yield (1.0 if side == SIDES[1] else -1.0), np.pi / np.sqrt(max(spare, 1.0))


@persistent_jit
def _left(scene, ways, sides, when, first, second, phase):
    """(values, derivatives by the unknowns, along the ways of the scene and by the phase)."""
    own = first, second, jnp.roll(first, -1), jnp.roll(second, -1)

    def values(first, second, after, later, scene, phase):
        return jnp.stack(_flown(scene, sides, when, (first, second), (after, later), phase))

    def along(*way):
        return jax.jvp(values, (*own, scene, phase), way)[1]

    count = len(jax.tree.leaves(ways)[0])
    eye, every = jnp.eye(4 + count + 1), jnp.ones_like(first)
    by_own = [eye[:, k, None] * every for k in range(4)]
    by_scene = jax.tree.map(lambda leaf: jnp.pad(leaf, (4, 1)), ways)
    by = jax.vmap(along)(*by_own, by_scene, eye[:, -1])
    return values(*own, scene, phase), by


def _flown(scene, sides, when, own, following, phase):
    """(gap, excess): of where flights end, and of the speed there."""
    frame, after = framed(scene), jnp.roll(sides, -1)
    free, free_next = sides == 0, after == 0
    begin, end = jnp.where(free, when, own[0]), jnp.where(free_next, jnp.roll(when, -1), following[0])
    cosine, sine = _turned(frame, phase, begin)
    met = meeting(frame, sides, cosine, sine, jnp.where(free, 0.0, own[1]))
    stay = 0.0 if met.stay is None else jnp.where(free, 0.0, met.stay)
    x, v = (jnp.where(free, mine, its) for mine, its in zip(own, met.state, strict=True))
    cosine, sine = (jnp.where(free, mine, its) for mine, its in zip((cosine, sine), met.phasor, strict=True))
    time = jnp.maximum(end - begin - stay, 0.0)
    end_x, end_v = flow_of(frame).fly(frame, x, v, cosine, sine, time)[:2]
    where, pace = way(frame, after, *_turned(frame, phase, end), 1)
    gap = end_x - jnp.where(free_next, following[0], where)
    excess = jnp.where(free_next, end_v - following[1], after * (end_v - pace) - following[1])
    return gap, excess


def _turned(frame, phase, time):
    angle = phase + frame.frequency * time
    return jnp.cos(angle), jnp.sin(angle)


@persistent_jit
def _aimed(scene, sides, when, first, stays, phase):
    frame, after, begin = framed(scene), jnp.roll(sides, -1), first + stays
    time = jnp.maximum(jnp.roll(first, -1) - begin, 0.0)
    cosine, sine = _turned(frame, phase, begin)
    x, pace = way(frame, sides, cosine, sine, 1)
    free_flow, forced, _ = flow.doubled(frame.series, frame.frequency, frame.damping, time)
    force = frame.force * cosine, frame.force * sine
    still, _ = flow.flown((free_flow, forced), *force, x, 0.0 * x)
    more = drive.responses(frame.terms, frame.frequency, frame.damping, time)
    dx, dv = drive.forced(frame.terms, more, frame.frequency, cosine, sine)
    still = still + dx if frame.terms else still
    where, pace_next = way(frame, after, *_turned(frame, phase, jnp.roll(first, -1)), 1)
    move = free_flow[1]
    v = (where - still) / jnp.where(move == 0, 1.0, move)
    _, end = flow.flown((free_flow, forced), *force, x, v)
    end = end + dv if frame.terms else end
    return -sides * (v - pace), after * (end - pace_next)
