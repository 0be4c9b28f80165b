"""What a scene settles on from many random starts: its attractors, each with its share of the starts."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from continuation.limits import EXPIRED, UNLIMITED, Results, limits_of, partial_reason

from ..maps.initial_conditions import box, random_starts
from ..orbits.by_impacts import from_phase_0
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit, OrbitError
from ..scene import check
from ..scene.codes import Status
from ..scene.scales import Scales
from ..scene.scene import Scene
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from . import free_and_mirrored
from .classify import Evidence, chaotic, periodic
from .shares import share_bounds
from .transients import settle_lanes


@dataclass(frozen=True, eq=False)
class Attractor:
    """One of the things that starts settle on.

    label: P n p q (P1-0-inf with complete chatter on the right), "chaotic" or "unresolved". kind: "periodic", "chaotic"
    or "unresolved"; the last stands for all starts that gave evidence for neither. orbit: the `Orbit` of a periodic
    one, polished, with its multipliers; None where there is none, or none was found; its state and itinerary are these
    here, read from phase 0 on. share: of the starts; all shares sum to 1; 0 of what none settled on. share_bounds: the
    lowest and the highest share that so many starts speak for, at 95 % (`shares.share_bounds`). starts: how many there
    were. state: on it, at phase 0; of the unresolved, the first of the starts. periods: minimal number of drive periods
    of a periodic one, else 0. itinerary: the walls it hits, a word a period from `state` on, else (). points: x and v
    on Sigma from `state` on, shape (periods, 2); a sample where chaotic. least_speed: of its impacts, inf if none.
    exponent: the largest Lyapunov exponent per drive period, of an orbit by its multipliers; -inf where it is too low
    to be measured, nan where unknown. mirror_of: the place in the tuple of its mirror image, its own where it is
    symmetric; None where none was found or the scene has no mirror symmetry. note: what was seen. rests: whether the
    mass of a periodic one rests on a wall for a while; the itinerary has the hops of complete chatter up to where they
    are certain to end. scales: the scene's.
    """

    label: str
    kind: str
    share: float
    share_bounds: tuple[float, float]
    starts: int
    state: State
    periods: int
    itinerary: tuple[str, ...]
    points: Float[np.ndarray, "points 2"]
    least_speed: float
    exponent: float
    mirror_of: int | None
    note: str
    orbit: Orbit | None = None
    rests: bool = False
    scales: Scales | None = None


@check.host("use strobe")
def find_attractors(
    scene: Scene, starts: int = 200, seed: int = 0, settle: int = 300, *, max_seconds: float | None = None
) -> Results[Attractor]:
    """What a scene settles on: a tuple of `Attractor`, the largest share first, unresolved starts last.

    scene: a single one. starts: how many, at phase 0, the same ones each time: drawn from `seed`, uniformly in
    `initial_conditions.box`, x between the walls, at most 3 max(1, omega A / sqrt(D)) fast. Shares are of that box.
    settle: drive periods before recurrence is looked for. Periodic is what recurs after at most 32 periods and draws
    nearby trajectories in. Chaotic is what does not recur and has a largest exponent that is positive beyond doubt, in
    a scene that loses energy; starts that fill the same set there are one attractor. All else is unresolved. Whatever
    the starts say, the free response is there if it attracts and keeps off the walls, and so are mirror images.

    max_seconds: wall-clock time, s, after which starts that have not settled are run no further; None is no limit. They
    are then unresolved, and the attribute `stopped` of the tuple, else "", says how many starts are done.

    Raises ArgumentError for a batch of scenes and for counts that cannot be.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    starts, settle = check.whole("starts", starts, 1), check.whole("settle", settle, 0)
    given = random_starts(scene, starts, check.whole("seed", seed, 0))
    found = settled_on(scene, given, settle, limits)
    left = sum(reason == EXPIRED for reason in found.lost.values())
    stopped = partial_reason(starts - left, starts, "starts") if left else ""
    return Results(paired(scene, found.seen, starts) + _unresolved(given, found.lost, starts), stopped)


class Settled(NamedTuple):
    """What starts have settled on. seen: a list of `Evidence`, its lanes the places of the starts that did, the most
    first; lost: {start: why it is on none of these}; scale: of x and v, the largest; status: of each start."""

    seen: list[Evidence]
    lost: dict[int, str]
    scale: float | np.floating
    status: Int[np.ndarray, " starts"]


def settled_on(scene, given, settle, limits=UNLIMITED):
    """What these starts of a scene settle on, and what is known without a start: `Settled`. limits: of the time, after
    which starts are left as they are."""
    left, right, _ = box(scene)
    found, periods, scale = settle_lanes(scene, given, settle, max(abs(left), abs(right)), limits)
    orbits, adrift = periodic(scene, found, periods, settle, scale)
    restless = np.flatnonzero((periods == 0) & (found.status < Status.CAP))
    sets, restless = chaotic(scene, found, restless, scale, limits)
    bad = {
        int(lane): f"status {Status(found.status[lane]).word}" for lane in np.flatnonzero(found.status >= Status.CAP)
    }
    seen = orbits + sets
    seen += free_and_mirrored.free(scene, seen)
    seen += free_and_mirrored.images(scene, seen, scale)
    seen.sort(key=lambda one: (-len(one.lanes), one.numbers["label"], *one.numbers["points"][0]))
    return Settled(seen, adrift | restless | bad, scale, found.status)


def paired(scene, seen, starts):
    """The `Evidence` of a scene's attractors as `Attractor`s, with their shares, and their mirror images where the
    scene is symmetric."""
    symmetric = is_symmetric(scene)
    orbits = [_polished(scene, one.numbers) for one in seen]
    return tuple(
        Attractor(
            **one.numbers | _rated(one.numbers, orbit),
            **_share(len(one.lanes), starts),
            mirror_of=free_and_mirrored.image_place(one, seen) if symmetric else None,
            orbit=orbit,
            scales=scene.scales,
        )
        for one, orbit in zip(seen, orbits, strict=True)
    )


def _rated(numbers, orbit):
    """{"exponent", "note"} of an attractor: of an orbit by its multipliers, else as it was measured."""
    rate = numbers["exponent"]
    if orbit is not None and np.isfinite(orbit.multipliers).all():
        with np.errstate(divide="ignore"):
            rate = float(np.log(abs(orbit.multipliers).max())) / orbit.periods
    return {"exponent": rate, "note": f"{numbers['note']}; exponent {rate:.3g} per period"}


def _share(count, starts):
    return {"share": count / starts, "share_bounds": share_bounds(count, starts), "starts": starts}


def _polished(scene, numbers):
    """The `Orbit` of a periodic attractor, at the attractor's own phase and period; None where there is none."""
    if not numbers["periods"]:
        return None
    try:
        orbit = find_orbit(scene, numbers["state"], numbers["periods"], settle=0)
    except OrbitError:
        return None
    if orbit.unknowns == "impacts":
        orbit = from_phase_0(orbit, numbers["itinerary"])
    return replace(orbit, state=replace(orbit.state, contact=numbers["state"].contact))


def _unresolved(given, reasons, starts):
    """One entry for all lanes that are on no attractor, none where there are no such lanes."""
    if not reasons:
        return ()
    first = min(reasons)
    counts = Counter(reasons.values()).most_common()
    entry = Attractor(
        label="unresolved",
        kind="unresolved",
        **_share(len(reasons), starts),
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
