"""What a scene settles on from many random starts: its attractors, each with its share of the starts."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from continuation.limits import EXPIRED_REASON, UNLIMITED, Results, limits_of, partial_reason

from ..maps.initial_conditions import draw_initial_states, initial_box
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.orbit_from_impacts import read_from_phase_zero
from ..scene import check
from ..scene.codes import Status
from ..scene.scales import Scales
from ..scene.scene import Scene
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from . import derived_candidates
from .classify import AttractorCandidate, find_chaotic, find_periodic
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


@check.host_only("use strobe")
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
    starts, settle = check.whole_number("starts", starts, 1), check.whole_number("settle", settle, 0)
    start_states = draw_initial_states(scene, starts, check.whole_number("seed", seed, 0))
    settled_starts = settle_starts(scene, start_states, settle, limits)
    n_expired = sum(reason == EXPIRED_REASON for reason in settled_starts.failures.values())
    stopped = partial_reason(starts - n_expired, starts, "starts") if n_expired else ""
    return Results(
        make_attractors(scene, settled_starts.candidates, starts)
        + _unresolved_attractor(start_states, settled_starts.failures, starts),
        stopped,
    )


class SettledStarts(NamedTuple):
    """What starts have settled on. candidates: a list of `AttractorCandidate`, its lanes the places of the starts that
    did, the most first; failures: {start: why it is on none of these}; scale: of x and v, the largest; status: of each
    start."""

    candidates: list[AttractorCandidate]
    failures: dict[int, str]
    scale: float | np.floating
    status: Int[np.ndarray, " starts"]


def settle_starts(scene, start_states, settle, limits=UNLIMITED):
    """What these starts of a scene settle on, and what is known without a start: `SettledStarts`. limits: of the time,
    after which starts are left as they are."""
    x_min, x_max, _ = initial_box(scene)
    iterates, periods, scale = settle_lanes(scene, start_states, settle, max(abs(x_min), abs(x_max)), limits)
    orbit_candidates, orbit_failures = find_periodic(scene, iterates, periods, settle, scale)
    nonrecurrent_lanes = np.flatnonzero((periods == 0) & (iterates.status < Status.CAP))
    chaotic_candidates, nonrecurrent_lanes = find_chaotic(scene, iterates, nonrecurrent_lanes, scale, limits)
    status_failures = {
        int(lane): f"status {Status(iterates.status[lane]).word}"
        for lane in np.flatnonzero(iterates.status >= Status.CAP)
    }
    candidates = orbit_candidates + chaotic_candidates
    candidates += derived_candidates.free_response(scene, candidates)
    candidates += derived_candidates.mirror_images(scene, candidates, scale)
    candidates.sort(
        key=lambda candidate: (-len(candidate.lanes), candidate.fields["label"], *candidate.fields["points"][0])
    )
    return SettledStarts(candidates, orbit_failures | nonrecurrent_lanes | status_failures, scale, iterates.status)


def make_attractors(scene, candidates, n_starts):
    """The `AttractorCandidate` of a scene's attractors as `Attractor`s, with their shares, and their mirror images
    where the scene is symmetric."""
    symmetric = is_symmetric(scene)
    orbits = [_polish_orbit(scene, candidate.fields) for candidate in candidates]
    return tuple(
        Attractor(
            **candidate.fields | _exponent_fields(candidate.fields, orbit),
            **_share_fields(len(candidate.lanes), n_starts),
            mirror_of=derived_candidates.mirror_index(candidate, candidates) if symmetric else None,
            orbit=orbit,
            scales=scene.scales,
        )
        for candidate, orbit in zip(candidates, orbits, strict=True)
    )


def _exponent_fields(fields, orbit):
    """{"exponent", "note"} of an attractor: of an orbit by its multipliers, else as it was measured."""
    exponent = fields["exponent"]
    if orbit is not None and np.isfinite(orbit.multipliers).all():
        with np.errstate(divide="ignore"):
            exponent = float(np.log(abs(orbit.multipliers).max())) / orbit.periods
    return {"exponent": exponent, "note": f"{fields['note']}; exponent {exponent:.3g} per period"}


def _share_fields(n_settled, n_starts):
    return {"share": n_settled / n_starts, "share_bounds": share_bounds(n_settled, n_starts), "starts": n_starts}


def _polish_orbit(scene, fields):
    """The `Orbit` of a periodic attractor, at the attractor's own phase and period; None where there is none."""
    if not fields["periods"]:
        return None
    try:
        orbit = find_orbit(scene, fields["state"], fields["periods"], settle=0)
    except OrbitError:
        return None
    if orbit.unknowns == "impacts":
        orbit = read_from_phase_zero(orbit, fields["itinerary"])
    return replace(orbit, state=replace(orbit.state, contact=fields["state"].contact))


def _unresolved_attractor(start_states, reasons, n_starts):
    """One entry for all lanes that are on no attractor, none where there are no such lanes."""
    if not reasons:
        return ()
    first_lane = min(reasons)
    counts = Counter(reasons.values()).most_common()
    attractor = Attractor(
        label="unresolved",
        kind="unresolved",
        **_share_fields(len(reasons), n_starts),
        state=State(float(start_states.x[first_lane]), float(start_states.v[first_lane]), 0.0, 0.0),
        periods=0,
        itinerary=(),
        points=np.empty((0, 2)),
        least_speed=np.nan,
        exponent=np.nan,
        mirror_of=None,
        note="; ".join(f"{count} starts: {reason}" for reason, count in counts),
    )
    return (attractor,)
