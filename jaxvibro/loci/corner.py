"""Where a grazing touches several walls at once: which of them counts on either side, and on from wall to wall.

Each touch alone has a locus of its own, as an impact without speed. It counts where the others come to be free. Where
all stay touched whatever the parameters do, as P100 touches opposite walls at the same distance, one is followed. Else
each counts on one side: the boundary has a corner there, and its derivatives are one-sided.
"""

import jax.numpy as jnp
import numpy as np

from ..problem.end import LIMITS, End
from ..problem.equations import there as at
from ..problem.orbit_on_branch import OrbitPoint
from ..scene import check
from ..scene.scene import changed
from .cut_anew import cut_anew
from .degenerate import to_degenerate
from .extended_system import Grazing
from .first_point import LocusStart, backward, ways
from .track import track

MOST = 64  # parts of a locus
SAME = 1e-6  # of a period: touches as near are one


def outsets(start, names, bounds, *steps):
    """The `track.LocusWay`s of a locus from a `LocusStart`, on and back. Raises ArgumentError for arguments that cannot
    be."""
    found = ways(start, names, bounds, *steps)
    if len(found) == 1:
        return found[0], backward(found[0])
    senses = _open(found)
    for pair in senses:
        if len(pair) == 2:
            return tuple(pair)
    single = sorted((pair[0] for pair in senses if pair), key=lambda way: way.start.tangent[-1])
    if len(single) < 2:
        rule = "must be a grazing whose touches go on alone; here touch walls at once"
        raise check.ArgumentError("special", rule, len(found))
    return single[-1], single[0]


def track_on(start, way, steps, one=None):
    """What is tracked along a `LocusWay` and on from wall to wall, a list of (`LocusWay`, `Stretch`); one: the
    first, if it is known. start: the `LocusStart` of the locus; steps: as of `outsets`."""
    found, limits = [], None if way is None else way.asked.limits
    while way is not None and len(found) < MOST:
        way = way.limited(limits)
        one = one or track(way)
        limits = limits.after(len(one.points.z) - 1)
        if one.end in LIMITS or limits.reached(1):
            found.append((way, one))
            break
        point = to_degenerate(way, one)
        new = (point, None) if point else cut_anew(start, way, one, steps)
        kept, on = new or (one, _beyond(start, way, one, steps))
        found.append((way, kept))
        way, one = on, None
    return found


def _open(found):
    """For each of some ways those of its two senses in which the other touches come free or stay."""
    return [[one for one in (way, backward(way)) if one.is_free] for way in found]


def _beyond(start, way, one, steps):
    """The `LocusWay` on from where the motion without impacts comes to touch another wall, None elsewhere."""
    curve, names = way.curve, way.asked.names
    if one.end is not End.GRAZE or not isinstance(curve, Grazing) or len(curve.hits) or float(curve.cycle.turn) < 0:
        return None
    z, none = one.points.z[-1], np.zeros(0)
    values = zip(names, z[-2:], strict=True)
    scene = changed(start.scene, {name: jnp.asarray(value, start.scene.dtype) for name, value in values})
    spot = OrbitPoint(
        float(z[-2]), none, none, none, int(curve.cycle.periods), np.nan, np.nan, float(one.points.residual[-1])
    )
    senses = _open(ways(LocusStart("GR", names[0], scene, spot), names, way.asked.bounds, *steps))
    others = (pair[0] for pair in senses if len(pair) == 1)
    return next((each for each in others if not _is_touch(each.curve, each.start.z, curve, z)), None)


def _is_touch(curve, z, other, there):
    """Whether the touches of two motions without impacts are one."""
    late = (z[0] - there[0]) * float(at(curve, z).frequency) / (2.0 * np.pi * int(curve.cycle.periods))
    return curve.cycle.sides[0] == other.cycle.sides[0] and abs(late - np.round(late)) < SAME
