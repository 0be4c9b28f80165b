"""Orbits that stick, by their impacts: from the release to the bounces by which the mass comes to stick again.

Sticking erases the past, so that an orbit is determined from a release on. Its rows (`impact_equations.ImpactSequence`)
are a release, the impacts up to a bounce from which all bounces are short and have a positive contact force, and the
next release. `chatter` computes these bounces: their end, the duration of sticking, and the state in between.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from continuation.array_type import Array
from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight import flow
from ..flight.coefficients import flow_coefficients
from ..flight.soft_contact import restitution_of
from ..scene.codes import Contact
from . import chatter
from .wall_at_contact import contact_force_derivatives

SCAN_STEP = 0.2  # of `FlowCoefficients.max_step`: between two samples of the contact force
NEWTON_STEPS = 5  # to a minimum of the contact force
MAX_FIRST_HOP = 0.5  # of `chatter.MAX_HOP_TIME`: longest first bounce of a row that is chosen
MAX_HOPS = 64  # bounces that are computed to find such a row
MIN_FLIGHT_TIME = 0.1  # of `chatter.MAX_HOP_TIME`: shorter flights of a mass with zero speed are no rows


class ChatterOutcome(NamedTuple):
    """Chatter of each row that a release follows, inf for other rows.

    Attributes
    ----------
    sticking_time : Array
        Duration of sticking; negative if the mass does not stick.
    min_contact_force : Array
        Smallest contact force on the way to the release; inf if it only decreases.
    hop_margin : Array
        Positive while all bounces from this row are short and the contact force is positive. For a row that the mass
        leaves with zero speed because the force pulls it off, positive while the mass does not return too soon.
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

    `side` is that of the wall; `cosine` and `sine` are those of the drive at the release; `tau` is the time before the
    release, negative; `speed` is that of leaving the wall. `lifts` is true if R is 0 and the mass is pulled off at
    once, to return and stick.
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
        Starts for all rows; other rows have one that ends at once.
    ends_in_release : Array of bool
        True for rows that a release follows.
    """
    ends_in_release = (sequence.sides != 0) & (sequence.releases[flights.next_row] > 0)
    last_row = jnp.sum(sequence.sides != 0) - 1
    wrap_time = jnp.where(jnp.arange(len(sequence.sides)) == last_row, sequence.periods * coeffs.period, 0.0)
    tau = sequence.times - (sequence.times[flights.next_row] + wrap_time)
    cosine, sine = (
        flights.mirror_sign * phasor_part[flights.next_row]
        for phasor_part in (flights.contact_map.cosine, flights.contact_map.sine)
    )
    speed = flights.contact_map.restitution * sequence.speeds
    zero = jnp.zeros_like(tau)
    default_start = ChatterStart(zero + sequence.sides[0], cosine, sine, zero - 1.0, zero, zero > 0)
    starts = ChatterStart(sequence.sides, cosine, sine, tau, speed, sequence.releases[flights.next_row] > 1)
    return jax.tree.map(lambda new, old: jnp.where(ends_in_release, new, old), starts, default_start), ends_in_release


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
    starts, ends_in_release = chatter_starts(coeffs, sequence, flights)
    total_time = sequence.periods * coeffs.period
    elapsed_times = query_times - sequence.times[:, None]
    elapsed_times = elapsed_times - total_time * jnp.floor(elapsed_times / total_time)
    outcomes = jax.vmap(partial(_chatter_outcome, coeffs))(starts, elapsed_times)
    default_outcome = ChatterOutcome(
        *(jnp.full_like(field, jnp.inf) for field in outcomes[:3]), *(jnp.zeros_like(field) for field in outcomes[3:])
    )
    outcomes = jax.tree.map(
        lambda new, old: jnp.where(ends_in_release.reshape(-1, *(1,) * (new.ndim - 1)), new, old),
        outcomes,
        default_outcome,
    )
    returns_to_wall = (
        ~ends_in_release
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
    chatter_end = chatter.chatter_end(coeffs, start.side, release_phasor, start.tau, start.speed, elapsed_times)
    contact_force, force_rate, _ = _contact_force_jet(coeffs, start, start.tau)
    hop_time_margin = 1.0 - chatter_end.first_hop_time / (chatter.MAX_HOP_TIME * coeffs.max_step)
    force_margin = contact_force / (abs(contact_force) + jnp.maximum(force_rate, 0.0) * chatter_end.first_hop_time)
    hop_margin = jnp.where(
        restitution_of(coeffs, start.side) > 0, jnp.minimum(hop_time_margin, force_margin), hop_time_margin
    )
    return ChatterOutcome(
        chatter_end.sticking_time,
        min_contact_force(coeffs, start),
        hop_margin,
        chatter_end.height,
        chatter_end.velocity,
    )


def _contact_force_jet(coeffs, start, tau):
    """Return the contact force on the wall with its first and second derivatives."""
    phasor = flow.rotate_by_angle(start.cosine, start.sine, coeffs.frequency * tau)
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
        its sign reversed if the mass `lifts`.
    """
    n_cells = jnp.ceil(abs(start.tau) / (SCAN_STEP * coeffs.max_step)).astype(int) + 2
    cell_time = abs(start.tau) / n_cells

    def scan_cell(cell, carry):
        force_rate, min_force = carry
        cell_end = start.tau + cell_time * (cell + 1.0)
        next_force_rate = _contact_force_jet(coeffs, start, cell_end)[1]
        has_minimum = (force_rate < 0) & (next_force_rate > 0)

        def newton_step(_, tau):
            _, slope, curvature = _contact_force_jet(coeffs, start, tau)
            step = slope / jnp.where(curvature == 0, 1.0, curvature)
            return jnp.clip(tau - step, start.tau + cell_time * cell, start.tau + cell_time * (cell + 1.0))

        minimum_tau = lax.fori_loop(0, NEWTON_STEPS, newton_step, cell_end - 0.5 * cell_time)
        return next_force_rate, jnp.where(
            has_minimum, jnp.minimum(min_force, _contact_force_jet(coeffs, start, minimum_tau)[0]), min_force
        )

    initial_force = initial_contact_force(coeffs, start)
    min_force = jnp.where(start.lifts & jnp.isfinite(initial_force), -initial_force, initial_force)
    return lax.fori_loop(0, n_cells, scan_cell, (_contact_force_jet(coeffs, start, start.tau)[1], min_force))[1]


def lift_off_force(coeffs, sequence, flights):
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
        Force of each row, of shape (rows,): negative if the mass is pressed on the wall and would stick, inf for rows
        with R > 0 or a release next.
    """
    contact_force, _ = contact_force_derivatives(
        coeffs, sequence.sides, (flights.contact_map.cosine, flights.contact_map.sine)
    )
    leaves_wall = (sequence.sides != 0) & (flights.contact_map.restitution == 0)
    if sequence.releases is not None:
        leaves_wall = leaves_wall & (sequence.releases == 0) & (sequence.releases[flights.next_row] == 0)
    return jnp.where(leaves_wall, -sequence.sides * contact_force, jnp.inf)


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


def map_chatter_starts(measure, coeffs, sequence, flights):
    """Evaluate a function of a `ChatterStart`, such as `excess_speed`, for each row.

    Parameters
    ----------
    measure : callable
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

    def measure_row(row):
        start, ends_in_release = row
        return lax.cond(
            ends_in_release, partial(measure, coeffs), lambda start: jnp.full_like(start.tau, jnp.inf), start
        )

    return lax.map(
        measure_row, chatter_starts(coeffs, sequence, flights)
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
        A scalar: excess of the speed after the bounces that are far from the release. For R = 0 it is the time from the
        release to the impact, or to the return of a mass that is pulled off.
    """
    release_phasor = start.cosine, start.sine
    phasor = flow.rotate_by_angle(*release_phasor, coeffs.frequency * start.tau)
    return_tau = start.tau + chatter.evaluate_hop(coeffs, start.side, phasor, jnp.zeros_like(start.tau)).time
    tau, speed = chatter.approach_release(coeffs, start.side, release_phasor, start.tau, start.speed)
    excess = speed - chatter.critical_speed(coeffs, start.side, release_phasor, tau)
    return jnp.where(restitution_of(coeffs, start.side) > 0, excess, return_tau)


def _examine_impact(scene, side, phase, tau, speed):
    coeffs = flow_coefficients(scene)
    release_phasor = jnp.cos(phase), jnp.sin(phase)
    contact_force = (
        side * contact_force_derivatives(coeffs, side, flow.rotate_by_angle(*release_phasor, coeffs.frequency * tau))[0]
    )
    lifts = (restitution_of(coeffs, side) == 0) & (contact_force < 0)
    start = ChatterStart(side, *release_phasor, tau, restitution_of(coeffs, side) * speed, lifts)
    outcome = _chatter_outcome(coeffs, start, jnp.zeros(0, tau.dtype))

    def fly_hop(hop_index, carry):
        hop_tau, speed_after, times, speeds = carry
        hop = chatter.evaluate_hop(
            coeffs, side, flow.rotate_by_angle(start.cosine, start.sine, coeffs.frequency * hop_tau), speed_after
        )
        hop_tau = hop_tau + hop.time
        is_this_hop = jnp.arange(MAX_HOPS) == hop_index
        return (
            hop_tau,
            restitution_of(coeffs, side) * hop.landing_speed,
            jnp.where(is_this_hop, hop_tau, times),
            jnp.where(is_this_hop, hop.landing_speed, speeds),
        )

    zeros = jnp.zeros(MAX_HOPS, tau.dtype)
    _, _, times, speeds = lax.fori_loop(0, MAX_HOPS, fly_hop, (tau, start.speed, zeros, zeros))
    return outcome.sticking_time, outcome.min_contact_force, outcome.hop_margin, times, speeds, lifts


@persistent_jit(compiler_options=FAST_COMPILE)
def _examine_compiled(scene, side, phase, tau, speed):
    """Examine an impact at tau with a speed; `phase` is that of the drive at the release.

    Return (sticking time, smallest contact force, hop margin, times before the release and speeds of the next impacts,
    lifts).
    """
    return call_as_kernel(_examine_impact, scene, side, phase, tau, speed)


def sticking_orbit_rows(scene, phase, times, speeds, sides, intervals, periods, tolerance=0.0):
    """Reduce the impacts of an orbit that sticks to the rows of an `ImpactSequence`.

    Parameters
    ----------
    scene : Scene
        A single scene.
    phase : float
        Phase of the section, in rad.
    times, speeds, sides : numpy.ndarray
        Impacts since this phase.
    intervals : tuple of tuple
        Sticking phases, as in `StickingPhases.intervals`.
    periods : int
        Number of drive periods.
    tolerance : float, optional
        Tolerance of speeds and contact forces within which a marginal sticking phase may be none.

    Returns
    -------
    times, speeds, sides : numpy.ndarray
        Rows in order of time. A release has a multiple of its side: ``Contact.STUCK``, or one more if the mass lifts
        before it sticks.

    Notes
    -----
    An impact is a row up to the first from which all bounces on its wall are short and have a positive contact force.
    """
    total_time, frequency = periods * 2.0 * np.pi / float(scene.frequency), float(scene.frequency)
    order = np.argsort(times)
    impacts = [(times[k], speeds[k], int(sides[k])) for k in order]
    last_impacts = [
        int(np.argmin([abs(time - start) + total_time * (impact_side != side) for time, _, impact_side in impacts]))
        for side, start, _ in intervals
    ]
    rows, dropped = [], set()
    for (side, _, release_time), last_impact in zip(intervals, last_impacts, strict=True):
        chain = []  # consecutive impacts on this wall, up to the last
        for k in range(len(impacts)):
            index = (last_impact - k) % len(impacts)
            if impacts[index][2] != side or (k and index in last_impacts):
                break
            chain.insert(0, index)
        n_rows, extra_rows, lifts = _truncate_chain(
            scene, phase + frequency * release_time, release_time, total_time, [impacts[k] for k in chain], tolerance
        )
        dropped |= set(chain[n_rows:])
        rows += [*extra_rows, (release_time, 0.0, (Contact.STUCK + lifts) * int(side))]
    rows += [impact for k, impact in enumerate(impacts) if k not in dropped]
    rows = sorted((time % total_time, speed, side) for time, speed, side in rows)
    return tuple(np.array(column, float) for column in zip(*rows, strict=True))


def _truncate_chain(scene, phase, release_time, total_time, chain, tolerance):
    """Return (number of rows of a chain of impacts, additional impacts as rows, True if the last one lifts)."""
    to_array = partial(np.asarray, dtype=scene.dtype)
    for k, (time, speed, side) in enumerate(chain):
        tau = (time - release_time) % -total_time
        arguments = (to_array(number) for number in (side, phase, tau, speed * (1.0 - tolerance)))
        sticking_time, min_force, hop_margin, hop_times, hop_speeds, lifts = _examine_compiled(scene, *arguments)
        if sticking_time > 0 and min_force > -tolerance and hop_margin > 1.0 - MAX_FIRST_HOP:
            return k + 1, [], bool(lifts)
    extra_rows = []
    for time, speed in zip(hop_times, hop_speeds, strict=True):
        extra_rows.append((release_time + float(time), float(speed), side))
        arguments = (to_array(number) for number in (side, phase, time, speed))
        if _examine_compiled(scene, *arguments)[2] > 1.0 - MAX_FIRST_HOP:
            return len(chain), extra_rows, False
    return len(chain), [], False
