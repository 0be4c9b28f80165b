"""Classify motions as attractors, and derive attractors without initial states."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from continuation.branch_segment import EXPIRED_REASON, UNLIMITED

from ..contact.kinds import flow_of_scene
from ..maps import itinerary
from ..maps.iterate import MAX_RECORDED_PERIODS, IteratedStates, iterate, take_lanes
from ..maps.sections import shift_phase
from ..maps.sticking_phase_intervals import NO_STICKING, find_sticking_phases, may_stick
from ..orbits.orbit import impacts_as_points, is_same_orbit, mirror_points, samples_fill_same_set
from ..orbits.shooting import free_orbit
from ..scene.scene_properties import is_symmetric
from ..scene.state import State, Status
from .tangent_growth import largest_exponents
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
        Impacts as points (see `orbit`). Array of shape (impacts, 4).
    attractor_fields : dict
        Fields of `Attractor` that are known. The note does not state the exponent yet.
    """

    lanes: list[int]
    impact_points: Float[np.ndarray, "impacts 4"]
    attractor_fields: dict[str, Any]


def find_periodic_attractors(scene, iterates, recurrence_periods, settle, max_state_magnitude):
    """Find the periodic attractors among lanes that recur.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : IteratedStates
        Iterates of the lanes.
    recurrence_periods : ndarray
        Periods after which lanes recur; 0 if they do not. Array of shape (lanes,).
    settle : int
        Drive periods of the transient.
    max_state_magnitude : float
        Largest magnitude of x and v.

    Returns
    -------
    candidates : list of AttractorCandidate
        Periodic attractors.
    failures : dict of int to str
        Reason why a recurrent lane is on no attractor.
    """
    machine_eps, failure_reasons, candidates = float(np.finfo(scene.dtype).eps), {}, []
    tolerance, neutral_growth_rate = machine_eps**0.4 * max_state_magnitude, 4.0 * machine_eps**0.5
    orbit_clusters = cluster_orbits(iterates, recurrence_periods, tolerance)
    if not orbit_clusters:
        return candidates, failure_reasons
    cluster_states = take_lanes(iterates.state, [cluster.lanes[0] for cluster in orbit_clusters])
    growth_rates, _ = largest_exponents(scene, cluster_states, max_state_magnitude)
    long_iterates = iterate(
        scene, cluster_states, POLISH_FACTOR * max(settle, MAX_RECORDED_PERIODS), max_single_lanes=0
    )
    for cluster_index, (cluster, growth_rate) in enumerate(zip(orbit_clusters, growth_rates.tolist(), strict=True)):
        cluster_iterates, n_periods = (
            iterate_if_slots_full(scene, long_iterates.select_lanes([cluster_index])),
            len(cluster.points),
        )
        return_distance = float(
            abs(cluster_iterates.points[-n_periods:] - cluster_iterates.points[-2 * n_periods : -n_periods]).max()
        )
        if growth_rate < -neutral_growth_rate and return_distance <= tolerance:
            extra_fields = {"exponent": growth_rate, "note": f"recurs to within {return_distance:.0e}"}
            candidates.append(
                make_periodic_attractor(
                    scene, cluster_iterates, cluster.lanes, n_periods, max_state_magnitude, extra_fields
                )
            )
        else:
            failure_reasons |= dict.fromkeys(cluster.lanes, "recurs but does not attract")
    return candidates, failure_reasons


def iterate_with_all_impacts(scene, state):
    """Return the iterates of one lane over `MAX_RECORDED_PERIODS` periods with all impacts."""
    return iterate_if_slots_full(scene, iterate(scene, state, MAX_RECORDED_PERIODS, max_single_lanes=0))


def iterate_if_slots_full(scene, iterates):
    """Return iterates of one lane that record all impacts.

    If the slots of `iterates` are full, the lane is simulated further with more slots.
    """
    return (
        iterate(scene, iterates.state, MAX_RECORDED_PERIODS, MAX_SLOTS)
        if iterates.status[0] == Status.FULL
        else iterates
    )


def make_periodic_attractor(scene, iterates, lanes, n_periods, max_state_magnitude, extra_fields):
    """Make the candidate of a periodic attractor from the iterates of one lane on the attractor.

    The orbit starts at its `canonical_start_period`.
    """
    points, itinerary_words = extract_orbit(iterates, 0, n_periods)
    once_shifted_words = itinerary_words[1:] + itinerary_words[:1]
    canonical_shift = itinerary.canonical_start_period(once_shifted_words, points)
    impacts = [impact_array[-n_periods:, 0] for impact_array in (iterates.time, iterates.side, iterates.speed)]
    state = _state_at(iterates, canonical_shift - n_periods)
    can_stick = may_stick(scene, iterates.status, iterates.contact[-n_periods:])
    sticking_phases = find_sticking_phases(scene, state, n_periods) if can_stick else NO_STICKING
    attractor_fields = {
        "label": itinerary.format_label(itinerary_words, sticking_phases.chatter_walls),
        "kind": "periodic",
        "rests": sticking_phases.has_sticking,
        "state": state,
        "periods": n_periods,
        "itinerary": itinerary.rotate_periods(once_shifted_words, canonical_shift),
        "points": np.roll(points, -canonical_shift, axis=0),
        "least_speed": _least_impact_speed(*impacts[1:]),
    }
    return AttractorCandidate(
        lanes, impacts_as_points(float(scene.frequency), *impacts, max_state_magnitude), attractor_fields | extra_fields
    )


def _state_at(iterates, period_index):
    """Return the state at the end of a recorded period of one lane."""
    x, v, contact = (float(state_array[period_index, 0]) for state_array in (iterates.x, iterates.v, iterates.contact))
    return State(x, v, 0.0, contact)


def _least_impact_speed(side, speed):
    """Return the smallest impact speed, inf without impacts."""
    return float(np.min(speed, where=side != 0, initial=np.inf))


def is_dissipative(scene):
    """Return True if a single scene loses energy: the scene is damped, or a wall is inelastic.

    A user-defined force counts as damped if its derivative with respect to the velocity is not 0 at one of the states
    at which `frequency_and_damping` evaluates it. Under such a force the damping of soft walls is not examined.
    """
    return flow_of_scene(scene).loses_energy(scene) or any(
        bool(abs(scene.bounce(side)) < 1) for side in scene.walls
    )  # `bounce` is -1 for a soft wall


def find_chaotic_attractors(scene, iterates, lanes, max_state_magnitude, computation_limits=UNLIMITED):
    """Find the chaotic attractors among lanes that do not recur.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : IteratedStates
        Iterates of the lanes.
    lanes : ndarray
        Indices of the lanes that do not recur.
    max_state_magnitude : float
        Largest magnitude of x and v.
    computation_limits : Limits, optional
        Time limit, after which no further lane is examined.

    Returns
    -------
    candidates : list of AttractorCandidate
        Chaotic attractors.
    failures : dict of int to str
        Reason why a lane is on no attractor.
    """
    candidates, failure_reasons = [], {}
    if not lanes.size or computation_limits.expired:
        return candidates, dict.fromkeys(lanes.tolist(), EXPIRED_REASON)
    growth_rates, errors = largest_exponents(scene, take_lanes(iterates.state, lanes), max_state_magnitude)
    with np.errstate(invalid="ignore"):
        is_certainly_chaotic = growth_rates - 3.0 * errors > MIN_CHAOS_EXPONENT
    if not is_dissipative(scene):
        failure_reasons |= dict.fromkeys(lanes[~is_certainly_chaotic].tolist(), "does not recur")
        return candidates, failure_reasons | dict.fromkeys(
            lanes[is_certainly_chaotic].tolist(), "chaotic, but the scene loses no energy"
        )
    lane_order = np.argsort(~is_certainly_chaotic, kind="stable")
    lanes, growth_rates, is_certainly_chaotic = (
        lanes[lane_order],
        growth_rates[lane_order],
        is_certainly_chaotic[lane_order],
    )
    return candidates, failure_reasons | _group_chaotic_lanes(
        scene,
        take_lanes(iterates.state, lanes),
        lanes,
        growth_rates,
        is_certainly_chaotic,
        max_state_magnitude,
        candidates,
        computation_limits,
    )


def _group_chaotic_lanes(
    scene, state, lanes, growth_rates, is_certainly_chaotic, max_state_magnitude, candidates, computation_limits
):
    """Add the attractors of chaotic lanes to `candidates`; return {lane: reason} of the lanes on no attractor.

    Lanes that fill the same set are on one attractor. is_certainly_chaotic: True for lanes whose exponents
    (growth_rates) are positive beyond doubt. The other lanes are examined for a longer time, one lane for each set.
    Lanes that may stick are examined too, because nearby trajectories that stick at different times separate without
    chaos."""
    iterates, failure_reasons, examination_results = sample_motions(scene, state), {}, []
    for lane_index, lane in enumerate(lanes.tolist()):
        if computation_limits.expired:
            failure_reasons[lane] = EXPIRED_REASON
            continue
        motion = iterates.select_lanes([lane_index])
        if motion.status[0] >= Status.CAP:
            failure_reasons[lane] = f"status {Status(motion.status[0]).word}"
            continue
        candidate = make_chaotic_attractor(scene, motion, max_state_magnitude, {})
        matching_attractor = next(
            (
                known_attractor
                for known_attractor in candidates
                if samples_fill_same_set(candidate.impact_points, known_attractor.impact_points)
            ),
            None,
        )
        if matching_attractor is None:
            is_accepted = bool(is_certainly_chaotic[lane_index]) and not may_stick(scene, motion.status, motion.contact)
            rejection_reason = (
                None
                if is_accepted
                else _rejection_reason(
                    scene, motion.state, candidate, examination_results, bool(is_certainly_chaotic[lane_index])
                )
            )
            if rejection_reason is not None:
                failure_reasons[lane] = rejection_reason
                continue
            matching_attractor = candidate
            candidates.append(matching_attractor)
        matching_attractor.lanes.append(lane)
    for accepted_candidate in candidates:
        if "note" not in accepted_candidate.attractor_fields:
            attractor_growth_rates = growth_rates[np.isin(lanes, accepted_candidate.lanes)]
            accepted_candidate.attractor_fields.update(
                exponent=float(attractor_growth_rates[np.isfinite(attractor_growth_rates)].mean()),
                note="does not recur",
            )
    return failure_reasons


def _rejection_reason(scene, state, candidate, examination_results, is_certainly_chaotic):
    """Return the reason why the motion of one lane is not chaotic, or None if the motion is chaotic.

    The exponent of a chaotic motion is stored in the fields of the candidate. is_certainly_chaotic: True if the motion
    counts as chaotic where the estimator cannot decide. examination_results: list of (impact points, reason) of the
    examined motions; this motion is appended."""
    known_rejection_reason = next(
        (
            reason
            for examined_points, reason in examination_results
            if reason is not None and samples_fill_same_set(candidate.impact_points, examined_points)
        ),
        None,
    )
    if known_rejection_reason is not None:
        return known_rejection_reason
    if len(examination_results) == MAX_LONG_ESTIMATES:
        return None if is_certainly_chaotic else "does not recur, and was not examined for long"
    growth_rate, evidence_note = assess_weak_chaos(scene, state)
    if np.isfinite(growth_rate):
        candidate.attractor_fields.update(exponent=growth_rate, note=evidence_note)
    examination_results.append(
        (
            candidate.impact_points,
            None if np.isfinite(growth_rate) or (np.isnan(growth_rate) and is_certainly_chaotic) else evidence_note,
        )
    )
    return examination_results[-1][1]


def sample_motions(scene, state):
    """Sample motions over `SAMPLE_ROUNDS` times `MAX_RECORDED_PERIODS` periods.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    state : State
        States. Leaves of shape (lanes,).

    Returns
    -------
    IteratedStates
        Iterates with the worst status of all rounds.
    """
    round_iterates = []
    for _ in range(SAMPLE_ROUNDS):
        round_iterates.append(iterate(scene, state, MAX_RECORDED_PERIODS, max_single_lanes=0))
        state = round_iterates[-1].state
    worst_status = np.max([iterates_of_round.status for iterates_of_round in round_iterates], axis=0)
    return IteratedStates(
        state,
        worst_status,
        *map(np.concatenate, zip(*(iterates_of_round[2:] for iterates_of_round in round_iterates), strict=True)),
    )


def make_chaotic_attractor(scene, iterates, max_state_magnitude, extra_fields):
    """Make the candidate of a chaotic attractor from the iterates of one lane on the attractor.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    iterates : IteratedStates
        Iterates of one lane.
    max_state_magnitude : float
        Largest magnitude of x and v.
    extra_fields : dict
        Further fields of the candidate.

    Returns
    -------
    AttractorCandidate
        Candidate without lanes.
    """
    attractor_fields = {
        "label": "chaotic",
        "kind": "chaotic",
        "state": _state_at(iterates, -1),
        "periods": 0,
        "itinerary": (),
        "points": iterates.points[:, 0],
        "least_speed": _least_impact_speed(iterates.side, iterates.speed),
    }
    return AttractorCandidate(
        [],
        impacts_as_points(float(scene.frequency), iterates.time, iterates.side, iterates.speed, max_state_magnitude),
        attractor_fields | extra_fields,
    )


MIRROR_NOTE = "mirror image of another attractor; no start settled on it"


def derive_free_response(scene, candidates):
    """Return a list with the free response as `AttractorCandidate`, or an empty list.

    The list contains the free response if this orbit is stable, does not reach the walls and is not among the
    candidates.
    """
    if any(
        candidate.attractor_fields["periods"] == 1
        and not candidate.impact_points.size
        and not candidate.attractor_fields["state"].contact
        for candidate in candidates
    ):
        return []
    free_response_orbit = free_orbit(scene)
    if free_response_orbit is None or not free_response_orbit.stable:
        return []
    exponent = float(np.log(abs(free_response_orbit.multipliers[0])))
    attractor_fields = {
        "label": free_response_orbit.label,
        "kind": "periodic",
        "state": State(free_response_orbit.state.x, free_response_orbit.state.v, 0.0, 0.0),
        "periods": 1,
        "itinerary": free_response_orbit.itinerary,
        "points": np.array([[free_response_orbit.state.x, free_response_orbit.state.v]], scene.dtype),
        "least_speed": np.inf,
        "exponent": exponent,
        "note": "the free response, known in closed form; no start settled on it",
    }
    return [AttractorCandidate([], np.empty((0, 4), scene.dtype), attractor_fields)]


def derive_mirror_images(scene, candidates, max_state_magnitude):
    """Derive the mirror images that are missing among the candidates of a symmetric scene.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    candidates : list of AttractorCandidate
        Known attractors.
    max_state_magnitude : float
        Largest magnitude of x and v.

    Returns
    -------
    list of AttractorCandidate
        Missing mirror images; empty if the scene is not symmetric.
    """
    if not is_symmetric(scene):
        return []
    image_candidates = [
        _derive_mirror_image(scene, candidate, candidates, max_state_magnitude)
        for candidate in candidates
        if find_mirror_index(candidate, candidates) is None
    ]
    return [candidate for candidate in image_candidates if candidate is not None]


def find_mirror_index(candidate, candidates):
    """Return the index of an attractor's mirror image.

    Parameters
    ----------
    candidate : AttractorCandidate
        Attractor.
    candidates : list of AttractorCandidate
        Known attractors.

    Returns
    -------
    int or None
        Index of the image; None if it is not among the candidates.
    """
    return find_attractor_index(
        candidates, candidate.attractor_fields["periods"], mirror_points(candidate.impact_points)
    )


def find_attractor_index(candidates, n_periods, impact_points):
    """Return the index of the attractor with a motion.

    Parameters
    ----------
    candidates : list of AttractorCandidate
        Known attractors.
    n_periods : int
        Drive periods of the motion; 0 for a chaotic motion.
    impact_points : ndarray
        Impacts of the motion as points. Array of shape (impacts, 4).

    Returns
    -------
    int or None
        Index of the attractor; None if it is not among the candidates.
    """
    is_same_motion = is_same_orbit if n_periods else samples_fill_same_set
    return next(
        (
            index
            for index, candidate in enumerate(candidates)
            if candidate.attractor_fields["periods"] == n_periods
            and is_same_motion(impact_points, candidate.impact_points)
        ),
        None,
    )


def _derive_mirror_image(scene, candidate, candidates, max_state_magnitude):
    """Return the mirror image of an attractor; None if its simulation fails, or a chaotic image is known already."""
    attractor_fields, original_state = candidate.attractor_fields, candidate.attractor_fields["state"]
    mirror_state = State(-original_state.x, -original_state.v, np.pi, -original_state.contact)
    mirror_state = State(
        *(
            np.full(1, value, scene.dtype)
            for value in (mirror_state.x, mirror_state.v, mirror_state.phase, mirror_state.contact)
        )
    )
    state, status = shift_phase(scene, mirror_state, 0.0)
    if status[0] >= Status.CAP:
        return None
    extra_fields = {"exponent": attractor_fields["exponent"], "note": MIRROR_NOTE}
    if attractor_fields["periods"]:
        return make_periodic_attractor(
            scene,
            iterate_with_all_impacts(scene, state),
            [],
            attractor_fields["periods"],
            max_state_magnitude,
            extra_fields,
        )
    image_iterates = sample_motions(scene, state)
    image_candidate = make_chaotic_attractor(scene, image_iterates, max_state_magnitude, extra_fields)
    is_known_or_invalid = image_iterates.status[0] >= Status.CAP or any(
        samples_fill_same_set(image_candidate.impact_points, other_candidate.impact_points)
        for other_candidate in candidates
    )
    return None if is_known_or_invalid else image_candidate
