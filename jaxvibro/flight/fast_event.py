"""Certify the next event of a fast step: the wall that is hit and the time, or a step without contact.

The certificates use the first Taylor coefficients of G, the negative clearance of a wall (`event_certificates`), and a
bound on the remainder. Their margins are much wider than any rounding error of a flight (docs/numbers.md). Times are in
units of the longest step.
"""

from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose, minimum, positive_part
from . import event_certificates
from .event_certificates import (
    N_TERMS,
    EventPolynomial,
    UpperCubic,
    cubic_coefficient_bound,
    safe_step_ratio,
)
from .fast_coefficients import GIVEN_UP
from .further_drive_terms import harmonic_phasor
from .wall_motion import select_by_side, subtract_optional

DOUBT_MARGIN = 2.0**-36  # distance to a wall, in largest lengths of a lane, below which a lane is in doubt
LANDING_MARGIN = 2.0**-16  # in longest steps; exceeds the time between the end of a landing step and its event
MIN_STEP = 2.0**-10  # in longest steps; a lane in doubt would take a shorter step that does not end at an event
BEYOND_EVENT = 2.0**-6  # in longest steps; the mass provably moves into the wall for this time after an event
JUMP_FRACTION = 0.9375  # fraction of the time to an event that is certain but too far away to land on


def certify_next_event(coeffs, lane_states, drive_forces):
    """Return (hit side, contact time, safe time, bound on the remainder) of the next step.

    The hit side is 0 without a hit. The safe time is the length of a step without contact, or `GIVEN_UP` if this length
    is too short. The bound limits the terms that the Taylor polynomial of x omits.
    """
    wall_phasors = compute_wall_phasors(coeffs, lane_states)
    target_side = call_without_inlining(_target_side, coeffs, lane_states, drive_forces, wall_phasors)
    remainder_bound = call_without_inlining(_flight_remainder_bound, coeffs, lane_states, drive_forces)
    event_polynomial = _wall_event_polynomial(
        coeffs, lane_states, drive_forces, wall_phasors, target_side, remainder_bound
    )
    other_wall_num_denom = None
    if len(coeffs.walls) == 2:
        other_polynomial, sign, wall_gap = event_polynomial, -1.0, coeffs.wall_gap
        if not coeffs.has_fixed_walls:
            sign, wall_gap = 1.0, None
            other_polynomial = _wall_event_polynomial(
                coeffs, lane_states, drive_forces, wall_phasors, -target_side, remainder_bound
            )
        other_wall_num_denom = call_without_inlining(
            _other_wall_num_denom,
            other_polynomial,
            call_without_inlining(cubic_coefficient_bound, other_polynomial, sign=sign),
            lane_states.largest_length,
            wall_gap,
        )
    root_guess = call_without_inlining(_root_guess, event_polynomial)
    root = call_without_inlining(_refine_root, event_polynomial, root_guess)
    root_certainty = call_without_inlining(_root_certainty_level, event_polynomial, root_guess, root)
    hit_side = call_without_inlining(_hit_side, lane_states, root, root_certainty, target_side, other_wall_num_denom)
    safe_time = call_without_inlining(
        _safe_time,
        lane_states,
        event_polynomial,
        call_without_inlining(cubic_coefficient_bound, event_polynomial),
        lane_states.largest_length,
        root_guess,
        root,
        root_certainty,
        other_wall_num_denom,
    )
    return hit_side, root, safe_time, remainder_bound


def compute_wall_phasors(coeffs, lane_states):
    """Return the phasor (cosine, sine) of each wall, None for a fixed wall."""
    return [
        None
        if taylor_factors is None
        else call_without_inlining(harmonic_phasor, wall, lane_states.cosine, lane_states.sine)
        for wall, taylor_factors in zip(coeffs.walls, coeffs.wall_taylor_factors, strict=True)
    ]


def _free_flight_term(coeffs, lane_states, drive_forces, k):
    """Return the k-th Taylor coefficient of x in free flight."""
    if k < 2:
        return lane_states.v if k else lane_states.x
    series = coeffs.series
    coefficient = (
        series.p00_minus_1[k - 2] * lane_states.x
        + series.p01[k - 1] * lane_states.v
        + series.cos_response[k - 2] * drive_forces[0]
    )
    return coefficient - series.sin_response[k - 3] * drive_forces[1] if k > 2 else coefficient


def _wall_position_term(wall, taylor_factors, wall_phasor, k):
    """Return the k-th Taylor coefficient of a wall's position; None stands for zero."""
    if taylor_factors is None:
        return None if k else wall.position
    oscillation_term = taylor_factors[k] * wall_phasor[k % 2]
    oscillation_term = -oscillation_term if k % 4 in (1, 2) else oscillation_term
    return oscillation_term if k else wall.position + oscillation_term


def _wall_term_on_side(coeffs, wall_phasors, side, k):
    """Return the k-th Taylor coefficient of the position of the wall on a side."""
    walls = zip(coeffs.walls, coeffs.wall_taylor_factors, wall_phasors, strict=True)
    return select_by_side(
        side, coeffs.walls, [_wall_position_term(*position_term_args, k) for position_term_args in walls]
    )


def event_polynomial_term(coeffs, lane_states, drive_forces, wall_phasors, side, k):
    """Return the k-th Taylor coefficient of G, the negative clearance of the wall on a side."""
    return side * subtract_optional(
        _free_flight_term(coeffs, lane_states, drive_forces, k), _wall_term_on_side(coeffs, wall_phasors, side, k)
    )


def _flight_remainder_bound(coeffs, lane_states, drive_forces):
    """Return a bound on ``|x^(7)| / 7!`` over a step, from the energy of x^(6), which damping lowers."""
    sixth_term, seventh_term = (_free_flight_term(coeffs, lane_states, drive_forces, k) for k in (N_TERMS - 1, N_TERMS))
    return lax.abs(seventh_term) + coeffs.sixth_term_weight * lax.abs(sixth_term) + coeffs.drive_remainder_bound


def _wall_event_polynomial(coeffs, lane_states, drive_forces, wall_phasors, side, remainder_bound):
    """Return the `event_certificates.EventPolynomial` towards the wall on a side."""
    terms = tuple(
        call_without_inlining(event_polynomial_term, coeffs, lane_states, drive_forces, wall_phasors, side, k=k)
        for k in range(N_TERMS)
    )
    if not coeffs.has_fixed_walls:
        remainder_bound = call_without_inlining(_include_wall_remainder, coeffs, side, remainder_bound)
    return EventPolynomial(terms, remainder_bound)


def _include_wall_remainder(coeffs, side, remainder_bound):
    return remainder_bound + select_by_side(side, coeffs.walls, coeffs.wall_remainder_bounds)


def _target_side(coeffs, lane_states, drive_forces, wall_phasors):
    """Return the side of the wall that the mass reaches first at its present velocity.

    Between fixed walls a mass without velocity has the target towards which the force accelerates it.
    """
    if len(coeffs.walls) == 1:
        return lax.full_like(lane_states.x, float(coeffs.walls[0].sign))
    if coeffs.has_fixed_walls:
        velocity_or_force = choose(
            lane_states.v == 0, drive_forces[0] - coeffs.stiffness * lane_states.x, lane_states.v
        )
        return choose(velocity_or_force < 0, lax.full_like(velocity_or_force, -1.0), 1.0)
    walls = zip(coeffs.walls, coeffs.wall_taylor_factors, wall_phasors, strict=True)
    (left_wall, right_wall) = (
        [_wall_position_term(*position_term_args, k) for k in (0, 1)] for position_term_args in walls
    )
    left_clearance, right_clearance = lane_states.x - left_wall[0], right_wall[0] - lane_states.x
    reaches_right_first = (
        subtract_optional(lane_states.v, right_wall[1]) * left_clearance
        > -subtract_optional(lane_states.v, left_wall[1]) * right_clearance
    )
    return choose(reaches_right_first, lax.full_like(left_clearance, 1.0), -1.0)


def _other_wall_num_denom(event_polynomial, cubic_coefficient, largest_length, wall_gap):
    """Return the `event_certificates.safe_step_ratio` for the wall that is not the target.

    Between fixed walls `scene_checks` is their distance, and the polynomial is that towards the target. Otherwise
    `scene_checks` is None, and the polynomial is that towards the other wall.
    """
    terms = event_polynomial.terms
    clearance, slope, curvature = -terms[0], terms[1], terms[2]
    if wall_gap is not None:
        clearance, slope, curvature = wall_gap + terms[0], -terms[1], -terms[2]
    clearance = positive_part(clearance - DOUBT_MARGIN * largest_length)
    return safe_step_ratio(UpperCubic(clearance, slope, curvature, cubic_coefficient), 1.0)


def _root_guess(event_polynomial):
    """Return the first root of the first three terms, or minus a time near their extremum if there is no root."""
    terms = event_polynomial.terms
    has_root, time = event_certificates.quadratic_root(-terms[0], terms[1], terms[2])
    return choose(has_root, time, -lax.abs(time))


def _refine_root(event_polynomial, root_guess):
    """Improve the root of the quadratic by one Halley step and a second step with the same factor."""
    value, slope, half_curvature = _polynomial_derivs(event_polynomial.terms, root_guess)
    halley_inverse_slope = slope / (slope * slope - value * half_curvature)
    root = root_guess - value * halley_inverse_slope
    return root - event_certificates.horner_with_slope(event_polynomial.terms, root)[0] * halley_inverse_slope


def _polynomial_derivs(terms, time):
    """Evaluate a polynomial, its slope and half its second derivative."""
    value, slope, half_curvature = terms[-1] * time + terms[-2], terms[-1], lax.full_like(time, 0.0)
    for coefficient in terms[-3::-1]:
        half_curvature = half_curvature * time + slope
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope, half_curvature


def _root_certainty_level(event_polynomial, root_guess, root):
    """Return 2 if a step may end at the root, 1 if the root is certain to within a sixteenth of its time, else 0.

    See `event_certificates.certify_root`. No other root may occur up to `BEYOND_EVENT` after the margin of the root.
    """
    terms = event_polynomial.terms
    is_certain, residual_bound, slope_bound = event_certificates.certify_root(
        event_polynomial, root_guess, root, BEYOND_EVENT
    )
    is_accurate = (
        residual_bound * (lax.abs(terms[2]) + terms[1])
        < event_certificates.landing_time_tolerance(root.dtype) * terms[1] * slope_bound
    )
    ones = lax.full_like(root, 1.0)
    return choose(
        is_certain & is_accurate,
        2.0,
        choose(is_certain & (residual_bound < (1.0 - JUMP_FRACTION) * slope_bound * root), ones, 0.0),
    )


def _hit_side(lane_states, root, root_certainty, target_side, other_wall_num_denom):
    """Return the side of the wall hit at the root, or 0 if the root is inaccurate or not the next event."""
    is_hit = (root_certainty > 1.5) & (root + LANDING_MARGIN <= lane_states.time_remaining)
    if other_wall_num_denom is not None:
        is_hit &= root * other_wall_num_denom[1] <= other_wall_num_denom[0]
    return choose(is_hit, target_side, 0.0)


def _safe_time(
    lane_states,
    event_polynomial,
    cubic_coefficient,
    largest_length,
    root_guess,
    root,
    root_certainty,
    other_wall_num_denom,
):
    """Return the length of a step without contact, or GIVEN_UP if this length is too short."""
    terms = event_polynomial.terms
    horizon = 2.0 * lax.abs(root_guess)
    clearance = positive_part(-terms[0] - DOUBT_MARGIN * largest_length)
    upper_cubic = UpperCubic(clearance, terms[1], terms[2], cubic_coefficient)
    numerator, denominator = safe_step_ratio(upper_cubic, choose(horizon < 1.0, horizon, 1.0))
    is_certain = root_certainty > 0.5
    numerator = choose(is_certain, choose(root_certainty > 1.5, root - LANDING_MARGIN, JUMP_FRACTION * root), numerator)
    denominator = choose(is_certain, 1.0, denominator)
    if other_wall_num_denom is not None:
        is_target_step_shorter = numerator * other_wall_num_denom[1] < other_wall_num_denom[0] * denominator
        numerator, denominator = (
            choose(is_target_step_shorter, numerator, other_wall_num_denom[0]),
            choose(is_target_step_shorter, denominator, other_wall_num_denom[1]),
        )
    time = minimum(numerator / denominator, lane_states.time_remaining)
    return choose((time >= MIN_STEP) | (time >= lane_states.time_remaining), time, GIVEN_UP)
