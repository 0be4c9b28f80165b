"""Describe orbits that stick by their impacts, from a release to the bounces before the mass sticks again.

The motion after a release does not depend on the motion before it. The rows of an orbit
(`impact_equations.ImpactSequence`) are a release, the impacts up to a bounce from which all bounces are short and have
a positive contact force, and the next release. `chatter` computes these bounces: their end, the duration of sticking,
and the state during the bounces.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from continuation.array_type import Array
from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..contact.wall_at_contact import contact_force_derivatives
from ..flight import flow
from ..flight.motion_in_soft_wall import restitution_of
from ..scene.state import Contact
from . import chatter

SCAN_STEP = 0.2  # of `FlowCoefficients.max_step`: between two samples of the contact force
NEWTON_STEPS = 5  # to a minimum of the contact force
MAX_FIRST_HOP = 0.5  # of `chatter.MAX_HOP_TIME`: longest first bounce of a row that is chosen
MAX_HOPS = 64  # bounces that are computed to find such a row
MIN_FLIGHT_TIME = 0.1  # of `chatter.MAX_HOP_TIME`: shorter flights of a mass with zero speed are no rows


class ChatterOutcome(NamedTuple):
    """Outcome of the chatter of each row that a release follows.

    For other rows `sticking_time` and `min_contact_force` are inf, `height` and `velocity` are 0, and `hop_margin` is
    inf unless R is 0 and the mass returns to the same wall.

    Attributes
    ----------
    sticking_time : Array
        Duration of sticking; negative if the mass does not stick.
    min_contact_force : Array
        Smallest local minimum of the contact force before the release, as `chatter_and_release.min_contact_force`
        returns it; inf if there is none.
    hop_margin : Array
        Positive if all bounces from this row are short and the contact force is positive. If R is 0 and the mass lifts
        off the wall and returns to it, positive if the flight is not too short.
    height, velocity : Array
        State relative to the wall, away from it, at the requested times; of shape (rows, times).
    """

    sticking_time: Float[Array, "*rows"]
    min_contact_force: Float[Array, "*rows"]
    hop_margin: Float[Array, "*rows"]
    height: Float[Array, "*rows times"]
    velocity: Float[Array, "*rows times"]


class ChatterStart(NamedTuple):
    """Start of a sequence of bounces.

    Attributes
    ----------
    side : Array
        Side of the wall, -1 or 1.
    cosine, sine : Array
        Cosine and sine of the drive's phase at the release, not at the start.
    tau : Array
        Time of the start relative to the release, negative.
    speed : Array
        Speed at which the mass leaves the wall.
    lifts : Array of bool
        True if R is 0 and the mass lifts off at once, returns and sticks.
    """

    side: Float[Array, "*rows"]
    cosine: Float[Array, "*rows"]
    sine: Float[Array, "*rows"]
    tau: Float[Array, "*rows"]
    speed: Float[Array, "*rows"]
    lifts: Bool[Array, "*rows"]


def chatter_starts(coeffs, sequence, flights):
    """Return the start of the bounces of each row that a release follows.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        Sequence with releases.
    flights : Flights
        Flights of the sequence.

    Returns
    -------
    starts : ChatterStart
        Starts for all rows. The bounces of a row that no release follows end at once.
    ends_in_release : Array of bool
        True for rows that a release follows.
    """
    precedes_release = (sequence.sides != 0) & (sequence.releases[flights.next_row] > 0)
    last_row_index = jnp.sum(sequence.sides != 0) - 1
    wrap_time = jnp.where(jnp.arange(len(sequence.sides)) == last_row_index, sequence.periods * coeffs.period, 0.0)
    tau = sequence.times - (sequence.times[flights.next_row] + wrap_time)
    cosine, sine = (
        flights.mirror_sign * phasor_component[flights.next_row]
        for phasor_component in (flights.contact_map.cosine, flights.contact_map.sine)
    )
    speed = flights.contact_map.restitution * sequence.speeds
    zero = jnp.zeros_like(tau)
    default_start = ChatterStart(zero + sequence.sides[0], cosine, sine, zero - 1.0, zero, zero > 0)
    starts = ChatterStart(sequence.sides, cosine, sine, tau, speed, sequence.releases[flights.next_row] > 1)
    return jax.tree.map(lambda new, old: jnp.where(precedes_release, new, old), starts, default_start), precedes_release


def chatter_outcomes(coeffs, sequence, flights, query_times):
    """Compute the chatter of an impact sequence that sticks.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        Sequence with releases.
    flights : Flights
        Flights of the sequence.
    query_times : Array
        Times since the phase of the section at which the height is evaluated, of shape (times,).

    Returns
    -------
    ChatterOutcome
        Outcome of each row.
    """
    starts, precedes_release = chatter_starts(coeffs, sequence, flights)
    orbit_duration = sequence.periods * coeffs.period
    elapsed_times = query_times - sequence.times[:, None]
    elapsed_times = elapsed_times - orbit_duration * jnp.floor(elapsed_times / orbit_duration)
    outcomes = jax.vmap(partial(_chatter_outcome, coeffs))(starts, elapsed_times)
    default_outcome = ChatterOutcome(
        *(jnp.full_like(field, jnp.inf) for field in outcomes[:3]), *(jnp.zeros_like(field) for field in outcomes[3:])
    )
    outcomes = jax.tree.map(
        lambda new, old: jnp.where(precedes_release.reshape(-1, *(1,) * (new.ndim - 1)), new, old),
        outcomes,
        default_outcome,
    )
    returns_to_wall = (
        ~precedes_release
        & (flights.contact_map.restitution == 0)
        & (sequence.sides[flights.next_row] * flights.mirror_sign == sequence.sides)
    )
    returns_to_wall = returns_to_wall & (sequence.sides != 0) & (sequence.releases == 0)
    return outcomes._replace(
        hop_margin=jnp.where(
            returns_to_wall,
            flights.time / (MIN_FLIGHT_TIME * chatter.MAX_HOP_TIME * coeffs.max_step) - 1.0,
            outcomes.hop_margin,
        )
    )


def _chatter_outcome(coeffs, start, elapsed_times):
    """Return the `ChatterOutcome` of one row."""
    release_phasor = start.cosine, start.sine
    chatter_end = chatter.compute_chatter_end(coeffs, start.side, release_phasor, start.tau, start.speed, elapsed_times)
    start_contact_force, start_force_rate, _ = _contact_force_jet(coeffs, start, start.tau)
    hop_duration_margin = 1.0 - chatter_end.first_hop_time / (chatter.MAX_HOP_TIME * coeffs.max_step)
    force_margin = start_contact_force / (
        abs(start_contact_force) + jnp.maximum(start_force_rate, 0.0) * chatter_end.first_hop_time
    )
    hop_validity_margin = jnp.where(
        restitution_of(coeffs, start.side) > 0, jnp.minimum(hop_duration_margin, force_margin), hop_duration_margin
    )
    return ChatterOutcome(
        chatter_end.sticking_time,
        min_contact_force(coeffs, start),
        hop_validity_margin,
        chatter_end.height,
        chatter_end.velocity,
    )


def _contact_force_jet(coeffs, start, tau):
    """Return the contact force on the wall with its first and second derivatives."""
    phasor = flow.rotate_phasor_by_angle(start.cosine, start.sine, coeffs.frequency * tau)
    return [start.side * derivative for derivative in contact_force_derivatives(coeffs, start.side, phasor, 2)]


def min_contact_force(coeffs, start):
    """Compute the smallest contact force at a minimum before the release.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    start : ChatterStart
        Start of the bounces, of one row.

    Returns
    -------
    Array
        A scalar: the smallest local minimum of the force, inf without one. `initial_contact_force` is included, with
        its sign reversed if ``start.lifts`` is true.
    """
    n_cells = jnp.ceil(abs(start.tau) / (SCAN_STEP * coeffs.max_step)).astype(int) + 2
    cell_duration = abs(start.tau) / n_cells

    def scan_cell(cell_index, carry):
        force_rate, min_force = carry
        cell_end = start.tau + cell_duration * (cell_index + 1.0)
        next_force_rate = _contact_force_jet(coeffs, start, cell_end)[1]
        has_minimum = (force_rate < 0) & (next_force_rate > 0)

        def newton_step(_, tau):
            _, slope, curvature = _contact_force_jet(coeffs, start, tau)
            step = slope / jnp.where(curvature == 0, 1.0, curvature)
            return jnp.clip(
                tau - step, start.tau + cell_duration * cell_index, start.tau + cell_duration * (cell_index + 1.0)
            )

        minimum_tau = lax.fori_loop(0, NEWTON_STEPS, newton_step, cell_end - 0.5 * cell_duration)
        return next_force_rate, jnp.where(
            has_minimum, jnp.minimum(min_force, _contact_force_jet(coeffs, start, minimum_tau)[0]), min_force
        )

    initial_force = initial_contact_force(coeffs, start)
    min_force = jnp.where(start.lifts & jnp.isfinite(initial_force), -initial_force, initial_force)
    return lax.fori_loop(0, n_cells, scan_cell, (_contact_force_jet(coeffs, start, start.tau)[1], min_force))[1]


def impact_pull_off_forces(coeffs, sequence, flights):
    """Compute the force that pulls the mass off the wall at impacts with R = 0.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        The impacts.
    flights : Flights
        Flights of the sequence.

    Returns
    -------
    Array
        Force of each row, of shape (rows,): negative if the mass is pressed on the wall and would stick. The value is
        inf for rows with R > 0, and for releases and rows that a release follows.
    """
    contact_force, _ = contact_force_derivatives(
        coeffs, sequence.sides, (flights.contact_map.cosine, flights.contact_map.sine)
    )
    can_stick_at_impact = (sequence.sides != 0) & (flights.contact_map.restitution == 0)
    if sequence.releases is not None:
        can_stick_at_impact = (
            can_stick_at_impact & (sequence.releases == 0) & (sequence.releases[flights.next_row] == 0)
        )
    return jnp.where(can_stick_at_impact, -sequence.sides * contact_force, jnp.inf)


def initial_contact_force(coeffs, start):
    """Compute the contact force at an impact with R = 0 if the force increases.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    start : ChatterStart
        Start of the bounces, of one row.

    Returns
    -------
    Array
        A scalar: negative if the mass is pulled off its wall; inf for R > 0 or a decreasing force.
    """
    contact_force, force_rate, _ = _contact_force_jet(coeffs, start, start.tau)
    return jnp.where((restitution_of(coeffs, start.side) == 0) & (force_rate > 0), contact_force, jnp.inf)


def evaluate_chatter_starts(function_of_start, coeffs, sequence, flights):
    """Evaluate a function of a `ChatterStart`, such as `excess_speed`, for each row.

    Parameters
    ----------
    function_of_start : callable
        Function of (coeffs, start) that returns a scalar.
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        Sequence with releases.
    flights : Flights
        Flights of the sequence.

    Returns
    -------
    Array
        Values of shape (rows,); inf for rows that no release follows.
    """

    def evaluate_row(start_and_mask):
        start, precedes_release = start_and_mask
        return lax.cond(
            precedes_release, partial(function_of_start, coeffs), lambda start: jnp.full_like(start.tau, jnp.inf), start
        )

    return lax.map(
        evaluate_row, chatter_starts(coeffs, sequence, flights)
    )  # row by row: under vmap each row would take as long as all of them


def excess_speed(coeffs, start):
    """Compute the excess of the speed over the critical speed for sticking.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    start : ChatterStart
        Start of the bounces, of one row.

    Returns
    -------
    Array
        A scalar: excess of the speed after the bounces that are far from the release. For R = 0 the value is instead
        the time from the release to the impact, or to the return of a mass that is pulled off. Negative if the mass
        sticks.
    """
    release_phasor = start.cosine, start.sine
    phasor = flow.rotate_phasor_by_angle(*release_phasor, coeffs.frequency * start.tau)
    return_tau = start.tau + chatter.evaluate_hop(coeffs, start.side, phasor, jnp.zeros_like(start.tau)).time
    tau, speed = chatter.bounce_to_near_release(coeffs, start.side, release_phasor, start.tau, start.speed)
    speed_excess = speed - chatter.critical_speed(coeffs, start.side, release_phasor, tau)
    return jnp.where(restitution_of(coeffs, start.side) > 0, speed_excess, return_tau)


def _follow_bounces(scene, side, release_phase, tau, impact_speed):
    coeffs = flow_coefficients(scene)
    release_phasor = jnp.cos(release_phase), jnp.sin(release_phase)
    contact_force = (
        side
        * contact_force_derivatives(coeffs, side, flow.rotate_phasor_by_angle(*release_phasor, coeffs.frequency * tau))[
            0
        ]
    )
    lifts_off_at_once = (restitution_of(coeffs, side) == 0) & (contact_force < 0)
    start = ChatterStart(side, *release_phasor, tau, restitution_of(coeffs, side) * impact_speed, lifts_off_at_once)
    outcome = _chatter_outcome(coeffs, start, jnp.zeros(0, tau.dtype))

    def fly_hop(hop_index, carry):
        hop_tau, take_off_speed, landing_taus, landing_speeds = carry
        hop = chatter.evaluate_hop(
            coeffs,
            side,
            flow.rotate_phasor_by_angle(start.cosine, start.sine, coeffs.frequency * hop_tau),
            take_off_speed,
        )
        hop_tau = hop_tau + hop.time
        is_hop_slot = jnp.arange(MAX_HOPS) == hop_index
        return (
            hop_tau,
            restitution_of(coeffs, side) * hop.landing_speed,
            jnp.where(is_hop_slot, hop_tau, landing_taus),
            jnp.where(is_hop_slot, hop.landing_speed, landing_speeds),
        )

    zeros = jnp.zeros(MAX_HOPS, tau.dtype)
    _, _, landing_taus, landing_speeds = lax.fori_loop(0, MAX_HOPS, fly_hop, (tau, start.speed, zeros, zeros))
    return (
        outcome.sticking_time,
        outcome.min_contact_force,
        outcome.hop_margin,
        landing_taus,
        landing_speeds,
        lifts_off_at_once,
    )


@persistent_jit(compiler_options=FAST_COMPILE)
def _follow_bounces_compiled(scene, side, release_phase, tau, impact_speed):
    """Follow the bounces after an impact at tau with a speed; `release_phase` is the phase of the drive at the release.

    Return (sticking time, smallest contact force, hop margin, tau of the next impacts, speeds of the next impacts, True
    if the mass lifts off at once).
    """
    return call_as_kernel(_follow_bounces, scene, side, release_phase, tau, impact_speed)


def sticking_orbit_rows(scene, phase, times, speeds, sides, sticking_intervals, periods, tolerance=0.0):
    """Reduce the impacts of an orbit that sticks to the rows of an `ImpactSequence`.

    Parameters
    ----------
    scene : Scene
        A single scene.
    phase : float
        Phase of the section, in rad.
    times, speeds, sides : numpy.ndarray
        Impacts since this phase.
    sticking_intervals : tuple of tuple
        Sticking phases, as in `StickingPhaseIntervals.intervals`.
    periods : int
        Number of drive periods.
    tolerance : float, optional
        Relative tolerance of speeds and absolute tolerance of contact forces. A sticking phase that fails by less than
        this is accepted.

    Returns
    -------
    times, speeds, sides : numpy.ndarray
        Rows in order of time. The side of a release is multiplied by ``Contact.STUCK``, or by one more than this if the
        mass lifts off once more before it sticks.

    Notes
    -----
    The impacts on the wall of a sticking phase are rows up to the first one from which all bounces are short and have a
    positive contact force. The later bounces are omitted. If no recorded impact has this property, computed bounces are
    added as rows.
    """
    orbit_duration, frequency = periods * 2.0 * np.pi / float(scene.frequency), float(scene.frequency)
    order = np.argsort(times)
    impacts = [(times[k], speeds[k], int(sides[k])) for k in order]
    last_impact_indices = [
        int(
            np.argmin(
                [
                    abs(time - sticking_start) + orbit_duration * (impact_side != side)
                    for time, _, impact_side in impacts
                ]
            )
        )
        for side, sticking_start, _ in sticking_intervals
    ]
    rows, dropped_indices = [], set()
    for (side, _, release_time), last_index in zip(sticking_intervals, last_impact_indices, strict=True):
        chain_indices = []  # consecutive impacts on this wall, up to the last
        for k in range(len(impacts)):
            index = (last_index - k) % len(impacts)
            if impacts[index][2] != side or (k and index in last_impact_indices):
                break
            chain_indices.insert(0, index)
        n_chain_rows, added_impact_rows, lifts_off = _chain_rows(
            scene,
            phase + frequency * release_time,
            release_time,
            orbit_duration,
            [impacts[k] for k in chain_indices],
            tolerance,
        )
        dropped_indices |= set(chain_indices[n_chain_rows:])
        rows += [*added_impact_rows, (release_time, 0.0, (Contact.STUCK + lifts_off) * int(side))]
    rows += [impact for k, impact in enumerate(impacts) if k not in dropped_indices]
    rows = sorted((time % orbit_duration, speed, side) for time, speed, side in rows)
    return tuple(np.array(column, float) for column in zip(*rows, strict=True))


def _chain_rows(scene, release_phase, release_time, orbit_duration, impact_chain, tolerance):
    """Return (number of impacts of a chain that are rows, added rows, True if the mass lifts off after the rows)."""
    to_array = partial(np.asarray, dtype=scene.dtype)
    for k, (time, speed, side) in enumerate(impact_chain):
        tau = (time - release_time) % -orbit_duration
        bounce_arguments = (to_array(number) for number in (side, release_phase, tau, speed * (1.0 - tolerance)))
        sticking_duration, min_force, hop_validity_margin, landing_taus, landing_speeds, lifts_off = (
            _follow_bounces_compiled(scene, *bounce_arguments)
        )
        if sticking_duration > 0 and min_force > -tolerance and hop_validity_margin > 1.0 - MAX_FIRST_HOP:
            return k + 1, [], bool(lifts_off)
    added_impact_rows = []
    for time, speed in zip(landing_taus, landing_speeds, strict=True):
        added_impact_rows.append((release_time + float(time), float(speed), side))
        bounce_arguments = (to_array(number) for number in (side, release_phase, time, speed))
        if _follow_bounces_compiled(scene, *bounce_arguments)[2] > 1.0 - MAX_FIRST_HOP:
            return len(impact_chain), added_impact_rows, False
    return len(impact_chain), [], False
