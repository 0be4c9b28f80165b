"""What a scene settles on from many random starts: its attractors, each with its share of the starts."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from . import check
from .entry import CAP
from .evidence import chaotic, periodic
from .find import find_orbit
from .meetings import is_same_orbit, is_same_set, is_symmetric, mirrored
from .orbit import Orbit, OrbitError
from .settling import settle_lanes
from .starts import box, random_starts
from .state import STATUS, State


@dataclass(frozen=True, eq=False)
class Attractor:
    """One of the things that starts settle on.

    label: P n p q, "chaotic" or "unresolved". kind: "periodic", "chaotic" or "unresolved"; the last stands for all
    starts that gave evidence for neither. orbit: the `Orbit` of a periodic one, polished, with its multipliers; None
    where there is none, or none was found. share: of the starts; all shares sum to 1. state: on it, at phase 0; of the
    unresolved, the first of the starts. periods: minimal number of drive periods of a periodic one, else 0. itinerary:
    the walls it hits, a word a period from `state` on, else (). points: x and v on Sigma from `state` on, shape
    (periods, 2); a sample where chaotic. least_speed: of its impacts, inf if none. exponent: the largest Lyapunov
    exponent per drive period; -inf where it is too low to be measured, nan where unknown. mirror_of: the place in the
    tuple of its mirror image, its own where it is symmetric; None where none was found or the scene has no mirror
    symmetry. note: what was seen.
    """

    label: str
    kind: str
    share: float
    state: State
    periods: int
    itinerary: tuple[str, ...]
    points: np.ndarray
    least_speed: float
    exponent: float
    mirror_of: int | None
    note: str
    orbit: Orbit | None = None


@check.host("use strobe")
def find_attractors(scene, starts=200, seed=0, settle=300):
    """What a scene settles on: a tuple of `Attractor`, the largest share first, unresolved starts last.

    scene: a single one. starts: how many, at phase 0, drawn from `seed` as `starts.box` says, the same ones each time.
    settle: drive periods before recurrence is looked for. Periodic is what recurs after at most 32 periods and draws
    nearby trajectories in. Chaotic is what does not recur and has a largest exponent that is positive beyond doubt, in
    a scene that loses energy; starts that fill the same set there are one attractor. All else is unresolved.

    Raises SceneError for a batch of scenes and for counts that cannot be.
    """
    check.is_single(scene)
    starts, settle = check.whole("starts", starts, 1), check.whole("settle", settle, 0)
    given = random_starts(scene, starts, check.whole("seed", seed, 0))
    left, right, _ = box(scene)
    found, periods, scale = settle_lanes(scene, given, settle, max(abs(left), abs(right)))
    orbits, adrift = periodic(scene, found, periods, settle, scale)
    sets, restless = chaotic(scene, found, np.flatnonzero((periods == 0) & (found.status < CAP)), scale)
    bad = {int(lane): f"status {STATUS[found.status[lane]]}" for lane in np.flatnonzero(found.status >= CAP)}
    seen = sorted(orbits + sets, key=lambda one: (-len(one.lanes), one.numbers["label"], *one.numbers["points"][0]))
    return _paired(scene, seen, starts) + _unresolved(given, adrift | restless | bad, starts)


def _paired(scene, seen, starts):
    """The attractors with their shares, and their mirror images where the scene is symmetric."""

    symmetric = is_symmetric(scene)

    def image(one):
        test = is_same_orbit if one.numbers["periods"] else is_same_set
        places = (
            place
            for place, other in enumerate(seen)
            if one.numbers["periods"] == other.numbers["periods"] and test(mirrored(one.hits), other.hits)
        )
        return next(places, None) if symmetric else None

    return tuple(
        Attractor(**one.numbers, share=len(one.lanes) / starts, mirror_of=image(one), orbit=_orbit(scene, one.numbers))
        for one in seen
    )


def _orbit(scene, numbers):
    if not numbers["periods"]:
        return None
    try:
        return find_orbit(scene, numbers["state"], numbers["periods"], settle=0)
    except OrbitError:
        return None


def _unresolved(given, reasons, starts):
    """One entry for all lanes that are on no attractor, none where there are no such lanes."""
    if not reasons:
        return ()
    first = min(reasons)
    counts = Counter(reasons.values()).most_common()
    entry = Attractor(
        label="unresolved",
        kind="unresolved",
        share=len(reasons) / starts,
        state=State(float(given.x[first]), float(given.v[first]), 0.0, 0.0),
        periods=0,
        itinerary=(),
        points=np.empty((0, 2)),
        least_speed=np.nan,
        exponent=np.nan,
        mirror_of=None,
        note="; ".join(f"{number} starts: {reason}" for reason, number in counts),
    )
    return (entry,)
