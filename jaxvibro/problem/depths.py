"""How deep a contact is beyond a grazing: on the orbit that leaves it out, behind the wall that is touched.

A contact that would be d deep meets a rigid wall with the speed sqrt(2 a d), a the acceleration away from the wall at
the grazing, and its impact changes the velocity by (1 + R) sqrt(2 a d): by a root, where all else changes smoothly
(Nordmark, J. Sound Vib. 145, 279, 1991). Of a soft wall the change goes as d^(3/2) at least: it has no root.
"""

from typing import NamedTuple

from continuation import event_search

from .equations import problem
from .grazing import opening, with_touches
from .touches import scales, settled_near, touches, wall_sides


class Depth(NamedTuple):
    """Of one touch of a wall. side; root: by how much the velocity jumps, over the root of the depth, 0 at a soft wall;
    slope: how the depth grows with the parameter along the orbit that leaves all touches out; acceleration: away from
    the wall, relative to it."""

    side: int
    root: float
    slope: float
    acceleration: float


def depths(scene, along, z, length):
    """The `Depth`s at a grazing, in the order of its touches along the orbit; scene: at the point."""
    met = touches(along, z, length)
    bare, start, out = with_touches(along, z, met, (False,) * len(met))
    tangent = event_search.tangent(problem(bare), start, scales(bare, length), bare)
    walls, found = wall_sides(along.scene), []
    for row, wall, late in out:
        late, _, towards = settled_near(bare, start, row, wall, late)
        closing = -opening(bare, start, tangent, row, wall, late)
        slope = closing / tangent[-1] if tangent[-1] else float("inf")
        side = walls[wall]
        found.append(Depth(side, _root(scene, side, -float(towards)), float(slope), -float(towards)))
    return tuple(found)


def _root(scene, side, acceleration):
    wall = scene.left if side < 0 else scene.right
    if wall.soft or acceleration < 0:
        return 0.0
    own = scene.restitution if wall.restitution is None else wall.restitution
    return float((1.0 + float(own)) * (2.0 * acceleration) ** 0.5)
