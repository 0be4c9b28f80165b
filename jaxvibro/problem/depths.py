"""How deep a contact is beyond a grazing: on the orbit that leaves it out, behind the wall that is touched.

A contact that would be d deep meets a rigid wall with the speed sqrt(2 a d), a the acceleration away from the wall at
the grazing, and its impact changes the velocity by (1 + R) sqrt(2 a d): by a root, where all else changes smoothly
(Nordmark, J. Sound Vib. 145, 279, 1991). A soft wall changes the velocity by d^(3/2): it has no root, unless it moves
and has a damping of its own. Then the force has a jump at the wall, the acceleration is a + j within, and the contact
of 2 sqrt(2 a d) / (a + j) changes the velocity by j times that.
"""

from typing import NamedTuple

import numpy as np

from continuation import event_search

from .equations import problem
from .grazing import opening, with_touches
from .soft_grazing import is_smooth
from .touches import scales, settled_near, stays, touches, wall_sides


class Depth(NamedTuple):
    """Of one touch of a wall. side; root: by how much the velocity jumps, over the root of the depth, 0 where that goes
    with a higher power, inf where a soft wall does not let go at once; slope: how the depth grows with the parameter
    along the orbit that leaves all touches out; acceleration: away from the wall, relative to it."""

    side: int
    root: float
    slope: float
    acceleration: float


def depths(scene, along, z, length):
    """The `Depth`s at a grazing, in the order of its touches along the orbit; scene: at the point."""
    met = touches(along, z, length)
    bare, start, out = with_touches(along, z, met, (False,) * len(met))
    return tuple(one.depth for one in bare_touches(scene, bare, start, out, length))


class BareTouch(NamedTuple):
    """Where an orbit that leaves all touches out touches a wall. row: of the impact before; late: the time since the
    flight after that began; time: since the drive was at phase 0; depth: its `Depth`."""

    row: int
    late: float
    time: float
    depth: Depth


def bare_touches(scene, bare, start, out, length):
    """The `BareTouch`es of an orbit that leaves touches out, as `grazing.with_touches` gives it and them."""
    tangent = event_search.tangent(problem(bare), start, scales(bare, length), bare)
    walls, found, held = wall_sides(bare.scene), [], stays(bare, start)
    for row, wall, late in out:
        late, _, towards = settled_near(bare, start, row, wall, late)
        side, growing = walls[wall], -opening(bare, start, tangent, row, wall, late)
        slope = growing / tangent[-1] if tangent[-1] else np.inf
        begin = start[row] + held[row] if len(bare.cycle.sides) else 0.0
        away, time = -float(towards), float(begin + late)
        depth = Depth(side, _root(scene, side, away, time), float(slope), away)
        found.append(BareTouch(int(row), float(late), time, depth))
    return tuple(found)


def _root(scene, side, away, time):
    wall = scene.left if side < 0 else scene.right
    if not wall.soft:
        own = scene.restitution if wall.restitution is None else wall.restitution
        return float((1.0 + float(own)) * np.sqrt(2.0 * away))
    if is_smooth(scene, side):
        return 0.0
    turns = wall.motion.harmonic * float(scene.frequency)
    pace = -float(wall.motion.amplitude) * turns * np.sin(turns * time + float(wall.motion.phase))
    free = 0.0 if scene.force is not None else float(scene.damping)
    jump = side * 2.0 * (float(wall.damping) - free) * pace
    within = away + jump
    return float(2.0 * np.sqrt(2.0 * away) * abs(jump) / within) if within > 0 else np.inf
