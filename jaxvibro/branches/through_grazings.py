"""Continue a branch through grazings, from segment to segment."""

import warnings

import numpy as np

from continuation.branch_segment import SpecialIndex
from continuation.slow_progress import SlowProgressWarning

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.branches_from_grazing import GrazingPoint
from ..problem.end import End
from ..problem.orbit_equations import sides_with_release_codes
from ..problem.orbit_equivalence import comparison_points, is_repeated
from .itinerary_segment import follow_itinerary
from .through_sticking import SLOW_SPEED, has_very_slow_impact, locate_nearby_chatter, reselect_bounce_rows

MAX_SEGMENTS = 200
CROWD_SIZE, CROWD_WIDTH = (
    16,
    1e-5,
)  # consecutive grazings within this width, relative to 1 + abs(parameter), give a warning
CHATTER_SPEED = 1e-2  # scene's lengths per t; without an exit, a slower impact indicates chatter
VALUE_TOLERANCE, IMPACT_TOLERANCE = 1e-7, 1e-6  # largest differences of identical grazings


def continue_through_grazings(task, start):
    """Follow a branch in one direction, from one itinerary to the next.

    Parameters
    ----------
    task : ContinuationTask
        Task of the branch, as `follow.make_branch_task` makes it.
    start : Point
        First point; the branch is followed along its tangent.

    Returns
    -------
    segments : list of BranchSegment
        Segments in order from the start.
    reason : EndReason
        Reason for the end of the last segment.
    """
    problem, segments, known_grazings, chatter_specials = task.args, [], [], ()
    while True:
        segment = follow_itinerary(task, problem, start)
        segment = segment._replace(specials=(*chatter_specials, *segment.specials))
        grazing_exit, chatter_specials = None, ()
        task = task._replace(limits=task.limits.after_points(len(segment.points.z)))
        if segment.end is End.GRAZE and task.limits.is_reached(1):
            segment = segment._replace(end=End.MAX_SECONDS if task.limits.expired else End.MAX_POINTS)
        if segment.end is End.GRAZE:
            segment, grazing_exit = _choose_exit(problem, segment, problem.weights())
            z = segment.points.z[-1]
            grazing_key = z[-1], comparison_points(problem, z, problem.length_scale)
            if any(_is_same_grazing(grazing_key, known_grazing) for known_grazing in known_grazings):
                segment, grazing_exit = segment._replace(end=End.CLOSED), None
            elif is_repeated(problem, z):
                segment, grazing_exit = segment._replace(end=End.HALVED), None
            elif segment.specials[-1].kind == "GR" and _has_slow_impact(
                problem, segment, SLOW_SPEED if grazing_exit else CHATTER_SPEED
            ):
                sign = np.sign(segment.points.tangent[-1, -1])
                chatter_result = locate_nearby_chatter(problem, z, sign, task.limits)
                if chatter_result is None and task.limits.expired:
                    segment, grazing_exit = segment._replace(end=End.MAX_SECONDS), None
                else:
                    segment, grazing_exit, chatter_specials = _enter_sticking(
                        segment, chatter_result, grazing_exit is not None
                    )
            known_grazings.append(grazing_key)
        if segment.end is End.STEP:
            sign = np.sign(segment.points.tangent[-1, -1])
            grazing_exit = reselect_bounce_rows(problem, segment.points.z[-1], sign)
        if len(segments) == MAX_SEGMENTS - 1 and grazing_exit is not None:
            segment, grazing_exit = segment._replace(end=End.POINTS), None
        segments.append(segment)
        _warn_of_slow_progress(segments)
        if grazing_exit is None:
            kind = segment.specials[-1].kind if segment.specials else ""
            return segments, segment.end.reason(segment.points.z[-1, -1], kind)
        problem, start = grazing_exit.problem, grazing_exit.point


def _warn_of_slow_progress(segments):
    """Warn if many consecutive grazings lie at nearly one value of the parameter."""
    values = np.array([segment.points.z[-1, -1] for segment in segments[-CROWD_SIZE:]])
    if len(segments) % CROWD_SIZE == 0 and np.ptp(values) < CROWD_WIDTH * (1.0 + abs(values[-1])):
        warnings.warn(
            f"slow progress: {CROWD_SIZE} grazings lie within {np.ptp(values):.1e} of the parameter value"
            f" {values[-1]:.12g},"
            " as towards a complete chatter; set max_points or max_seconds, or narrow the bounds",
            SlowProgressWarning,
            stacklevel=2,
        )


def _choose_exit(problem, segment, weights):
    """Return the segment and the `BranchFromGrazing` along which the branch continues, None if there is none.

    The details of the last special point record which exits are not followed. The branch continues with the grazing
    contacts exchanged as far as possible: impacts become omitted contacts and vice versa.
    """
    special_record, grazing_point = segment.specials[-1], segment.specials[-1].detector_details
    is_contact_included = tuple(contact.is_impact for contact in grazing_point.grazing_contacts)
    arrival_tangent, row_side_codes = segment.points.tangent[-1], sides_with_release_codes(problem.sequence)

    def is_backward(grazing_exit):
        is_same_problem = grazing_exit.inclusion_mask == is_contact_included and np.array_equal(
            sides_with_release_codes(grazing_exit.problem.sequence), row_side_codes
        )
        return is_same_problem and np.sum(weights * weights * grazing_exit.point.tangent * arrival_tangent) < 0

    def exchange_key(grazing_exit):
        has_same_contacts = grazing_exit.inclusion_mask == is_contact_included
        return has_same_contacts, sum(
            is_in_exit != is_in_segment
            for is_in_exit, is_in_segment in zip(grazing_exit.inclusion_mask, is_contact_included, strict=True)
        )

    chosen_exit = max(
        (grazing_exit for grazing_exit in grazing_point.exits if not is_backward(grazing_exit)),
        key=exchange_key,
        default=None,
    )
    is_not_followed = tuple(
        not (grazing_exit is chosen_exit or is_backward(grazing_exit)) for grazing_exit in grazing_point.exits
    )
    special_records = (
        *segment.specials[:-1],
        special_record._replace(detector_details=grazing_point._replace(not_followed=is_not_followed)),
    )
    end = segment.end if chosen_exit or grazing_point.complete else End.STEP
    return segment._replace(
        specials=special_records, end=End.UNSETTLED if not chosen_exit and special_record.kind != "GR" else end
    ), chosen_exit


def _enter_sticking(segment, chatter_result, has_exit):
    """Return the segment, the exit, and the special points at the start of the next segment, close to a CH.

    `chatter_result` is the result of `locate_nearby_chatter`.
    """
    if chatter_result is None:
        return segment._replace(end=End.CHATTER if has_exit else segment.end), None, ()
    grazing_exit, residual = chatter_result
    return segment, grazing_exit, (SpecialIndex(0, "CH", residual, GrazingPoint((), (grazing_exit,), True, (False,))),)


def _has_slow_impact(problem, segment, max_speed):
    """Test whether an impact other than the grazing contacts is slower than `max_speed` at the end of a segment."""
    return has_very_slow_impact(
        problem, segment.points.z[-1], segment.specials[-1].detector_details.grazing_contacts, max_speed
    )


def _is_same_grazing(grazing_key, known_grazing):
    """Test whether two grazings, given as (value, impacts), are identical."""
    return abs(grazing_key[0] - known_grazing[0]) < VALUE_TOLERANCE and is_same_orbit(
        grazing_key[1], known_grazing[1], IMPACT_TOLERANCE
    )
