"""Solve for an `Orbit` from a guess of its impacts by Newton's method, or report why there is none.

The unknowns are times and speeds of the impacts, for walls hit in a given order. A solution of the equations is an
orbit only if no flight passes through a wall. In addition, certified motions from the middle of each flight must reach
the next two impacts at the expected walls and times.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import newton
from continuation.array_type import Array
from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..maps import itinerary as words
from ..maps.iterate import MAX_RECORDED_PERIODS, iterate
from ..scene.state import State
from . import flight_clearance, impact_equations
from .impact_equations import ImpactSequence
from .orbit import (
    OrbitError,
    eigenvalue_pair,
    impacts_as_points,
    make_orbit,
    repetition_count,
    rotate_to_canonical_start,
)

MIN_SECTION_GAP = 1e-3  # of a drive period: the section moves away from closer impacts
ADVICE_BRANCH_ENDED = "start nearer to another orbit; the branch of this one may have ended at a grazing"
N_GUESSES = 64  # random guesses if only the itinerary is known
IMPACT_TOLERANCE = 1e-8  # relative to 1 + the largest speed: closer impacts are the same
TIME_TOLERANCE = 1e-6  # of a drive period: tolerance of impact times in certified flights


class SequenceDiagnostics(NamedTuple):
    """Diagnostics of an impact sequence.

    Attributes
    ----------
    flights : Flights
        Flights of the sequence.
    section_states : tuple of Array
        (x, v) at the section over `MAX_RECORDED_PERIODS` periods.
    midflight_states : tuple of Array
        (x, v) halfway along each flight.
    closest_approaches : tuple of Array
        Clearance and time of the closest approach of each flight to each wall.
    trace, determinant : Array
        Trace and determinant of the monodromy matrix.
    """

    flights: impact_equations.Flights
    section_states: tuple[Float[Array, " periods"], Float[Array, " periods"]]
    midflight_states: tuple[Float[Array, " rows"], Float[Array, " rows"]]
    closest_approaches: tuple[Float[Array, "rows walls"], Float[Array, "rows walls"]]
    trace: Float[Array, ""]
    determinant: Float[Array, ""]


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def solve_guess(scene, guess):
    """Solve for an impact sequence; return (`ImpactSequence`, `SequenceDiagnostics`, `newton.NewtonSolution`)."""
    newton_result = call_as_kernel(impact_equations.solve_sequence, scene, guess)
    sequence = impact_equations.sort_sequence(scene, guess, newton_result.unknowns)
    return sequence, call_as_kernel(_diagnose_sequence, scene, sequence), newton_result


def _diagnose_sequence(scene, sequence):
    coeffs = flow_coefficients(scene)
    flights = impact_equations.compute_flights(coeffs, sequence)
    section_states = impact_equations.states_at(
        coeffs, sequence, flights, coeffs.period * jnp.arange(MAX_RECORDED_PERIODS, dtype=sequence.times.dtype)
    )
    closest_approaches = flight_clearance.turning_clearances(
        coeffs, flights, flight_clearance.sample_count(coeffs, flights)
    )
    midflight_states = flight_clearance.state_in_flight(coeffs, flights, 0.5 * flights.time)[:2]
    return SequenceDiagnostics(
        flights,
        section_states,
        midflight_states,
        closest_approaches,
        *impact_equations.monodromy_invariants(coeffs, flights, sequence.sides),
    )


def padded_sequence(scene, times, speeds, sides, phase, periods):
    """Return an `ImpactSequence` padded to 2, 8, 32, ... rows, so that few shapes are compiled."""
    rows = 2
    while rows < len(times):
        rows *= 4
    n_padding = rows - len(times)
    rows = (np.pad(np.asarray(column, scene.dtype), (0, n_padding)) for column in (times, speeds, sides))
    return ImpactSequence(*rows, *(np.asarray(column, scene.dtype) for column in (phase, periods)))


def orbit_from_impacts(scene, times, speeds, sides, phase, periods):
    """Solve for the orbit with impacts near given times since the section's phase. Raises OrbitError."""
    drive_period = 2.0 * np.pi / float(scene.frequency)
    sequence, diagnostics, newton_result = jax.device_get(
        solve_guess(scene, padded_sequence(scene, times, speeds, sides, phase, periods))
    )
    _require_converged(newton_result)
    n_impacts, residual = len(times), float(newton_result.residual)
    times, speeds, sides = (column[:n_impacts] for column in sequence[:3])
    minimal_period = _minimal_period(times, speeds, sides, periods, drive_period)
    if minimal_period < periods:
        n_minimal_impacts = n_impacts * minimal_period // periods
        return orbit_from_impacts(
            scene,
            times[:n_minimal_impacts],
            speeds[:n_minimal_impacts],
            sides[:n_minimal_impacts],
            phase,
            minimal_period,
        )
    section_delay = _section_delay(times, drive_period)
    if section_delay:
        shifted_times = np.mod(times - section_delay, periods * drive_period)
        order = np.argsort(shifted_times)
        phase = float(np.mod(phase + float(scene.frequency) * section_delay, 2.0 * np.pi))
        return orbit_from_impacts(scene, shifted_times[order], speeds[order], sides[order], phase, periods)
    _require_admissible(scene, speeds, diagnostics, residual)
    _require_certified(scene, sequence, diagnostics, n_impacts, residual)
    return _orbit_of_sequence(scene, sequence, diagnostics, n_impacts, residual)


def orbit_of_exact_impacts(scene, times, speeds, sides, periods, residual):
    """Assemble the orbit with exactly these impacts, which are neither corrected nor checked.

    Parameters
    ----------
    scene : Scene
        A single scene.
    times, speeds, sides : numpy.ndarray
        Impacts; times since phase 0, in t.
    periods : int
        Number of drive periods.
    residual : float
        Residual of the equations, to be stored in the orbit.

    Returns
    -------
    Orbit
        The orbit. Its section is at phase 0 unless an impact is near this phase.
    """
    drive_period = 2.0 * np.pi / float(scene.frequency)
    section_delay = _section_delay(np.mod(times, periods * drive_period), drive_period)
    shifted_times = np.mod(times - section_delay, periods * drive_period)
    order = np.argsort(shifted_times)
    phase = np.mod(float(scene.frequency) * section_delay, 2.0 * np.pi)
    return _assemble_orbit(scene, shifted_times[order], speeds[order], sides[order], phase, periods, residual)


def move_section_to_phase_0(orbit, itinerary):
    """Move the section of an orbit to phase 0 of its first drive period.

    Rounding may shift an impact near phase 0 to the adjacent drive period. Such impacts are assigned to the periods
    that give the itinerary of the result, if possible.

    Parameters
    ----------
    orbit : Orbit
        Orbit that was solved by its impacts.
    itinerary : tuple of str
        Itinerary of the result.

    Returns
    -------
    Orbit
        The same orbit with its section at phase 0. The impacts are not corrected.
    """
    scene, impacts, n_periods = orbit.scene, orbit.impacts, orbit.periods
    drive_period = 2.0 * np.pi / float(scene.frequency)
    orbit_duration, smallest_positive_time = n_periods * drive_period, float(np.finfo(scene.dtype).eps) * drive_period
    times, tolerance = (
        np.mod(impacts.time + orbit.state.phase / float(scene.frequency), orbit_duration),
        TIME_TOLERANCE * drive_period,
    )
    time_choices = [
        times,
        np.where(times < tolerance, orbit_duration, times),
        np.where(times > orbit_duration - tolerance, smallest_positive_time, times),
    ]
    sort_orders = [np.argsort(candidate_times, kind="stable") for candidate_times in time_choices]
    matching_indices = (
        choice_index
        for choice_index, (candidate_times, order) in enumerate(zip(time_choices, sort_orders, strict=True))
        if words.itinerary_of_impacts(candidate_times[order], impacts.side[order], n_periods, drive_period) == itinerary
    )
    choice_index = next(matching_indices, 0)
    times, order = time_choices[choice_index], sort_orders[choice_index]
    return _assemble_orbit(
        scene, times[order], impacts.speed[order], impacts.side[order], 0.0, n_periods, orbit.residual
    )


def _assemble_orbit(scene, times, speeds, sides, phase, periods, residual):
    """Assemble the orbit with these impacts, at times since the section's phase, without correcting them."""
    sequence = padded_sequence(scene, times, speeds, sides, phase, periods)
    diagnostics = jax.device_get(_diagnose_compiled(scene, sequence))
    return _orbit_of_sequence(scene, sequence, diagnostics, len(times), float(np.asarray(residual, scene.dtype)))


_diagnose_compiled = persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)(_diagnose_sequence)


def _orbit_of_sequence(scene, sequence, diagnostics, n_impacts, residual):
    """Assemble the orbit of an impact sequence and rotate its itinerary to the canonical start."""
    times, speeds, sides, phase, periods = sequence[:5]
    drive_period = 2.0 * np.pi / float(scene.frequency)
    itinerary, section_points = (
        words.itinerary_of_impacts(times[:n_impacts], sides[:n_impacts], int(periods), drive_period),
        np.stack(diagnostics.section_states, 1),
    )
    min_clearance = float(diagnostics.closest_approaches[0][:n_impacts].min(initial=np.inf))
    impact_columns = times[:n_impacts], speeds[:n_impacts], sides[:n_impacts]
    itinerary, section_state, impacts = rotate_to_canonical_start(
        itinerary, section_points[: int(periods)], *impact_columns, min_clearance, drive_period
    )
    multiplier_pair = eigenvalue_pair(float(diagnostics.trace), float(diagnostics.determinant))
    state = State(*section_state, float(phase), 0.0)
    return make_orbit(scene, state, impacts, itinerary, multiplier_pair, residual, "impacts")


def _require_converged(newton_result):
    """Raise OrbitError unless Newton's method has converged."""
    status, residual = int(newton_result.status), float(newton_result.residual)
    if status != newton.OK:
        raise OrbitError(newton.STATUS_TEXTS[status], residual, newton.ADVICE[status])


def _minimal_period(times, speeds, sides, periods, drive_period):
    """Return the smallest number of periods after which the impacts repeat."""
    points = impacts_as_points(2.0 * np.pi / drive_period, times, sides, speeds, 1.0 + speeds.max())
    return periods // repetition_count(points, periods, IMPACT_TOLERANCE)


def _section_delay(times, drive_period):
    """Return the delay by which to move the section: 0 unless an impact is near the section.

    The section moves to the middle of the widest gap between impacts; the first of equally wide gaps is used.
    """
    times_in_period = np.sort(np.mod(times, drive_period))
    if min(times_in_period[0], drive_period - times_in_period[-1]) >= MIN_SECTION_GAP * drive_period:
        return 0.0
    time_gaps = np.diff(times_in_period, append=times_in_period[0] + drive_period)
    gap_middles = np.mod(times_in_period + 0.5 * time_gaps, drive_period)
    return float(gap_middles[time_gaps >= time_gaps.max() - MIN_SECTION_GAP * drive_period].min())


def _require_admissible(scene, speeds, diagnostics, residual):
    """Raise OrbitError for impacts with zero speed and for flights behind a wall."""
    n_impacts, slowest_index = len(speeds), int(np.argmin(speeds))
    clearances, approach_times = (approach_array[:n_impacts] for approach_array in diagnostics.closest_approaches)
    if not speeds[slowest_index] > 0:
        reason = f"impact {slowest_index + 1} of {n_impacts} would have the speed {speeds[slowest_index]:.3g}"
        raise OrbitError(f"not admissible: {reason}", residual, ADVICE_BRANCH_ENDED)
    flight_index, wall_index = np.unravel_index(int(np.argmin(clearances)), clearances.shape)
    if clearances[flight_index, wall_index] < 0:
        wall_name = list(scene.walls)[wall_index]
        reason = (
            f"flight {flight_index + 1} of {n_impacts} passes through the {wall_name} wall,"
            f" {-clearances[flight_index, wall_index]:.3g} deep"
        )
        reason += f", {approach_times[flight_index, wall_index]:.6g} after its start"
        raise OrbitError(f"not admissible: {reason}", residual, ADVICE_BRANCH_ENDED)


def _require_certified(scene, sequence, diagnostics, n_impacts, residual):
    """Raise OrbitError unless certified flights confirm the impacts.

    Each certified motion starts in the middle of a flight, so that it does not start on a wall. Its first two impacts
    must be on the expected walls at the expected times.
    """
    times, _, sides, phase = sequence[:4]
    drive_period = 2.0 * np.pi / float(scene.frequency)
    flights, next_row = diagnostics.flights, diagnostics.flights.next_row[:n_impacts]
    flight_durations = flights.time[:n_impacts]
    contact_durations = (
        np.zeros_like(flight_durations)
        if flights.contact_map.contact_time is None
        else flights.contact_map.contact_time[:n_impacts]
    )
    midflight_phases = phase + np.asarray(scene.frequency) * (
        times[:n_impacts] + contact_durations + 0.5 * flight_durations
    )
    midflight_start_states = State(
        diagnostics.midflight_states[0][:n_impacts],
        diagnostics.midflight_states[1][:n_impacts],
        midflight_phases,
        np.zeros_like(midflight_phases),
    )
    expected_impact_times = 0.5 * flight_durations
    expected_impact_times = np.stack(
        [expected_impact_times, expected_impact_times + (contact_durations + flight_durations)[next_row]], axis=1
    )
    iterates = iterate(
        scene, midflight_start_states, max(1, int(np.ceil(expected_impact_times.max() / drive_period + TIME_TOLERANCE)))
    )
    flown_impact_times = iterates.time + drive_period * np.arange(len(iterates.time))[:, None, None]
    flown_impact_times = (
        np.where(iterates.side != 0, flown_impact_times, np.inf).transpose(1, 0, 2).reshape(n_impacts, -1)
    )
    first_two_indices = flown_impact_times.argsort(axis=1)[:, :2]
    flown_impact_sides = np.take_along_axis(
        iterates.side.transpose(1, 0, 2).reshape(n_impacts, -1), first_two_indices, 1
    )
    is_time_wrong = (
        abs(np.take_along_axis(flown_impact_times, first_two_indices, 1) - expected_impact_times)
        > TIME_TOLERANCE * drive_period
    )
    wrong_flight_indices = np.flatnonzero(
        (is_time_wrong | (flown_impact_sides != sides[np.stack([next_row, next_row[next_row]], axis=1)])).any(axis=1)
    )
    if wrong_flight_indices.size:
        reason = f"the flight after impact {wrong_flight_indices[0] + 1} of {n_impacts}"
        reason += " does not meet the expected wall at the expected time"
        raise OrbitError(f"not admissible: {reason}", residual, "start nearer to an orbit")


def solve_guesses(scene, guesses):
    """Return (impact sequences, `newton.NewtonSolution`) from many guesses, with a row for each."""
    return jax.device_get(_solve_guesses_compiled(scene, guesses))


@persistent_jit()
@partial(jax.vmap, in_axes=(None, 0))
def _solve_guesses_compiled(scene, guess):
    newton_result = impact_equations.solve_sequence(scene, guess)
    return impact_equations.sort_sequence(scene, guess, newton_result.unknowns), newton_result


def orbit_from_random_guesses(scene, itinerary, state, max_speed):
    """Solve for orbits with an itinerary from random guesses of the impacts; return the orbit nearest to the state.

    `max_speed` is a large speed of the scene. If no guess leads to an orbit, the last OrbitError is raised.
    """
    wall_letters, periods = "".join(itinerary), len(itinerary)
    if not wall_letters:
        raise OrbitError("the motion from the state hits walls", np.nan, "start a motion that hits no wall")
    drive_period = 2.0 * np.pi / float(scene.frequency)
    rng = np.random.default_rng(0)
    period_indices = np.repeat(np.arange(periods), [len(word) for word in itinerary])
    times = np.sort(period_indices + rng.random((N_GUESSES, len(wall_letters))), axis=1) * drive_period
    speeds = max_speed * rng.random(times.shape)
    sides = np.broadcast_to(words.sides_of_itinerary(itinerary), times.shape)
    guesses = [
        padded_sequence(scene, *arrays, state.phase, periods) for arrays in zip(times, speeds, sides, strict=True)
    ]
    sequences, newton_results = solve_guesses(scene, jax.tree.map(lambda *arrays: np.stack(arrays), *guesses))
    last_error = OrbitError("no guess leads to a solution with this itinerary", np.nan, "give a state near the orbit")
    known_keys, orbits = set(), []
    for guess_index in np.flatnonzero(newton_results.status == newton.OK):
        key = tuple(np.round(sequences.times[guess_index], 6))
        if key not in known_keys:
            known_keys.add(key)
            try:
                orbit = orbit_from_impacts(
                    scene, *(arrays[guess_index][: len(wall_letters)] for arrays in sequences[:3]), state.phase, periods
                )
            except OrbitError as error:
                last_error = error
                continue
            if words.is_same_itinerary(orbit.itinerary * (periods // orbit.periods), itinerary):
                orbits.append(orbit)
    if not orbits:
        raise last_error
    return min(orbits, key=lambda orbit: abs(orbit.state.x - state.x) + abs(orbit.state.v - state.v))
