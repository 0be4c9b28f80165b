"""Certify the next event of a fast step: the wall that is hit and the time, or a step without contact.

The first Taylor coefficients of a lane's progress towards a wall and a bound on the remainder certify both. The margins
are much wider than any rounding error of a flight (docs/numbers.md). Times are in units of the longest step.
"""

from jax import lax

from ..compiled.compiler_hints import choose, maximum, minimum, positive_part, stage
from . import event
from .drive import harmonic_phasor
from .event import N_TERMS, Progress
from .fast_coefficients import GIVEN_UP
from .wall_motion import select_by_side, subtract

DOUBT_MARGIN = 2.0**-36  # distance to a wall, in largest lengths of a lane, below which a lane is in doubt
LANDING_MARGIN = 2.0**-16  # in longest steps; exceeds the time between the end of a landing step and its event
MIN_STEP = 2.0**-10  # in longest steps; a lane in doubt would take a shorter step that does not end at an event
BEYOND_EVENT = 2.0**-6  # in longest steps; the mass provably moves into the wall for this time after an event
JUMP_FRACTION = 0.9375  # fraction of the time to an event that is certain but too far away to land on


def next_event(coeffs, lanes, drive_forces):
    """Return (hit_side, contact time, safe time, remainder) of the next step.

    `hit_side` is 0 without a hit. The safe time is the step without contact, `GIVEN_UP` if it is too short. The
    remainder bounds the terms that the Taylor polynomial of x omits.
    """
    phasors = wall_phasors(coeffs, lanes)
    side = stage(_target_side, coeffs, lanes, drive_forces, phasors)
    remainder = stage(_free_remainder, coeffs, lanes, drive_forces)
    progress = _wall_progress(coeffs, lanes, drive_forces, phasors, side, remainder)
    other_step = None
    if len(coeffs.walls) == 2:
        if coeffs.has_fixed_walls:
            other_step = stage(
                _opposite_wall_step, coeffs, progress, stage(_cubic_bound, progress, sign=-1.0), lanes.largest_length
            )
        else:
            other_progress = _wall_progress(coeffs, lanes, drive_forces, phasors, -side, remainder)
            other_step = stage(
                _other_wall_step, other_progress, stage(_cubic_bound, other_progress, sign=1.0), lanes.largest_length
            )
    root_guess = stage(_root_guess, progress)
    root = stage(_refine_root, progress, root_guess)
    certainty = stage(_root_certainty, progress, root_guess, root)
    hit_side = stage(_hit_side, lanes, root, certainty, side, other_step)
    safe_time = stage(
        _safe_time,
        lanes,
        progress,
        stage(_cubic_bound, progress, sign=1.0),
        lanes.largest_length,
        root_guess,
        root,
        certainty,
        other_step,
    )
    return hit_side, root, safe_time, remainder


def wall_phasors(coeffs, lanes):
    """Return the phasor (cosine, sine) of each wall, None for a fixed wall."""
    return [
        None if wall_terms is None else stage(harmonic_phasor, wall, lanes.cosine, lanes.sine)
        for wall, wall_terms in zip(coeffs.walls, coeffs.wall_terms, strict=True)
    ]


def _free_term(coeffs, lanes, drive_forces, k):
    """Return the k-th Taylor coefficient of x in free flight."""
    if k < 2:
        return lanes.v if k else lanes.x
    series = coeffs.series
    coefficient = (
        series.p00_minus_1[k - 2] * lanes.x + series.p01[k - 1] * lanes.v + series.cos_response[k - 2] * drive_forces[0]
    )
    return coefficient - series.sin_response[k - 3] * drive_forces[1] if k > 2 else coefficient


def _wall_term(wall, wall_terms, phasor, k):
    """Return the k-th Taylor coefficient of a wall's position; None stands for zero."""
    if wall_terms is None:
        return None if k else wall.position
    oscillation = wall_terms[k] * phasor[k % 2]
    oscillation = -oscillation if k % 4 in (1, 2) else oscillation
    return oscillation if k else wall.position + oscillation


def _wall_term_on_side(coeffs, phasors, side, k):
    """Return the k-th Taylor coefficient of the position of the wall on a side."""
    walls = zip(coeffs.walls, coeffs.wall_terms, phasors, strict=True)
    return select_by_side(side, coeffs.walls, [_wall_term(*wall_args, k) for wall_args in walls])


def progress_term(coeffs, lanes, drive_forces, phasors, side, k):
    """Return the k-th Taylor coefficient of the progress towards the wall on a side."""
    return side * subtract(_free_term(coeffs, lanes, drive_forces, k), _wall_term_on_side(coeffs, phasors, side, k))


def _free_remainder(coeffs, lanes, drive_forces):
    """Return a bound on abs x^(7) / 7! over a step from the energy of x^(6), which damping lowers."""
    sixth_term, seventh_term = (_free_term(coeffs, lanes, drive_forces, k) for k in (N_TERMS - 1, N_TERMS))
    return lax.abs(seventh_term) + coeffs.sixth_term_weight * lax.abs(sixth_term) + coeffs.drive_remainder


def _wall_progress(coeffs, lanes, drive_forces, phasors, side, remainder):
    """Return the `event.Progress` towards the wall on a side."""
    terms = tuple(stage(progress_term, coeffs, lanes, drive_forces, phasors, side, k=k) for k in range(N_TERMS))
    if not coeffs.has_fixed_walls:
        remainder = stage(_add_wall_remainder, coeffs, side, remainder)
    return Progress(terms, remainder)


def _add_wall_remainder(coeffs, side, remainder):
    return remainder + select_by_side(side, coeffs.walls, coeffs.wall_remainders)


def _target_side(coeffs, lanes, drive_forces, phasors):
    """Return the side of the wall that the mass reaches first at its present velocity."""
    if len(coeffs.walls) == 1:
        return lax.full_like(lanes.x, float(coeffs.walls[0].sign))
    if coeffs.has_fixed_walls:
        direction = choose(lanes.v == 0, drive_forces[0] - coeffs.stiffness * lanes.x, lanes.v)
        return choose(direction < 0, lax.full_like(direction, -1.0), 1.0)
    walls = zip(coeffs.walls, coeffs.wall_terms, phasors, strict=True)
    (left_wall, right_wall) = ([_wall_term(*wall_args, k) for k in (0, 1)] for wall_args in walls)
    left_clearance, right_clearance = lanes.x - left_wall[0], right_wall[0] - lanes.x
    right_first = subtract(lanes.v, right_wall[1]) * left_clearance > -subtract(lanes.v, left_wall[1]) * right_clearance
    return choose(right_first, lax.full_like(left_clearance, 1.0), -1.0)


def _cubic_bound(progress, sign):
    """Return K >= 0 with sign G <= sign (g0 + g1 t + g2 t^2) + K t^3."""
    cubic_bound = progress.remainder
    for term in progress.terms[:2:-1]:
        cubic_bound = positive_part(sign * term + cubic_bound)
    return cubic_bound


def _safe_step(clearance, slope, curvature, cubic, max_time):
    """Return (n, d) of a step n / d <= max_time without contact.

    It uses G <= -clearance + slope t + curvature t^2 + cubic t^3.
    """
    max_curvature = curvature + cubic * max_time
    positive_curvature, approaches = positive_part(max_curvature), slope >= 0
    stays_clear = (clearance >= max_time * (slope + positive_curvature * max_time)) | (
        (max_curvature < 0) & (slope * slope <= -4.0 * max_curvature * clearance)
    )
    numerator = choose(approaches, clearance, maximum(clearance, -slope * max_time))
    denominator = choose(approaches, slope, 0.0) + positive_curvature * max_time
    return choose(stays_clear, max_time, numerator), choose(stays_clear, 1.0, denominator)


def _other_wall_step(progress, cubic, largest_length):
    """Return the `_safe_step` for the other wall."""
    terms = progress.terms
    return _safe_step(
        positive_part(-terms[0] - DOUBT_MARGIN * largest_length), terms[1], terms[2], cubic, lax.full_like(cubic, 1.0)
    )


def _opposite_wall_step(coeffs, progress, cubic, largest_length):
    """Return the `_safe_step` for the other of two fixed walls, from the progress towards the target wall."""
    terms = progress.terms
    return _safe_step(
        positive_part(coeffs.wall_gap + terms[0] - DOUBT_MARGIN * largest_length),
        -terms[1],
        -terms[2],
        cubic,
        lax.full_like(cubic, 1.0),
    )


def _root_guess(progress):
    """Return the first root of the first three terms, or minus the time of their closest approach if there is none."""
    terms = progress.terms
    approaches, discriminant = terms[1] > 0, terms[1] * terms[1] - 4.0 * terms[2] * terms[0]
    root_sum = lax.abs(terms[1]) + lax.sqrt(positive_part(discriminant))
    time = choose(approaches, -2.0 * terms[0], root_sum) / choose(approaches, root_sum, 2.0 * terms[2])
    return choose((discriminant >= 0) & (approaches | (terms[2] > 0)), time, -lax.abs(time))


def _refine_root(progress, root_guess):
    """Improve the root of the quadratic by one Halley step and one Newton step with the earlier slope."""
    value, slope, half_curvature = _polynomial_derivs(progress.terms, root_guess)
    halley_factor = slope / (slope * slope - value * half_curvature)
    root = root_guess - value * halley_factor
    return root - event.horner_with_slope(progress.terms, root)[0] * halley_factor


def _polynomial_derivs(terms, time):
    """Evaluate a polynomial, its slope and half its second derivative."""
    value, slope, half_curvature = terms[-1] * time + terms[-2], terms[-1], lax.full_like(time, 0.0)
    for coefficient in terms[-3::-1]:
        half_curvature = half_curvature * time + slope
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope, half_curvature


def _root_certainty(progress, root_guess, root):
    """Return 2 if a step may land on the root, 1 if it is certain to a sixteenth of the time to it, 0 otherwise.

    A root is certain if G rises with at least a fifth of its slope up to `BEYOND_EVENT` after it. Then no earlier root
    exists. The residual of the polynomial, less its rounding error, bounds the distance to the true root.
    """
    terms, remainder = progress.terms, progress.remainder
    horizon = root * event.ROOT_MARGIN + BEYOND_EVENT
    slope_bound = event.slope_lower_bound(progress, horizon)
    root_cubed, (residual, _) = root * root * root, event.horner_with_slope(terms, root)
    rounding_noise = event.ROUNDING_FACTOR * event.unit_roundoff(root.dtype) * (terms[1] * root - terms[0])
    root_error = remainder * (root_cubed * root_cubed) + positive_part(lax.abs(residual) - rounding_noise)
    is_certain = (root_guess >= 0) & (horizon <= 1.0) & (terms[1] > 0) & (slope_bound > 0.2 * terms[1]) & (root >= 0)
    is_accurate = (
        root_error * (lax.abs(terms[2]) + terms[1]) < event.landing_tolerance(root.dtype) * terms[1] * slope_bound
    )
    ones = lax.full_like(root, 1.0)
    return choose(
        is_certain & is_accurate,
        2.0,
        choose(is_certain & (root_error < (1.0 - JUMP_FRACTION) * slope_bound * root), ones, 0.0),
    )


def _hit_side(lanes, root, certainty, side, other_step):
    """Return the side of the wall hit at the root, or 0 if the root is inaccurate or not the next event."""
    is_hit = (certainty > 1.5) & (root + LANDING_MARGIN <= lanes.time_remaining)
    if other_step is not None:
        is_hit &= root * other_step[1] <= other_step[0]
    return choose(is_hit, side, 0.0)


def _safe_time(lanes, progress, cubic, largest_length, root_guess, root, certainty, other_step):
    """Return a step without contact from one division, or GIVEN_UP if it is too short."""
    terms = progress.terms
    horizon = 2.0 * lax.abs(root_guess)
    numerator, denominator = _safe_step(
        positive_part(-terms[0] - DOUBT_MARGIN * largest_length),
        terms[1],
        terms[2],
        cubic,
        choose(horizon < 1.0, horizon, 1.0),
    )
    is_certain = certainty > 0.5
    numerator = choose(is_certain, choose(certainty > 1.5, root - LANDING_MARGIN, JUMP_FRACTION * root), numerator)
    denominator = choose(is_certain, 1.0, denominator)
    if other_step is not None:
        is_shorter = numerator * other_step[1] < other_step[0] * denominator
        numerator, denominator = (
            choose(is_shorter, numerator, other_step[0]),
            choose(is_shorter, denominator, other_step[1]),
        )
    time = minimum(numerator / denominator, lanes.time_remaining)
    return choose((time >= MIN_STEP) | (time >= lanes.time_remaining), time, GIVEN_UP)
