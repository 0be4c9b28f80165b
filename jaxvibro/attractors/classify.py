"""Evidence for an attractor: an orbit that recurs and draws in, or motion that does neither recur nor stay together."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED, UNLIMITED

from ..maps import itinerary
from ..maps.iterate import KEEP, Trail, iterate
from ..maps.rests import NO_RESTS, may_rest, rests
from ..orbits.orbit_comparison import is_same_set, meetings
from ..scene.codes import Status
from ..scene.scale import force_rates
from ..scene.state import State
from .largest_exponent import exponents
from .transients import clusters, orbit_of
from .weak_chaos import weigh

POLISH = 4  # times `settle` periods that a periodic orbit is run on before it is read
WIDE = 1000  # slots for an orbit with more impacts in a period than `iterate` records: as many as the impact cap
LEAST_EXPONENT = 0.01  # per period, of chaos: mere shear passes for 0.002 over the periods that `exponents` averages
WEIGHED = 4  # sets of motion at most that the spectrum's estimator is asked about
SAMPLES = 8  # times KEEP periods of chaos that are looked at


@dataclass(frozen=True, eq=False)
class Evidence:
    """An attractor before its share and its mirror image are known.

    lanes: those that are on it; hits: its impacts as points (`orbit_comparison`); numbers: the fields of `Attractor`,
    the note without the exponent.
    """

    lanes: list[int]
    hits: Float[np.ndarray, "impacts 4"]
    numbers: dict[str, Any]


def periodic(scene, found, periods, settle, scale):
    """(periodic attractors, why other lanes that recur are on none): a list of `Evidence`, and {lane: reason}.

    found: a `Trail`; periods: those after which its lanes recur, 0 for none; scale: of x and v, the largest.
    """
    eps, lost, seen = float(np.finfo(scene.dtype).eps), {}, []
    near, neutral = eps**0.4 * scale, 4.0 * eps**0.5
    known = clusters(found, periods, near)
    if not known:
        return seen, lost
    starts = _chosen(found.state, [one.lanes[0] for one in known])
    rates, _ = exponents(scene, starts, scale)
    run = iterate(scene, starts, POLISH * max(settle, KEEP), few=0)
    for k, (one, rate) in enumerate(zip(known, rates.tolist(), strict=True)):
        last, n = whole(scene, run.lanes([k])), len(one.points)
        apart = float(abs(last.points[-n:] - last.points[-2 * n : -n]).max())
        if rate < -neutral and apart <= near:
            told = {"exponent": rate, "note": f"recurs to within {apart:.0e}"}
            seen.append(read_orbit(scene, last, one.lanes, n, scale, told))
        else:
            lost |= dict.fromkeys(one.lanes, "recurs but does not attract")
    return seen, lost


def _chosen(state, lanes):
    return jax.tree.map(lambda leaf: leaf[lanes], state)


def watch(scene, state):
    """The trail of the state of one lane over KEEP periods, with all of its impacts."""
    return whole(scene, iterate(scene, state, KEEP, few=0))


def whole(scene, last):
    """The trail of one lane, or, where its slots are full, one that goes on from there with all impacts."""
    return iterate(scene, last.state, KEEP, WIDE) if last.status[0] == Status.FULL else last


def read_orbit(scene, last, lanes, n, scale, told):
    """A periodic attractor from a trail of one lane on it, read from its least rotation on."""
    points, words = orbit_of(last, 0, n)
    after = words[1:] + words[:1]
    turn = itinerary.first(after, points)
    impacts = [part[-n:, 0] for part in (last.time, last.side, last.speed)]
    state = _state(last, turn - n)
    may = may_rest(scene, last.status, last.contact[-n:])
    resting = rests(scene, state, n) if may else NO_RESTS
    numbers = {
        "label": itinerary.label(words, resting.endless),
        "kind": "periodic",
        "rests": resting.rests,
        "state": state,
        "periods": n,
        "itinerary": itinerary.turned(after, turn),
        "points": np.roll(points, -turn, axis=0),
        "least_speed": _least_speed(*impacts[1:]),
    }
    return Evidence(lanes, meetings(float(scene.frequency), *impacts, scale), numbers | told)


def _state(one, period):
    """The state at the end of a kept period of a trail of one lane."""
    x, v, contact = (float(part[period, 0]) for part in (one.x, one.v, one.contact))
    return State(x, v, 0.0, contact)


def _least_speed(side, speed):
    return float(np.min(speed, where=side != 0, initial=np.inf))


def dissipates(scene):
    """Whether motions of a single scene draw together at all: it is damped, or a wall is not elastic. Of a force of the
    user's own it is taken for granted where the force depends on the speed."""
    if scene.force is not None:
        return force_rates(scene)[1] > 0 or any(bool(abs(scene.bounce(side)) < 1) for side in scene.walls)
    damped = any(bool(scene.parameter(name) > 0) for name in scene.names if name.endswith("damping"))
    return damped or any(bool(abs(scene.bounce(side)) < 1) for side in scene.walls)  # -1: a soft one


def chaotic(scene, found, lanes, scale, limits=UNLIMITED):
    """(chaotic attractors, why other lanes are on none), of the lanes that do not recur; as `periodic`. limits: no
    further lane is looked at once their time is over."""
    seen, lost = [], {}
    if not lanes.size or limits.expired:
        return seen, dict.fromkeys(lanes.tolist(), EXPIRED)
    rates, errors = exponents(scene, _chosen(found.state, lanes), scale)
    with np.errstate(invalid="ignore"):
        wild = rates - 3.0 * errors > LEAST_EXPONENT
    if not dissipates(scene):
        lost |= dict.fromkeys(lanes[~wild].tolist(), "does not recur")
        return seen, lost | dict.fromkeys(lanes[wild].tolist(), "chaotic, but the scene loses no energy")
    order = np.argsort(~wild, kind="stable")
    lanes, rates, wild = lanes[order], rates[order], wild[order]
    return seen, lost | _grouped(scene, _chosen(found.state, lanes), lanes, rates, wild, scale, seen, limits)


def _grouped(scene, state, lanes, rates, wild, scale, seen, limits):
    """Puts chaotic lanes that fill the same set together, into `seen`; {lane: reason} of those that are on none.

    wild: the lanes whose exponents, the rates, are positive beyond doubt. Of each set of others one lane is weighed,
    and of those that may rest, as nearby trajectories that rest at other times part without chaos.
    """
    roams, lost, weighed = roam(scene, state), {}, []
    for k, lane in enumerate(lanes.tolist()):
        if limits.expired:
            lost[lane] = EXPIRED
            continue
        one = roams.lanes([k])
        if one.status[0] >= Status.CAP:
            lost[lane] = f"status {Status(one.status[0]).word}"
            continue
        this = read_set(scene, one, scale, {})
        home = next((other for other in seen if is_same_set(this.hits, other.hits)), None)
        if home is None:
            sure = bool(wild[k]) and not may_rest(scene, one.status, one.contact)
            why = None if sure else _refused(scene, one.state, this, weighed, bool(wild[k]))
            if why is not None:
                lost[lane] = why
                continue
            home = this
            seen.append(home)
        home.lanes.append(lane)
    for one in seen:
        if "note" not in one.numbers:
            own = rates[np.isin(lanes, one.lanes)]
            one.numbers.update(exponent=float(own[np.isfinite(own)].mean()), note="does not recur")
    return lost


def _refused(scene, state, this, weighed, wild):
    """Why the motion of one lane is not taken for chaos; None where it is: its exponent is then among its numbers.

    wild: whether it is for chaos where the estimator cannot tell; weighed: (hits, why not) of those that were weighed
    before, to which it is added.
    """
    known = next((why for hits, why in weighed if why is not None and is_same_set(this.hits, hits)), None)
    if known is not None:
        return known
    if len(weighed) == WEIGHED:
        return None if wild else "does not recur, and was not looked at for long"
    rate, told = weigh(scene, state)
    if np.isfinite(rate):
        this.numbers.update(exponent=rate, note=told)
    weighed.append((this.hits, None if np.isfinite(rate) or (np.isnan(rate) and wild) else told))
    return weighed[-1][1]


def roam(scene, state):
    """A trail of SAMPLES times KEEP periods."""
    parts = []
    for _ in range(SAMPLES):
        parts.append(iterate(scene, state, KEEP, few=0))
        state = parts[-1].state
    worst = np.max([part.status for part in parts], axis=0)
    return Trail(state, worst, *map(np.concatenate, zip(*(part[2:] for part in parts), strict=True)))


def read_set(scene, one, scale, told):
    """A chaotic attractor, of no lanes yet, from a trail of one lane on it."""
    numbers = {
        "label": "chaotic",
        "kind": "chaotic",
        "state": _state(one, -1),
        "periods": 0,
        "itinerary": (),
        "points": one.points[:, 0],
        "least_speed": _least_speed(one.side, one.speed),
    }
    return Evidence([], meetings(float(scene.frequency), one.time, one.side, one.speed, scale), numbers | told)
