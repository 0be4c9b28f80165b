"""Find the loci that emanate from a point of codimension two, and the start of each.

- RG: with the grazing contact as an impact of speed s, the equations of the orbit reduce to ``g = mu + phi s + kappa
  s^2 / 2 = 0``. mu vanishes on the GR, phi at the RG. They are singular at ``s = -phi / kappa`` (SN) and, for the orbit
  traversed twice, with another kappa (PD; SB of a symmetric orbit). These curves are regular in s and quadratically
  tangent to the GR. Only ``s > 0`` is admissible (Simpson and Ghosh, arXiv 2602.22797).
- GPD, DSB: the two halves of the orbit differ by s along the null vector, and ``nu + c s^2 + d s^4 = 0`` with c = 0 at
  the point. nu vanishes on the PD or SB, and the pair of orbits folds at ``nu = c^2 / 4 d``. This is one SN,
  quadratically tangent. The multipliers of the pair are near 1 and det M^2 < 1, so that no other bifurcation is near.
- SN, PD, SB on a GR: an orbit without the grazing contact is singular. It lies on the locus of its kind on the side on
  which the contact opens. The other orbits of that point, the second orbit of the SN or the pair of the PD or SB, graze
  the wall along a curve that is quadratically tangent to that locus (Colombo and Dercole, SIAM J. Appl. Dyn. Syst. 9,
  62, 2010). At SN this curve is the GR itself, on both sides of the point; at PD and SB it is another GR.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import augmented_systems, event_search
from continuation import branch_switching as crossing
from continuation.branch_segment import SpecialIndex
from continuation.intermediate_points import start_point
from continuation.point_rows import map_fields

from ..problem.diagnostics import diagnose
from ..problem.end import End
from ..problem.equations import continuation_problem
from ..problem.grazing import SINGULAR_RATIO
from ..problem.grazing_contact import admissible
from ..problem.orbit_point import OrbitPoint
from ..problem.soft_grazing import is_smooth_wall
from ..scene import check
from .grazing_switchover import both_directions, track_across_walls
from .locus_start import (
    LocusStart,
    keeps_symmetry,
    locus_directions,
    locus_problems,
    locus_settings,
    reverse_direction,
    weight_settings,
)
from .track import LocusDirection, track_locus

NULL_VECTOR_STEPS = (0.1, 0.05, 0.02, 0.01, 0.005)  # distances along the null vector at which the SN of a pair starts
STEP_FRACTIONS = (1.0, 0.1, 0.01)  # fractions of the first step at which another locus starts
DIFFERENCE_STEP = 1e-4  # along the unit null vector: step of central differences


class LocusSeed(NamedTuple):
    """Start of a locus that emanates from a point.

    `start`, its `LocusStart`; `special_index`, the point as a special point of this locus; `forward_direction` and
    `backward_direction`, the latter None if the locus begins at the point; `origin`, z of the point if the direction
    begins at a small distance from it, else None.
    """

    start: LocusStart
    special_index: SpecialIndex
    forward_direction: LocusDirection
    backward_direction: LocusDirection | None = None
    origin: Float[np.ndarray, " unknowns"] | None = None


def locus_seeds(point, bounds, *step_settings):
    """Return the `LocusSeed` of each locus that emanates from a `Codim2`, except its own. Raises ArgumentError."""
    arguments = tuple(point.values), bounds, *step_settings
    if point.kind in ("GPD", "DSB"):
        return [_pair_fold_seed(point, *arguments)]
    contacts = LocusStart("GR", *_start_fields(point)).grazing_contacts
    impact_contacts = [contact for contact in contacts if contact.is_impact]
    if point.on == "GR":
        seeds, is_resonant, kind = [], point.kind == "RG", point.kind
    else:
        seeds, is_resonant, kind = (
            [],
            any(not is_smooth_wall(point.scene, contact.side) for contact in impact_contacts),
            point.on,
        )
        seeds.append(_grazing_seed(point, "RG" if is_resonant else kind, *arguments))
    if is_resonant:
        is_symmetric = keeps_symmetry(LocusStart("SN", *_start_fields(point)), arguments[0])
        kinds = (kind for kind in ("SN", "SB" if is_symmetric else "PD") if kind != point.on)
        return seeds + [_opening_seed(point, kind, point.spot, *arguments) for kind in kinds]
    if point.on == "GR":
        reduced_row = _drop_impacts(point.spot, [contact.row for contact in impact_contacts])
        seeds.append(_opening_seed(point, kind, reduced_row, *arguments))
    return seeds if kind == "SN" else [*seeds, _pair_grazing_seed(point, kind, *arguments)]


def _start_fields(point, orbit_row=None):
    """Return the fields of a `LocusStart` other than its kind."""
    return next(iter(point.values)), point.scene, orbit_row or point.spot


def _drop_impacts(orbit_row, rows):
    """Return an `OrbitPoint` without its impacts in the given rows."""
    remaining_indices = np.delete(np.arange(len(orbit_row.times)), rows)
    return orbit_row._replace(
        times=orbit_row.times[remaining_indices],
        speeds=orbit_row.speeds[remaining_indices],
        sides=orbit_row.sides[remaining_indices],
    )


def _grazing_seed(point, kind, names, bounds, *step_settings):
    """Return the GR through a point at which a locus of another kind ends; `kind` is that of the point on the GR."""
    start = LocusStart("GR", *_start_fields(point))
    return LocusSeed(start, _special_index(point, kind), *both_directions(start, names, bounds, *step_settings))


def _special_index(point, kind):
    return SpecialIndex(0, kind, point.residual)


def _opening_seed(point, kind, orbit_row, names, bounds, *step_settings):
    """Return the locus of a kind along which the contacts of a point open, or gain speed."""
    start = LocusStart(kind, *_start_fields(point, orbit_row))
    (direction,) = locus_directions(start, names, bounds, *step_settings)
    return _seed_from_direction(start, _special_index(point, "GR"), _admissible_direction(direction))


def _admissible_direction(direction):
    candidates = [candidate for candidate in (direction, reverse_direction(direction)) if candidate.is_admissible]
    if len(candidates) != 1:
        rule = "must be a point from which the locus emanates in exactly one admissible direction"
        raise check.ArgumentError("special", rule, len(candidates))
    return candidates[0]


def _doubled_orbit_row(point, kind, orbit_row):
    """Return the `OrbitPoint` of an orbit whose two halves may differ."""
    if kind == "SB":
        return orbit_row
    duration = orbit_row.periods * 2.0 * np.pi / float(point.scene.frequency)
    doubled_columns = (np.tile(column, 2) for column in (orbit_row.speeds, orbit_row.sides))
    return OrbitPoint(
        orbit_row.value,
        np.append(orbit_row.times, orbit_row.times + duration),
        *doubled_columns,
        2 * orbit_row.periods,
        orbit_row.x,
        orbit_row.v,
        orbit_row.residual,
    )


def _pair_grazing_seed(point, kind, names, bounds, *step_settings):
    """Return the GR of the pair of orbits that emanates from a PD or SB on a grazing.

    Two curves of its equations cross. The GR of the pair is the curve along which the two halves of the orbit differ.
    """
    start = LocusStart("GR", *_start_fields(point, _doubled_orbit_row(point, kind, point.spot)))
    problem, z = locus_problems(start, names, whole_orbit=True)[0]
    settings = weight_settings(problem, z, locus_settings(point.scene, names, bounds, *step_settings))
    scale, n_rows = settings.control.scale, len(problem.sequence.sides)
    try:
        tangents = crossing.branch_tangents(continuation_problem(problem), z, scale, problem)
    except ValueError:
        raise check.ArgumentError("special", "must be a point at which loci of GR cross", kind) from None
    speeds = tangents[:, n_rows + problem.impact_rows]
    half_differences = abs(speeds - np.roll(speeds, len(problem.impact_rows) // 2, axis=1)).max(axis=1)
    return _seed_from_direction(
        start,
        _special_index(point, kind),
        _admissible_direction(LocusDirection(problem, start_point(z, tangents[np.argmax(half_differences)]), settings)),
    )


def _pair_fold_seed(point, names, bounds, *step_settings):
    """Return the SN of the pair of orbits that emanates from a GPD or DSB."""
    orbit_row = _doubled_orbit_row(point, {"GPD": "PD", "DSB": "SB"}[point.kind], point.spot)
    start = LocusStart("SN", *_start_fields(point, orbit_row))
    ((problem, z),) = locus_problems(start, names, whole_orbit=True)
    settings = weight_settings(problem, z, locus_settings(point.scene, names, bounds, *step_settings))
    for nearby_point in _fold_guesses(problem, z, settings.control):
        if _is_admissible(problem, nearby_point, settings):
            direction = LocusDirection(problem, start_point(nearby_point.z, nearby_point.tangent), settings)
            return LocusSeed(start, _special_index(point, point.kind), direction, origin=z)
    raise check.ArgumentError("special", "must be a point near which the SN of the pair can be located", point.kind)


def _is_admissible(problem, nearby_point, settings):
    """Check that a `Point` is an admissible point of a locus within its bounds."""
    is_inside = all(
        lower <= value <= upper for value, (lower, upper) in zip(nearby_point.z[-2:], settings.box, strict=True)
    )
    return bool(
        nearby_point.converged
        and is_inside
        and admissible(problem, nearby_point.z, diagnose(problem, nearby_point.z[None]))[0]
    )


def _seed_from_direction(start, special_index, direction):
    """Return the `LocusSeed` of a direction from a point.

    The seed begins at a small distance if possible. At the point itself the determinant of its equations may have no
    sign, because an impact has zero speed or because another curve crosses, and a step from it is mistaken for a jump.
    """
    problem, settings = direction.problem, direction.settings
    for fraction in STEP_FRACTIONS:
        nearby_point = event_search.take_step(
            continuation_problem(problem), direction.start, fraction * settings.initial_step, settings.control, problem
        )
        if _is_admissible(problem, nearby_point, settings):
            nearby_direction = LocusDirection(problem, start_point(nearby_point.z, nearby_point.tangent), settings)
            return LocusSeed(start, special_index, nearby_direction, origin=direction.start.z)
    return LocusSeed(start, special_index, direction)


def _fold_guesses(problem, z, control):
    """Yield `Point` guesses of the SN of a pair of orbits at small distances along the null vector v of its equations.

    Newton's method starts from the second-order expansion ``u + s v + s^2 h`` of the pair at the parameters of the
    point. Its matrix is of order s^3, its error of order s^5.
    """
    n_unknowns = 2 * len(problem.sequence.sides)
    scale = control.scale[:n_unknowns]
    jacobian = augmented_systems.jacobian_at(continuation_problem(problem), z, problem)[:n_unknowns, :n_unknowns]
    null_vector = augmented_systems.null_vector(jacobian)
    null_vector = null_vector / np.linalg.norm(scale * null_vector)
    null_vector = null_vector * np.sign(null_vector[np.flatnonzero(abs(null_vector) > 0.5 * abs(null_vector).max())[0]])
    null_direction = np.append(null_vector, [0.0, 0.0])
    end_jacobians = augmented_systems.jacobians_at(
        continuation_problem(problem), z + DIFFERENCE_STEP * np.stack([null_direction, -null_direction]), problem
    )[:, :n_unknowns, :n_unknowns]
    second_order_shift = np.linalg.lstsq(
        jacobian, -0.25 / DIFFERENCE_STEP * (end_jacobians[0] - end_jacobians[1]) @ null_vector, SINGULAR_RATIO
    )[0]
    for step_length in NULL_VECTOR_STEPS:
        guess = z + step_length * null_direction + step_length**2 * np.append(second_order_shift, [0.0, 0.0])
        yield event_search.take_step(
            continuation_problem(problem), start_point(guess, null_direction), 0.0, control, problem
        )


def track_seed(seed, step_settings):
    """Track a `LocusSeed`; return the arguments of `build_locus`: start, forward parts, backward parts."""
    segment = track_locus(seed.forward_direction) if seed.origin is None else _track_from_origin(seed)
    forward_parts = track_across_walls(
        seed.start,
        seed.forward_direction,
        step_settings,
        segment._replace(specials=(seed.special_index, *segment.specials)),
    )
    is_closed = seed.backward_direction is None or forward_parts[0][1].end is End.CLOSED
    return (
        seed.start,
        forward_parts,
        () if is_closed else track_across_walls(seed.start, seed.backward_direction, step_settings),
    )


def _track_from_origin(seed):
    """Return the segment of a direction that begins at a small distance from its point, with this point prepended."""
    segment, z = track_locus(seed.forward_direction), seed.origin
    length = np.linalg.norm(seed.forward_direction.settings.control.scale * (segment.points.z[0] - z))
    first_row = start_point(z, (segment.points.z[0] - z) / length)
    points = map_fields(
        lambda leaf, first_entry: np.concatenate([np.asarray(first_entry)[None], leaf]), segment.points, first_row
    )
    points.step[1] = length
    diagnostics = map_fields(
        lambda leaf, first_entry: np.concatenate([first_entry, leaf]),
        segment.diagnostics,
        diagnose(segment.args, z[None]),
    )
    return segment._replace(
        points=points,
        diagnostics=diagnostics,
        specials=tuple(special_index._replace(row=special_index.row + 1) for special_index in segment.specials),
    )
