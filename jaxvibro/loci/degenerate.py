"""Where a locus of grazings ends in a degenerate one (DG): the touch has neither speed nor acceleration.

Beyond, the wall presses as the mass comes to it, which rests at once: nothing grazes any more. Towards the point the
hops behind the touch, by which the mass comes to rest, lose their speed and time with its acceleration, so that the
equations with them are singular there. Those without are not: the touch is the last row before the release.
"""

import numpy as np

from continuation.stretch import Mark

from ..problem.end import End
from ..problem.equations import are_impacts, are_releases, codes
from ..problem.grazing import padded, recut
from ..problem.touches import acceleration, zero_near
from .extended_system import Grazing

SLOW = 1e-3  # of the scene's length per t: hops that are as slow may be about to vanish
NEAR = 1e-4  # of 1 + abs of the parameters: so far from its end is the point


def to_degenerate(way, one):
    """The `Stretch` along a `LocusWay` with its end put to the DG that it comes to, None where it comes to none."""
    curve = way.curve
    if one.end is not End.STEP or not isinstance(curve, Grazing) or curve.cycle.releases is None:
        return None
    z, touch = np.array(one.points.z[-1]), int(np.argmax(curve.pick))
    gone = _vanishing(curve, z, touch, way.asked.length)
    if not gone:
        return None
    rows, count = len(curve.cycle.sides), int(np.sum(curve.cycle.sides != 0))
    kept = [k for k in range(count) if k not in gone]
    listed = zip(z[kept], z[rows + np.array(kept)], codes(curve.cycle)[kept], strict=True)
    bare = recut(curve, padded(curve, list(listed)), kept)
    place = kept.index(touch)
    start = np.concatenate([bare.cycle.times, bare.cycle.speeds, z[2 * rows :]])
    found = zero_near(bare, start, lambda z: acceleration(bare, z, place))
    if found.z is None or (abs(found.z[-2:] - z[-2:]) > NEAR * (1.0 + abs(z[-2:]))).any():
        return None
    wide = len(bare.cycle.sides)
    z[kept], z[[rows + k for k in kept]], z[-2:] = found.z[: len(kept)], found.z[wide : wide + len(kept)], found.z[-2:]
    z[gone], z[[rows + k for k in gone]] = found.z[place], 0.0
    last = len(one.points.z) - 1
    points = one.points._replace(z=one.points.z.copy(), residual=one.points.residual.copy())
    points.z[last], points.residual[last] = z, found.residual
    marks = (*(mark for mark in one.marks if mark.place < last), Mark(last, "DG", found.residual))
    return one._replace(points=points, marks=marks, end=End.GRAZE)


def _vanishing(curve, z, touch, length):
    """The rows of the hops between a touch and the release that follows, where all are slow; none elsewhere."""
    rows, count = len(curve.cycle.sides), int(np.sum(curve.cycle.sides != 0))
    sides, hits, found = codes(curve.cycle)[:count], are_impacts(curve.cycle), []
    for ahead in range(1, count):
        k = (touch + ahead) % count
        if are_releases(sides[k]):
            return found if np.sign(sides[k]) == sides[touch] else []
        if not hits[k] or sides[k] != sides[touch] or z[rows + k] > SLOW * length:
            return []
        found.append(k)
    return []
