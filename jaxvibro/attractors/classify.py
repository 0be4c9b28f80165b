"""Classify motions as attractors: orbits that recur and attract, or chaotic motion."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from continuation.limits import EXPIRED_REASON, UNLIMITED

from ..maps import itinerary
from ..maps.iterate import MAX_RECORDED_PERIODS, Iterates, iterate
from ..maps.sticking_phases import NO_STICKING, find_sticking_phases, may_stick
from ..orbits.orbit_comparison import impacts_as_points, is_same_set
from ..scene.codes import Status
from ..scene.state import State
from ..scene.typical_scales import force_rates
from .largest_exponent import largest_exponents
from .transients import cluster_orbits, extract_orbit
from .weak_chaos import assess_weak_chaos

POLISH_FACTOR = 4  # times `settle` periods, simulated before a periodic orbit is read
MAX_SLOTS = 1000  # slots for orbits with more impacts in a period than `iterate` records: the impact cap
MIN_CHAOS_EXPONENT = (
    0.01  # per period: a mere shear appears as 0.002 over the periods that `largest_exponents` averages
)
MAX_LONG_ESTIMATES = 4  # largest number of sets that `assess_weak_chaos` examines
SAMPLE_ROUNDS = 8  # times `MAX_RECORDED_PERIODS` of a sample of chaos


@dataclass(frozen=True, eq=False)
class AttractorCandidate:
    """Attractor before its share and its mirror image are known.

    Parameters
    ----------
    lanes : list of int
        Lanes on the attractor.
    impact_points : ndarray
        Impacts as points (see `orbit_comparison`). Array of shape (impacts, 4).
    fields : dict
        Fields of `Attractor`, with the note without the exponent.
    """

    lanes: list[int]
    impact_points: Float[np.ndarray, "impacts 4"]
    fields: dict[str, Any]


def find_periodic(scene, iterates, periods, settle, scale):
    """Return (periodic attractors, {lane: reason} of other recurrent lanes).

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : Iterates
        Iterates of the lanes.
    periods : ndarray
        Periods after which lanes recur; 0 if they do not. Array of shape (lanes,).
    settle : int
        Drive periods of the transient.
    scale : float
        Largest magnitude of x and v.

    Returns
    -------
    candidates : list of AttractorCandidate
        Periodic attractors.
    failures : dict of int to str
        Reason why a recurrent lane is on no attractor.
    """
    eps, failures, candidates = float(np.finfo(scene.dtype).eps), {}, []
    tolerance, neutral_growth = eps**0.4 * scale, 4.0 * eps**0.5
    orbit_clusters = cluster_orbits(iterates, periods, tolerance)
    if not orbit_clusters:
        return candidates, failures
    start_states = _select_lanes(iterates.state, [cluster.lanes[0] for cluster in orbit_clusters])
    growth_rates, _ = largest_exponents(scene, start_states, scale)
    long_iterates = iterate(scene, start_states, POLISH_FACTOR * max(settle, MAX_RECORDED_PERIODS), max_single_lanes=0)
    for index, (cluster, growth_rate) in enumerate(zip(orbit_clusters, growth_rates.tolist(), strict=True)):
        lane_iterates, n_periods = complete_iterates(scene, long_iterates.select_lanes([index])), len(cluster.points)
        return_distance = float(
            abs(lane_iterates.points[-n_periods:] - lane_iterates.points[-2 * n_periods : -n_periods]).max()
        )
        if growth_rate < -neutral_growth and return_distance <= tolerance:
            extra_fields = {"exponent": growth_rate, "note": f"recurs to within {return_distance:.0e}"}
            candidates.append(periodic_candidate(scene, lane_iterates, cluster.lanes, n_periods, scale, extra_fields))
        else:
            failures |= dict.fromkeys(cluster.lanes, "recurs but does not attract")
    return candidates, failures


def _select_lanes(state, lanes):
    return jax.tree.map(lambda leaf: leaf[lanes], state)


def record_iterates(scene, state):
    """Return the iterates of one lane over `MAX_RECORDED_PERIODS` periods with all impacts."""
    return complete_iterates(scene, iterate(scene, state, MAX_RECORDED_PERIODS, max_single_lanes=0))


def complete_iterates(scene, iterates):
    """Return the iterates of one lane; if its slots are full, continue it with slots for all impacts."""
    return (
        iterate(scene, iterates.state, MAX_RECORDED_PERIODS, MAX_SLOTS)
        if iterates.status[0] == Status.FULL
        else iterates
    )


def periodic_candidate(scene, iterates, lanes, n_periods, scale, extra_fields):
    """Return a periodic attractor from the iterates of one lane on it, read from its `canonical_start`."""
    points, itinerary_words = extract_orbit(iterates, 0, n_periods)
    rotated_words = itinerary_words[1:] + itinerary_words[:1]
    rotation = itinerary.canonical_start(rotated_words, points)
    impacts = [record[-n_periods:, 0] for record in (iterates.time, iterates.side, iterates.speed)]
    state = _state_at(iterates, rotation - n_periods)
    can_stick = may_stick(scene, iterates.status, iterates.contact[-n_periods:])
    sticking = find_sticking_phases(scene, state, n_periods) if can_stick else NO_STICKING
    fields = {
        "label": itinerary.label(itinerary_words, sticking.chatter_walls),
        "kind": "periodic",
        "rests": sticking.has_sticking,
        "state": state,
        "periods": n_periods,
        "itinerary": itinerary.rotate(rotated_words, rotation),
        "points": np.roll(points, -rotation, axis=0),
        "least_speed": _least_speed(*impacts[1:]),
    }
    return AttractorCandidate(lanes, impacts_as_points(float(scene.frequency), *impacts, scale), fields | extra_fields)


def _state_at(iterates, period):
    """Return the state at the end of a recorded period of one lane."""
    x, v, contact = (float(record[period, 0]) for record in (iterates.x, iterates.v, iterates.contact))
    return State(x, v, 0.0, contact)


def _least_speed(side, speed):
    """Return the smallest impact speed, inf without impacts."""
    return float(np.min(speed, where=side != 0, initial=np.inf))


def is_dissipative(scene):
    """Return True if the motions of a single scene contract: it is damped, or a wall is inelastic.

    A user-defined force counts as damped if it depends on the velocity.
    """
    if scene.force is not None:
        return force_rates(scene)[1] > 0 or any(bool(abs(scene.bounce(side)) < 1) for side in scene.walls)
    is_damped = any(bool(scene.parameter(name) > 0) for name in scene.names if name.endswith("damping"))
    return is_damped or any(bool(abs(scene.bounce(side)) < 1) for side in scene.walls)  # `bounce` is -1 for a soft wall


def find_chaotic(scene, iterates, lanes, scale, limits=UNLIMITED):
    """Find the chaotic attractors among lanes that do not recur.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : Iterates
        Iterates of the lanes.
    lanes : ndarray
        Indices of the lanes that do not recur.
    scale : float
        Largest magnitude of x and v.
    limits : Limits, optional
        Time limit, after which no further lane is examined.

    Returns
    -------
    candidates : list of AttractorCandidate
        Chaotic attractors.
    failures : dict of int to str
        Reason why a lane is on no attractor.
    """
    candidates, failures = [], {}
    if not lanes.size or limits.expired:
        return candidates, dict.fromkeys(lanes.tolist(), EXPIRED_REASON)
    growth_rates, errors = largest_exponents(scene, _select_lanes(iterates.state, lanes), scale)
    with np.errstate(invalid="ignore"):
        is_certain = growth_rates - 3.0 * errors > MIN_CHAOS_EXPONENT
    if not is_dissipative(scene):
        failures |= dict.fromkeys(lanes[~is_certain].tolist(), "does not recur")
        return candidates, failures | dict.fromkeys(
            lanes[is_certain].tolist(), "chaotic, but the scene loses no energy"
        )
    order = np.argsort(~is_certain, kind="stable")
    lanes, growth_rates, is_certain = lanes[order], growth_rates[order], is_certain[order]
    return candidates, failures | _group_chaotic_lanes(
        scene, _select_lanes(iterates.state, lanes), lanes, growth_rates, is_certain, scale, candidates, limits
    )


def _group_chaotic_lanes(scene, state, lanes, growth_rates, is_certain, scale, candidates, limits):
    """Group chaotic lanes that fill the same set into `candidates`; return {lane: reason} of the others.

    is_certain: lanes whose exponents (growth_rates) are positive beyond doubt. Of each set of other lanes one is
    examined, and also of lanes that may stick, since nearby trajectories that stick at different times separate without
    chaos.
    """
    iterates, failures, verdicts = sample_motion(scene, state), {}, []
    for index, lane in enumerate(lanes.tolist()):
        if limits.expired:
            failures[lane] = EXPIRED_REASON
            continue
        motion = iterates.select_lanes([index])
        if motion.status[0] >= Status.CAP:
            failures[lane] = f"status {Status(motion.status[0]).word}"
            continue
        candidate = chaotic_candidate(scene, motion, scale, {})
        match = next((known for known in candidates if is_same_set(candidate.impact_points, known.impact_points)), None)
        if match is None:
            accepted = bool(is_certain[index]) and not may_stick(scene, motion.status, motion.contact)
            reason = (
                None
                if accepted
                else _rejection_reason(scene, motion.state, candidate, verdicts, bool(is_certain[index]))
            )
            if reason is not None:
                failures[lane] = reason
                continue
            match = candidate
            candidates.append(match)
        match.lanes.append(lane)
    for motion in candidates:
        if "note" not in motion.fields:
            lane_rates = growth_rates[np.isin(lanes, motion.lanes)]
            motion.fields.update(exponent=float(lane_rates[np.isfinite(lane_rates)].mean()), note="does not recur")
    return failures


def _rejection_reason(scene, state, candidate, verdicts, is_certain):
    """Return the reason why the motion of one lane is not chaotic, or None if it is.

    A chaotic motion then has its exponent among its fields. is_certain: True if it is chaotic where the estimator
    cannot decide; verdicts: (impact points, reason) of motions examined before, to which this one is added.
    """
    earlier_reason = next(
        (reason for points, reason in verdicts if reason is not None and is_same_set(candidate.impact_points, points)),
        None,
    )
    if earlier_reason is not None:
        return earlier_reason
    if len(verdicts) == MAX_LONG_ESTIMATES:
        return None if is_certain else "does not recur, and was not examined for long"
    growth_rate, note = assess_weak_chaos(scene, state)
    if np.isfinite(growth_rate):
        candidate.fields.update(exponent=growth_rate, note=note)
    verdicts.append(
        (candidate.impact_points, None if np.isfinite(growth_rate) or (np.isnan(growth_rate) and is_certain) else note)
    )
    return verdicts[-1][1]


def sample_motion(scene, state):
    """Sample motions over `SAMPLE_ROUNDS` times `MAX_RECORDED_PERIODS` periods.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    state : State
        States. Leaves of shape (lanes,).

    Returns
    -------
    Iterates
        Iterates with the worst status of all rounds.
    """
    segments = []
    for _ in range(SAMPLE_ROUNDS):
        segments.append(iterate(scene, state, MAX_RECORDED_PERIODS, max_single_lanes=0))
        state = segments[-1].state
    worst_status = np.max([segment.status for segment in segments], axis=0)
    return Iterates(state, worst_status, *map(np.concatenate, zip(*(segment[2:] for segment in segments), strict=True)))


def chaotic_candidate(scene, iterates, scale, extra_fields):
    """Make the candidate of a chaotic attractor from the iterates of one lane on it.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : Iterates
        Iterates of one lane.
    scale : float
        Largest magnitude of x and v.
    extra_fields : dict
        Further fields of the candidate.

    Returns
    -------
    AttractorCandidate
        Candidate without lanes.
    """
    fields = {
        "label": "chaotic",
        "kind": "chaotic",
        "state": _state_at(iterates, -1),
        "periods": 0,
        "itinerary": (),
        "points": iterates.points[:, 0],
        "least_speed": _least_speed(iterates.side, iterates.speed),
    }
    return AttractorCandidate(
        [],
        impacts_as_points(float(scene.frequency), iterates.time, iterates.side, iterates.speed, scale),
        fields | extra_fields,
    )
