"""Find the loci that emanate from a point of codimension two, and the start of each.

- RG: with the grazing contact as an impact of speed s, the equations of the orbit reduce to ``g = mu + phi s + kappa
  s^2 / 2 = 0``. mu vanishes on the GR, phi vanishes at the RG, and kappa is not zero. This equation is singular at ``s
  = -phi / kappa`` (SN). For the orbit traversed twice, it is singular with another value of kappa (PD; SB of a
  symmetric orbit). The loci of SN and PD are smooth curves with the parameter s, and are quadratically tangent to the
  GR. Orbits with ``s < 0`` are inadmissible (Simpson and Ghosh, arXiv 2602.22797).
- GPD, DSB: the two halves of the orbit differ by s along the null vector, with ``nu + c s^2 + d s^4 = 0``. nu vanishes
  on the PD or SB, and c vanishes at the GPD or DSB. The pair of orbits folds at ``nu = c^2 / 4 d``. This fold is a
  single SN, quadratically tangent to the PD or SB. Let M be the monodromy matrix of the orbit, or of one half at a DSB.
  One multiplier of the pair is near 1. The other is near the square of det M, which is less than 1 in a damped scene.
  Therefore no other bifurcation is near.
- SN, PD, SB on a GR: the orbit without the grazing contact is singular. The locus of this kind is admissible on the
  side on which the contact opens. The other orbits that meet there (the second orbit of the SN, or the pair of the PD
  or SB) graze the wall along a curve that is quadratically tangent to this locus (Colombo and Dercole, SIAM J. Appl.
  Dyn. Syst. 9, 62, 2010). At an SN this curve is the GR itself, on both sides of the point. At a PD or SB this curve is
  another GR.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import augmented_systems
from continuation import branch_point_tangents as crossing
from continuation.arclength import make_start_point
from continuation.branch_segment import SpecialIndex
from continuation.point_rows import map_fields

from ..problem.end import End
from ..problem.grazing_contact import are_admissible
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_problem import SINGULAR_RATIO
from ..problem.soft_wall_grazing import is_smooth_soft_wall
from ..scene import check
from .grazing_switchover import opposite_directions, track_across_walls
from .locus_start import (
    LocusStart,
    check_locus_arguments,
    forward_locus_directions,
    make_locus_task,
    orbit_stays_symmetric,
    problems_at_locus_start,
)
from .locus_tracking import LocusDirection, track_locus

NULL_VECTOR_STEPS = (0.1, 0.05, 0.02, 0.01, 0.005)  # distances along the null vector at which the SN of a pair starts
STEP_FRACTIONS = (1.0, 0.1, 0.01)  # fractions of the first step at which another locus starts
DIFFERENCE_STEP = 1e-4  # along the unit null vector: step of central differences


class LocusSeed(NamedTuple):
    """Start of a locus that emanates from a point.

    Attributes
    ----------
    start : LocusStart
        Special point at which the locus starts.
    special_index : SpecialIndex
        Point of codimension two as a special point of this locus.
    forward_direction : LocusDirection
        Direction in which the locus leaves the point.
    backward_direction : LocusDirection or None
        Opposite direction. None if the locus begins at the point.
    origin_z : numpy.ndarray or None
        z of the point if `forward_direction` begins at a small distance from the point, else None.
    """

    start: LocusStart
    special_index: SpecialIndex
    forward_direction: LocusDirection
    backward_direction: LocusDirection | None = None
    origin_z: Float[np.ndarray, " unknowns"] | None = None


def find_locus_seeds(codim2_point, bounds, *step_settings):
    """Return the `LocusSeed` of each locus that emanates from a `Codim2`, except the locus on which it was located.

    Raises ArgumentError if a start cannot be located.
    """
    locus_arguments = tuple(codim2_point.values), bounds, *step_settings
    if codim2_point.kind in ("GPD", "DSB"):
        return [_pair_fold_seed(codim2_point, *locus_arguments)]
    grazing_contacts = LocusStart("GR", *_locus_start_fields(codim2_point)).grazing_contacts
    impact_contacts = [contact for contact in grazing_contacts if contact.is_impact]
    if codim2_point.on == "GR":
        seeds, is_resonant_grazing, kind = [], codim2_point.kind == "RG", codim2_point.kind
    else:
        seeds, is_resonant_grazing, kind = (
            [],
            any(not is_smooth_soft_wall(codim2_point.scene, contact.side) for contact in impact_contacts),
            codim2_point.on,
        )
        seeds.append(_grazing_seed(codim2_point, "RG" if is_resonant_grazing else kind, *locus_arguments))
    if is_resonant_grazing:
        is_symmetric = orbit_stays_symmetric(LocusStart("SN", *_locus_start_fields(codim2_point)), locus_arguments[0])
        kinds = (kind for kind in ("SN", "SB" if is_symmetric else "PD") if kind != codim2_point.on)
        return seeds + [
            _contact_opening_seed(codim2_point, kind, codim2_point.spot, *locus_arguments) for kind in kinds
        ]
    if codim2_point.on == "GR":
        orbit_without_contact = _orbit_without_impacts(codim2_point.spot, [contact.row for contact in impact_contacts])
        seeds.append(_contact_opening_seed(codim2_point, kind, orbit_without_contact, *locus_arguments))
    return seeds if kind == "SN" else [*seeds, _pair_grazing_seed(codim2_point, kind, *locus_arguments)]


def _locus_start_fields(codim2_point, orbit_point=None):
    """Return the fields of a `LocusStart` other than its kind."""
    return next(iter(codim2_point.values)), codim2_point.scene, orbit_point or codim2_point.spot


def _orbit_without_impacts(orbit_point, rows):
    """Return an `OrbitPoint` without its impacts in the given rows."""
    remaining_rows = np.delete(np.arange(orbit_point.problem.n_used_rows), rows)
    problem, z = orbit_point.problem.with_rows(orbit_point.z, remaining_rows)
    return orbit_point._replace(problem=problem, z=z)


def _grazing_seed(codim2_point, kind, names, bounds, *step_settings):
    """Return the `LocusSeed` of the GR on which another locus ends; `kind` is the kind of the point on the GR."""
    locus_start = LocusStart("GR", *_locus_start_fields(codim2_point))
    return LocusSeed(
        locus_start,
        _special_record_of(codim2_point, kind),
        *opposite_directions(locus_start, names, bounds, *step_settings),
    )


def _special_record_of(codim2_point, kind):
    return SpecialIndex(0, kind, codim2_point.residual)


def _contact_opening_seed(codim2_point, kind, orbit_point, names, bounds, *step_settings):
    """Return the `LocusSeed` of the locus of a kind along which the contacts of a point open or gain speed."""
    locus_start = LocusStart(kind, *_locus_start_fields(codim2_point, orbit_point))
    (locus_direction,) = forward_locus_directions(locus_start, names, bounds, *step_settings)
    return _seed_from_direction(
        locus_start, _special_record_of(codim2_point, "GR"), _admissible_direction(locus_direction)
    )


def _admissible_direction(locus_direction):
    candidates = [candidate for candidate in (locus_direction, locus_direction.reverse()) if candidate.is_admissible]
    if len(candidates) != 1:
        rule = "must be a point from which the locus emanates in exactly one admissible direction"
        raise check.ArgumentError("special", rule, len(candidates))
    return candidates[0]


def _doubled_orbit(orbit_point, kind):
    """Return the orbit traversed twice, or at an SB the orbit itself.

    On the locus that emanates, the two halves of this orbit may differ.
    """
    if kind == "SB":
        return orbit_point
    problem, z = orbit_point.problem.repeat(orbit_point.z, 2)
    return orbit_point._replace(problem=problem, z=z)


def _pair_grazing_seed(codim2_point, kind, names, bounds, *step_settings):
    """Return the `LocusSeed` of the GR of the pair of orbits that emanates from a PD or SB on a grazing.

    Two solution curves of the equations of the GR cross at the point. The GR of the pair is the curve along which the
    two halves of the orbit differ.
    """
    locus_start = LocusStart("GR", *_locus_start_fields(codim2_point, _doubled_orbit(codim2_point.spot, kind)))
    problem, z = problems_at_locus_start(locus_start, names, use_whole_orbit=True)[0]
    direction = _direction_at(codim2_point, problem, z, names, bounds, step_settings)
    try:
        crossing_tangents = crossing.branch_tangents(problem.equations, z, direction.task.control.scale, problem)
    except ValueError:
        raise check.ArgumentError("special", "must be a point at which loci of GR cross", kind) from None
    speed_slopes = crossing_tangents[:, problem.n_rows + problem.impact_rows]
    half_speed_differences = abs(speed_slopes - np.roll(speed_slopes, len(problem.impact_rows) // 2, axis=1)).max(
        axis=1
    )
    return _seed_from_direction(
        locus_start,
        _special_record_of(codim2_point, kind),
        _admissible_direction(direction.from_point(z, crossing_tangents[np.argmax(half_speed_differences)])),
    )


def _pair_fold_seed(codim2_point, names, bounds, *step_settings):
    """Return the `LocusSeed` of the SN of the pair of orbits that emanates from a GPD or DSB."""
    orbit_point = _doubled_orbit(codim2_point.spot, {"GPD": "PD", "DSB": "SB"}[codim2_point.kind])
    locus_start = LocusStart("SN", *_locus_start_fields(codim2_point, orbit_point))
    ((problem, z),) = problems_at_locus_start(locus_start, names, use_whole_orbit=True)
    direction = _direction_at(codim2_point, problem, z, names, bounds, step_settings)
    special_record = _special_record_of(codim2_point, codim2_point.kind)
    for nearby_point in _pair_fold_guesses(problem, z, direction.task.control):
        if _is_admissible_point(direction.task, nearby_point):
            nearby_direction = direction.from_point(nearby_point.z, nearby_point.tangent)
            return LocusSeed(locus_start, special_record, nearby_direction, origin_z=z)
    raise check.ArgumentError(
        "special", "must be a point near which the SN of the pair can be located", codim2_point.kind
    )


def _direction_at(codim2_point, problem, z, names, bounds, step_settings):
    """Return the `LocusDirection` of a locus that crosses a point singularly; its tangent is not known yet."""
    names, bounds = check_locus_arguments(codim2_point.scene, names, bounds, *step_settings[:3])
    task = make_locus_task(codim2_point.scene, problem, z, names, bounds, *step_settings)
    return LocusDirection(task, make_start_point(z, np.zeros(len(z))), names, bounds)


def _is_admissible_point(task, nearby_point):
    """Check that a `Point` has converged, is within the bounds and has an admissible orbit."""
    problem = task.args
    is_within_bounds = all(
        lower <= value <= upper for value, (lower, upper) in zip(nearby_point.z[-2:], task.bounds, strict=True)
    )
    return bool(
        nearby_point.converged
        and is_within_bounds
        and are_admissible(problem, nearby_point.z, diagnose(problem, nearby_point.z[None]))[0]
    )


def _seed_from_direction(locus_start, special_record, locus_direction):
    """Return the `LocusSeed` of a direction from a point.

    If possible, the seed begins at a small distance from the point. At the point itself the determinant of the
    equations may vanish, because an impact has zero speed or because another curve crosses. The continuation would then
    mistake a step from the point for a jump.
    """
    problem, task = locus_direction.problem, locus_direction.task
    for fraction in STEP_FRACTIONS:
        nearby_point = problem.take_step(locus_direction.start, fraction * task.first_step, task.control)
        if _is_admissible_point(task, nearby_point):
            nearby_direction = locus_direction.from_point(nearby_point.z, nearby_point.tangent)
            return LocusSeed(locus_start, special_record, nearby_direction, origin_z=locus_direction.start.z)
    return LocusSeed(locus_start, special_record, locus_direction)


def _pair_fold_guesses(problem, z, step_control):
    """Yield candidates for a `Point` on the SN of a pair of orbits, at small distances s along the null vector v.

    Newton's method starts from the second-order expansion ``u + s v + s^2 h`` of the pair at the parameters of the
    point. The Newton matrix is of order s^3, and the error of the expansion is of order s^5.
    """
    n_unknowns = problem.n_orbit_unknowns
    arclength_weights = step_control.scale[:n_unknowns]
    _, derivative = problem.evaluate(z)
    jacobian = derivative[:n_unknowns, :n_unknowns]
    null_vector = augmented_systems.null_vector(jacobian)
    null_vector = null_vector / np.linalg.norm(arclength_weights * null_vector)
    null_vector = null_vector * np.sign(null_vector[np.flatnonzero(abs(null_vector) > 0.5 * abs(null_vector).max())[0]])
    null_z_direction = np.append(null_vector, [0.0, 0.0])
    shifted_jacobians = augmented_systems.jacobians_at(
        problem.equations, z + DIFFERENCE_STEP * np.stack([null_z_direction, -null_z_direction]), problem
    )[:, :n_unknowns, :n_unknowns]
    second_order_shift = np.linalg.lstsq(
        jacobian, -0.25 / DIFFERENCE_STEP * (shifted_jacobians[0] - shifted_jacobians[1]) @ null_vector, SINGULAR_RATIO
    )[0]
    for null_step in NULL_VECTOR_STEPS:
        guess = z + null_step * null_z_direction + null_step**2 * np.append(second_order_shift, [0.0, 0.0])
        yield problem.take_step(make_start_point(guess, null_z_direction), 0.0, step_control)


def track_locus_seed(locus_seed, step_settings):
    """Track a `LocusSeed`; return (start, forward parts, backward parts), the arguments of `build_locus`."""
    segment = (
        track_locus(locus_seed.forward_direction) if locus_seed.origin_z is None else _track_from_origin(locus_seed)
    )
    forward_parts = track_across_walls(
        locus_seed.start,
        locus_seed.forward_direction,
        step_settings,
        segment._replace(specials=(locus_seed.special_index, *segment.specials)),
    )
    is_closed = locus_seed.backward_direction is None or forward_parts[0][1].end is End.CLOSED
    return (
        locus_seed.start,
        forward_parts,
        () if is_closed else track_across_walls(locus_seed.start, locus_seed.backward_direction, step_settings),
    )


def _track_from_origin(locus_seed):
    """Track a seed that begins at a small distance from its point; return the segment with the point prepended."""
    segment, z = track_locus(locus_seed.forward_direction), locus_seed.origin_z
    origin_distance = np.linalg.norm(locus_seed.forward_direction.task.control.scale * (segment.points.z[0] - z))
    origin_point = make_start_point(z, (segment.points.z[0] - z) / origin_distance)
    points = map_fields(
        lambda leaf, first_entry: np.concatenate([np.asarray(first_entry)[None], leaf]), segment.points, origin_point
    )
    points.step[1] = origin_distance
    diagnostics = map_fields(
        lambda leaf, first_entry: np.concatenate([first_entry, leaf]),
        segment.diagnostics,
        diagnose(segment.args, z[None]),
    )
    return segment._replace(
        points=points,
        diagnostics=diagnostics,
        specials=tuple(special_record._replace(row=special_record.row + 1) for special_record in segment.specials),
    )
