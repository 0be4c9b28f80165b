"""What a scene settles on from many random starts: its attractors, each with its share of the starts."""

from collections import Counter
from dataclasses import dataclass

import jax
import numpy as np

from . import check, itinerary
from .exponent import exponents
from .meetings import is_same_orbit, is_same_set, is_symmetric, meetings, mirrored
from .settling import clusters, orbit_of, settle_lanes
from .starts import box, random_starts
from .strobe import CAP, FULL, STATUS, State
from .trail import KEEP, Trail, trail

LEAST_EXPONENT = 0.01  # per period, of chaos: mere shear passes for 0.002 over the periods that `exponents` averages
POLISH = 4  # times `settle` periods that a periodic orbit is run on before it is read
SAMPLES = 8  # times KEEP periods of chaos that are looked at
WIDE = 1000  # slots for an orbit with more impacts in a period than `trail` records: as many as the impact cap


@dataclass(frozen=True, eq=False)
class Attractor:
    """One of the things that starts settle on.

    label: P n p q, "chaotic" or "unresolved". kind: "periodic", "chaotic" or "unresolved"; the last stands for all starts
    that gave evidence for neither. share: of the starts; all shares sum to 1. state: on it, at phase 0; of the
    unresolved, the first of the starts. periods: minimal number of drive periods of a periodic one, else 0. itinerary:
    the walls it hits, a word a period, else (). points: x and v on Sigma, shape (periods, 2), from `state` on; a sample
    where chaotic. least_speed: of its impacts, inf if none. exponent: the largest Lyapunov exponent per drive period,
    nan if unknown. mirror_of: the place in the tuple of its mirror image, its own where it is symmetric; None where
    none was found or the scene has no mirror symmetry. note: what was seen.
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


def find_attractors(scene, starts=200, seed=0, settle=300):
    """What a scene settles on: a tuple of `Attractor`, the largest share first, unresolved starts last.

    scene: a single one. starts: how many, drawn from `seed` as `starts.box` says, the same ones each time; settle:
    drive periods before recurrence is looked for. Periodic is what recurs after at most 32 periods and draws nearby
    trajectories in; chaotic is what does not recur and has an exponent that is positive beyond doubt; all else is
    unresolved.

    Raises SceneError for a batch of scenes and for counts that cannot be.
    """
    if scene.shape:
        raise check.SceneError("scene", "must be a single scene, not a batch", f"shape {scene.shape}")
    starts, settle = check.whole("starts", starts, 1), check.whole("settle", settle, 0)
    given = random_starts(scene, starts, check.whole("seed", seed, 0))
    left, right, _ = box(scene)
    found, periods, scale = settle_lanes(scene, given, settle, max(abs(left), abs(right)))
    orbits, lost = _periodic(scene, found, periods, settle, scale)
    sets, restless = _chaotic(scene, found, np.flatnonzero((periods == 0) & (found.status < CAP)), scale)
    bad = {int(lane): f"status {STATUS[found.status[lane]]}" for lane in np.flatnonzero(found.status >= CAP)}
    seen = sorted(orbits + sets, key=lambda one: (-len(one.lanes), one.label, *one.points[0]))
    rest = _unresolved(given, lost | restless | bad, starts)
    return _paired(seen, is_symmetric(scene), starts) + rest


@dataclass(frozen=True, eq=False)
class _Seen:
    """An attractor before its share and its mirror image are known: its lanes, its impacts as points, its numbers."""

    lanes: list[int]
    meetings: np.ndarray
    numbers: dict

    @property
    def label(self):
        return self.numbers["label"]

    @property
    def points(self):
        return self.numbers["points"]


def dissipates(scene):
    """Whether motions of a single scene draw together at all: it is damped, or a wall is not elastic."""
    return bool(scene.damping > 0) or any(
        scene.parameter(name) < 1 for name in scene.names if "." in name and name.endswith("restitution")
    )


def near_of(scene, scale):
    """The distance on Sigma from which on two orbits are told apart."""
    return float(np.finfo(scene.dtype).eps) ** 0.4 * scale


def _chosen(state, lanes):
    return jax.tree.map(lambda leaf: leaf[lanes], state)


def _periodic(scene, found, periods, settle, scale):
    """(the periodic attractors, why other lanes that recur are on none): a list of `_Seen`, and {lane: reason}."""
    near, lost, seen = near_of(scene, scale), {}, []
    known = clusters(found, periods, near)
    if not known:
        return seen, lost
    starts = _chosen(found.state, [one.lanes[0] for one in known])
    rates, _ = exponents(scene, starts, scale)
    run = trail(scene, starts, POLISH * max(settle, KEEP))
    neutral = 4.0 * float(np.finfo(scene.dtype).eps) ** 0.5
    for k, (one, rate) in enumerate(zip(known, rates, strict=True)):
        last, n = run.lanes([k]), len(one.points)
        if last.status[0] == FULL:
            last = trail(scene, last.state, KEEP, WIDE)
        apart = abs(last.points[-n:] - last.points[-2 * n : -n]).max()
        if rate < -neutral and apart <= near:
            seen.append(_orbit(scene, last, one.lanes, n, float(rate), float(apart), scale))
        else:
            lost |= dict.fromkeys(one.lanes, "recurs but does not attract")
    return seen, lost


def _orbit(scene, last, lanes, n, rate, apart, scale):
    """What is known of a periodic attractor from a trail of one lane on it, read from its least rotation on."""
    points, words = orbit_of(last, 0, n)
    after = words[1:] + words[:1]
    turn = min(range(n), key=lambda k: (after[k:] + after[:k], *points[k]))
    at = len(last.x) - n + turn
    impacts = [part[-n:, 0] for part in (last.time, last.side, last.speed)]
    numbers = {
        "label": itinerary.label(words),
        "kind": "periodic",
        "state": State(*(float(part[at, 0]) for part in (last.x, last.v)), 0.0, float(last.contact[at, 0])),
        "periods": n,
        "itinerary": after[turn:] + after[:turn],
        "points": np.roll(points, -turn, axis=0),
        "least_speed": float(np.min(impacts[2], where=impacts[1] != 0, initial=np.inf)),
        "exponent": rate,
        "note": f"recurs to within {apart:.0e}; exponent {rate:.3g} per period",
    }
    return _Seen(lanes, meetings(float(scene.frequency), *impacts, scale), numbers)


def _chaotic(scene, found, lanes, scale):
    """(the chaotic attractors, why the other lanes are on none), of lanes that do not recur."""
    seen, lost = [], {}
    if not lanes.size:
        return seen, lost
    rates, errors = exponents(scene, _chosen(found.state, lanes), scale)
    wild = rates - 3.0 * errors > LEAST_EXPONENT
    for lane, rate in zip(lanes[~wild].tolist(), rates[~wild], strict=True):
        lost[lane] = (
            "does not recur, and its exponent is not positive beyond doubt" if np.isfinite(rate) else "bad status"
        )
    if not dissipates(scene):
        return seen, lost | dict.fromkeys(lanes[wild].tolist(), "chaotic, in a scene that loses no energy")
    if not wild.any():
        return seen, lost
    roams, status = _roam(scene, _chosen(found.state, lanes[wild]))
    for k, lane in enumerate(lanes[wild].tolist()):
        one = roams.lanes([k])
        if status[k] >= CAP:
            lost[lane] = f"status {STATUS[status[k]]}"
            continue
        hits = meetings(float(scene.frequency), one.time, one.side, one.speed, scale)
        home = next((other for other in seen if is_same_set(hits, other.meetings)), None)
        if home is None:
            home = _wild(one, hits, float(rates[wild][k]), float(errors[wild][k]))
            seen.append(home)
        home.lanes.append(lane)
    return seen, lost


def _roam(scene, state):
    """(a trail of SAMPLES times KEEP periods, the worst status of each lane)."""
    parts = []
    for _ in range(SAMPLES):
        parts.append(trail(scene, state, KEEP))
        state = parts[-1].state
    status = np.max([part.status for part in parts], axis=0)
    return Trail(state, status, *map(np.concatenate, zip(*(part[2:] for part in parts), strict=True))), status


def _wild(one, hits, rate, error):
    numbers = {
        "label": "chaotic",
        "kind": "chaotic",
        "state": State(*(float(part[-1, 0]) for part in (one.x, one.v)), 0.0, float(one.contact[-1, 0])),
        "periods": 0,
        "itinerary": (),
        "points": one.points[:, 0],
        "least_speed": float(np.min(one.speed, where=one.side != 0, initial=np.inf)),
        "exponent": rate,
        "note": f"no recurrence; exponent {rate:.3g} +- {error:.1g} per period",
    }
    return _Seen([], hits, numbers)


def _paired(seen, symmetric, starts):
    """The attractors with their shares, and their mirror images where the scene is symmetric."""

    def image(one):
        test = is_same_orbit if one.numbers["periods"] else is_same_set
        found = (
            place
            for place, other in enumerate(seen)
            if one.numbers["periods"] == other.numbers["periods"] and test(mirrored(one.meetings), other.meetings)
        )
        return next(found, None) if symmetric else None

    return tuple(Attractor(**one.numbers, share=len(one.lanes) / starts, mirror_of=image(one)) for one in seen)


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
        state=State(*(float(leaf[first]) for leaf in (given.x, given.v)), 0.0, 0.0),
        periods=0,
        itinerary=(),
        points=np.empty((0, 2)),
        least_speed=np.nan,
        exponent=np.nan,
        mirror_of=None,
        note="; ".join(f"{number} starts: {reason}" for reason, number in counts),
    )
    return (entry,)
