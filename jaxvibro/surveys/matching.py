"""Which attractors at two neighbouring values of a parameter are one.

Two are where the motion carried on from the one lands on the other and comes back. Between coarse values two that exist
side by side may lead to each other too, each where the other's branch has ended: then both are there at a value on the
way, and they stay two.
"""

from itertools import pairwise

import jax
import numpy as np

from ..attractors.free_and_mirrored import image_place
from ..attractors.transients import settle_lanes
from ..flight.wall_positions import fit
from ..maps.initial_conditions import box
from ..orbits.orbit_comparison import is_same_orbit, meetings, mirrored
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .stations import kicked, part_at

ASIDE = 0.01  # of the largest x and v: ways there and back that are as near at each step are one
NEAR = 0.1  # of the same: an orbit as near to where another one leads by its last two values


def identities(stations, name, settle):
    """The attractors that `Station`s share, carried on (`carry_on`): a list of {station: place}, the first first."""
    known = [{0: place} for place in range(len(stations[0].seen))]
    now = dict(enumerate(known))
    for k, (here, there) in enumerate(pairwise(stations)):
        ends = [_led(stations, k, now[place]) for place in range(len(here.seen))]
        onward = dict(_pairs(here, there, name, ends, settle))
        later = {}
        for place, one in now.items():
            if place in onward:
                one[k + 1] = onward[place]
                later[onward[place]] = one
        for place in range(len(there.seen)):
            if place not in later:
                later[place] = {k + 1: place}
                known.append(later[place])
        now = later
    return known


def _pairs(here, there, name, ends, settle):
    """[(place, place)] of the attractors of two stations that are one; ends: where those here lead to, (points, 2)."""
    onward = {place: one.home for place, one in here.ways[1].items()}
    back = {place: one.home for place, one in there.ways[-1].items()}
    agreed = [(i, j) for i, j in onward.items() if j is not None and back.get(j) == i]
    refused = {(i, j) for i, j in agreed if _side_by_side(here, there, name, i, j, settle)}
    found = _told_apart(here, there, [pair for pair in agreed if pair not in refused])
    left = [i for i in range(len(here.seen)) if i not in {i for i, _ in found}]
    right = [j for j in range(len(there.seen)) if j not in {j for _, j in found}]
    some = [(i, j) for i in left for j in right if (i, j) not in refused]
    apart = {(i, j): distance(ends[i], there.seen[j].numbers["points"]) / there.scale for i, j in some}
    for i, j in sorted(apart, key=lambda pair: apart[pair]):
        if i in left and j in right and _may_be(here, there, i, j, onward.get(i), back.get(j), apart[i, j]):
            found.append((i, j))
            left.remove(i)
            right.remove(j)
    return found


def _may_be(here, there, i, j, home, origin, apart):
    """Whether two that do not lead to each other both ways are taken for one.

    Of chaotic ones, whose motion may leave for others on the way, one way is enough. Orbits must be near, and lead to
    nothing else: such are those that settle too slowly to be seen on any.
    """
    if not (here.seen[i].numbers["periods"] and there.seen[j].numbers["periods"]):
        return home == j or origin == i
    return apart <= NEAR and home in (j, None) and origin in (i, None)


def _told_apart(here, there, agreed):
    """The pairs, such that a symmetric attractor goes on as the first of two mirror images, whichever it has led to.

    The first is the one whose label comes first, or else whose mean x at phase 0 is lower.
    """
    found = []
    for i, j in agreed:
        if _image(here, i) == i and _image(there, j) not in (None, j):
            j = _first(there, j)
        elif _image(there, j) == j and _image(here, i) not in (None, i):
            i = _first(here, i)
        if i not in {i for i, _ in found} and j not in {j for _, j in found}:
            found.append((i, j))
    return found


def _image(station, place):
    """The place of an attractor's mirror image, None where there is none."""
    return image_place(station.seen[place], station.seen) if is_symmetric(station.scene) else None


def _first(station, place):
    """Of an attractor and its mirror image the one that stands for both."""

    def key(place):
        numbers = station.seen[place].numbers
        return numbers["label"], numbers["points"][:, 0].mean()

    return min(place, _image(station, place), key=key)


def _side_by_side(here, there, name, i, j, settle):
    """Whether two orbits that lead to each other are both there at a value between.

    The ways there and back are compared at each step of the parameter. In the middle of those where they differ both
    motions are left to settle: one that is late, as after a symmetry breaking, comes to the other; what settles apart
    is another.
    """
    if not (here.seen[i].numbers["periods"] and there.seen[j].numbers["periods"]):
        return False
    one, two = here.ways[1][i].trail[:-1], there.ways[-1][j].trail[-2::-1]
    scale = max(here.scale, there.scale)
    apart = np.array([_hausdorff(*(part[:, :2] for part in pair)) for pair in zip(one, two, strict=True)])
    differ = np.flatnonzero(apart > ASIDE * scale)
    if not differ.size:
        return False
    step = differ[len(differ) // 2]
    scene = here.scene.replace(**{name: here.value + (there.value - here.value) * part_at(step + 1)})
    x, v, contact = np.stack([one[step, -1], two[step, -1]], -1).astype(scene.dtype)
    state = fit(scene, kicked(scene, State(x, v, np.zeros_like(x), contact), scale))
    left, right, _ = box(scene)
    found, periods, _ = settle_lanes(scene, jax.tree.map(np.asarray, state), settle, max(abs(left), abs(right)))
    return bool(periods.all()) and not _is_one(scene, *(_hits(scene, found, k, periods[k], scale) for k in (0, 1)))


def _hits(scene, found, lane, periods, scale):
    """The impacts, as points, of a lane that has settled on an orbit."""
    return meetings(
        float(scene.frequency), *(part[-periods:, lane] for part in (found.time, found.side, found.speed)), scale
    )


def _is_one(scene, hits, others):
    """Whether two orbits are one, or mirror images in a symmetric scene: a symmetric motion may have led to either."""
    return is_same_orbit(hits, others) or (is_symmetric(scene) and is_same_orbit(mirrored(hits), others))


def _hausdorff(points, others):
    """How far the farthest point of either set is from the other set."""
    apart = abs(points[:, None] - others).max(axis=-1)
    return max(apart.min(axis=0).max(), apart.min(axis=1).max())


def distance(points, others):
    """The median distance of points from another set, the larger of both ways."""
    apart = np.hypot(*np.moveaxis(points[:, None] - others, -1, 0))
    return float(max(np.median(apart.min(axis=0)), np.median(apart.min(axis=1))))


def _led(stations, k, one):
    """Where an attractor's points (points, 2) are at the next value: of an orbit, as far on as since that before."""
    numbers = stations[k].seen[one[k]].numbers
    points, n = numbers["points"], numbers["periods"]
    before = stations[k - 1].seen[one[k - 1]].numbers if k - 1 in one else None
    if not n or before is None or before["periods"] != n:
        return points
    last, now, later = (station.value for station in stations[k - 1 : k + 2])
    turned = nearest_turn(before["points"], points)
    return points + (points - turned) * ((later - now) / (now - last))


def nearest_turn(points, others):
    """Points of an orbit (periods, 2), begun where they are nearest to others, of one as long."""
    turns = [np.roll(points, k, axis=0) for k in range(len(points))]
    return min(turns, key=lambda turn: abs(turn - others).max())
