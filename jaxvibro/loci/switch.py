"""Follow the loci that emanate from points of codimension two, and switch to the branches of special points.

Find the loci that emanate from a point of codimension two, and the start of each.

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

from collections.abc import Callable, Mapping, Sequence
from typing import overload

import numpy as np

from continuation import augmented_systems
from continuation import augmented_systems as crossing
from continuation.arclength import make_start_point
from continuation.branch_segment import SpecialIndex, make_limits

from ..branches.branch import Branch, Special
from ..branches.follow import Monitors, check_follow_settings
from ..branches.switch import FIRST_STEP, SWITCHING_KINDS, branch_starts, follow_away_from_point
from ..problem.curve_ends import End
from ..problem.grazing_contact import are_admissible, find_grazing_contacts
from ..problem.orbit_equations import diagnose
from ..problem.orbit_problem import SINGULAR_RATIO
from ..problem.soft_wall_grazing import is_smooth_soft_wall
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds
from .grazing_switchover import opposite_directions, track_across_walls
from .locus import Codim2, Locus, build_locus
from .locus_start import (
    LocusDirection,
    check_locus_arguments,
    forward_locus_directions,
    make_locus_task,
    orbit_stays_symmetric,
    problems_at_locus_start,
)

NULL_VECTOR_STEPS = (0.1, 0.05, 0.02, 0.01, 0.005)  # distances along the null vector at which the SN of a pair starts
STEP_FRACTIONS = (1.0, 0.1, 0.01)  # fractions of the first step at which another locus starts
DIFFERENCE_STEP = 1e-4  # along the unit null vector: step of central differences


def find_emanating_directions(codim2_point, bounds, *step_settings):
    """Return the directions of each locus that emanates from a `Codim2`, except the locus on which it was located.

    Each entry is (forward, backward): two `LocusDirection` records, or None for backward if the locus begins at the
    point. Raises ArgumentError if a start cannot be located.
    """
    locus_arguments = tuple(codim2_point.values), bounds, *step_settings
    if codim2_point.kind in ("GPD", "DSB"):
        return [_pair_fold_directions(codim2_point, *locus_arguments)]
    grazing_contacts = find_grazing_contacts(codim2_point.spot.problem, codim2_point.spot.z)
    impact_contacts = [contact for contact in grazing_contacts if contact.is_impact]
    if codim2_point.on == "GR":
        directions, is_resonant_grazing, kind = [], codim2_point.kind == "RG", codim2_point.kind
    else:
        directions, is_resonant_grazing, kind = (
            [],
            any(not is_smooth_soft_wall(codim2_point.scene, contact.side) for contact in impact_contacts),
            codim2_point.on,
        )
        directions.append(_grazing_directions(codim2_point, "RG" if is_resonant_grazing else kind, *locus_arguments))
    if is_resonant_grazing:
        is_symmetric = orbit_stays_symmetric("SN", codim2_point.scene, codim2_point.spot, locus_arguments[0])
        kinds = (kind for kind in ("SN", "SB" if is_symmetric else "PD") if kind != codim2_point.on)
        return directions + [
            _contact_opening_directions(codim2_point, kind, codim2_point.spot, *locus_arguments) for kind in kinds
        ]
    if codim2_point.on == "GR":
        orbit_without_contact = _orbit_without_impacts(codim2_point.spot, [contact.row for contact in impact_contacts])
        directions.append(_contact_opening_directions(codim2_point, kind, orbit_without_contact, *locus_arguments))
    return directions if kind == "SN" else [*directions, _pair_grazing_directions(codim2_point, kind, *locus_arguments)]


def _orbit_without_impacts(orbit_point, rows):
    """Return an `OrbitPoint` without its impacts in the given rows."""
    remaining_rows = np.delete(np.arange(orbit_point.problem.n_used_rows), rows)
    problem, z = orbit_point.problem.with_rows(orbit_point.z, remaining_rows)
    return orbit_point._replace(problem=problem, z=z)


def _grazing_directions(codim2_point, kind, names, bounds, *step_settings):
    """Return both directions of the GR on which another locus ends; `kind` is the kind of the point on the GR."""
    forward_direction, backward_direction = opposite_directions(
        "GR", codim2_point.scene, codim2_point.spot, names, bounds, *step_settings
    )
    return forward_direction._replace(codim2_index=_special_record_of(codim2_point, kind)), backward_direction


def _special_record_of(codim2_point, kind):
    return SpecialIndex(0, kind, codim2_point.residual)


def _contact_opening_directions(codim2_point, kind, orbit_point, names, bounds, *step_settings):
    """Return the directions of the locus of a kind along which the contacts of a point open or gain speed."""
    (locus_direction,) = forward_locus_directions(kind, codim2_point.scene, orbit_point, names, bounds, *step_settings)
    return _direction_from_point(_special_record_of(codim2_point, "GR"), _admissible_direction(locus_direction)), None


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


def _pair_grazing_directions(codim2_point, kind, names, bounds, *step_settings):
    """Return the directions of the GR of the pair of orbits that emanates from a PD or SB on a grazing.

    Two solution curves of the equations of the GR cross at the point. The GR of the pair is the curve along which the
    two halves of the orbit differ.
    """
    orbit_point = _doubled_orbit(codim2_point.spot, kind)
    problem, z = problems_at_locus_start("GR", codim2_point.scene, orbit_point, names, use_whole_orbit=True)[0]
    direction = _direction_at("GR", codim2_point.scene, problem, z, names, bounds, step_settings)
    try:
        crossing_tangents = crossing.branch_tangents(problem.equations, z, direction.task.control.scale, problem)
    except ValueError:
        raise check.ArgumentError("special", "must be a point at which loci of GR cross", kind) from None
    speed_slopes = crossing_tangents[:, problem.n_rows + problem.impact_rows]
    half_speed_differences = abs(speed_slopes - np.roll(speed_slopes, len(problem.impact_rows) // 2, axis=1)).max(
        axis=1
    )
    direction = direction.from_point(z, crossing_tangents[np.argmax(half_speed_differences)])
    return _direction_from_point(_special_record_of(codim2_point, kind), _admissible_direction(direction)), None


def _pair_fold_directions(codim2_point, names, bounds, *step_settings):
    """Return the directions of the SN of the pair of orbits that emanates from a GPD or DSB."""
    orbit_point = _doubled_orbit(codim2_point.spot, {"GPD": "PD", "DSB": "SB"}[codim2_point.kind])
    ((problem, z),) = problems_at_locus_start("SN", codim2_point.scene, orbit_point, names, use_whole_orbit=True)
    direction = _direction_at("SN", codim2_point.scene, problem, z, names, bounds, step_settings)
    special_record = _special_record_of(codim2_point, codim2_point.kind)
    for nearby_point in _pair_fold_guesses(problem, z, direction.task.control):
        if _is_admissible_point(direction.task, nearby_point):
            nearby_direction = direction.from_point(nearby_point.z, nearby_point.tangent)
            return nearby_direction._replace(codim2_index=special_record, codim2_z=z), None
    raise check.ArgumentError(
        "special", "must be a point near which the SN of the pair can be located", codim2_point.kind
    )


def _direction_at(kind, scene, problem, z, names, bounds, step_settings):
    """Return the `LocusDirection` of a locus that crosses a point singularly; its tangent is not known yet."""
    names, bounds = check_locus_arguments(scene, names, bounds, *step_settings[:3])
    task = make_locus_task(scene, problem, z, names, bounds, *step_settings)
    return LocusDirection(kind, scene, task, make_start_point(z, np.zeros(len(z))), names, bounds)


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


def _direction_from_point(special_record, locus_direction):
    """Return a `LocusDirection` from a point of codimension two.

    If possible, the direction begins at a small distance from the point. At the point itself the determinant of the
    equations may vanish, because an impact has zero speed or because another curve crosses. The continuation would then
    mistake a step from the point for a jump.
    """
    problem, task = locus_direction.problem, locus_direction.task
    for fraction in STEP_FRACTIONS:
        nearby_point = problem.take_step(locus_direction.start, fraction * task.first_step, task.control)
        if _is_admissible_point(task, nearby_point):
            nearby_direction = locus_direction.from_point(nearby_point.z, nearby_point.tangent)
            return nearby_direction._replace(codim2_index=special_record, codim2_z=locus_direction.start.z)
    return locus_direction._replace(codim2_index=special_record)


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


def track_emanating_locus(forward_direction, backward_direction, step_settings):
    """Track a locus in one or two directions; return (forward parts, backward parts) for `build_locus`."""
    forward_parts = track_across_walls(forward_direction, step_settings)
    is_closed = backward_direction is None or forward_parts[0][1].end is End.CLOSED
    return forward_parts, () if is_closed else track_across_walls(backward_direction, step_settings)


DEPARTURE_LOCI = {  # kind of point: kinds of locus on which other loci emanate from it
    "RG": ("GR",),
    "GPD": ("PD",),
    "DSB": ("SB",),
    "GR": ("SN", "PD", "SB"),
    "SN": ("GR",),
    "PD": ("GR",),
    "SB": ("GR",),
}


@overload
def switch(
    special: Special,
    bounds: tuple[float, float] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...]: ...


@overload
def switch(
    special: Codim2,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Locus, ...]: ...


@check.host_only("use strobe or monodromy")
def switch(
    special: Special | Codim2,
    bounds: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...] | tuple[Locus, ...]:
    """Continue the branches or loci that emanate from a special point.

    Parameters
    ----------
    special : Special or Codim2
        Special point of a branch, of kind SB, BP, PD or GR, or point of codimension two of a locus.
    bounds : tuple of float or dict of str to tuple of float, optional
        Lower and upper bound of the parameter of a branch, or of each parameter of a locus by name. By default the
        bounds of the curve on which the point was located.
    first_step : float, optional
        First arclength step, as in `follow` or `locus`.
    largest_step : float, optional
        Largest arclength step.
    tolerance : float, optional
        Tolerance of Newton's method.
    monitors : dict of str to callable, optional
        User-defined test functions, as in `follow`. Only for branches.
    stop : str or sequence of str, optional
        Kinds of special point at which a branch ends. Only for branches.
    max_points : int, optional
        Largest number of points of each curve. By default the number is unlimited.
    max_seconds : float, optional
        Wall-clock time in s for all curves together. By default the time is unlimited.
    progress : callable, optional
        Function that is called with the number of points computed.

    Returns
    -------
    tuple of Branch or tuple of Locus
        The curves that emanate from the point, except the curve on which the point was located. Each curve starts at
        the point. The exception is the GR on which an SN, PD or SB ends: this locus passes through the point. Branches
        emanate from a `Special`, loci from a `Codim2`.

    Raises
    ------
    ArgumentError
        If no curve emanates from a point of this kind, or if another argument is invalid.

    See Also
    --------
    follow : Continue an orbit in one parameter.
    locus : Continue a special point in two parameters.

    Notes
    -----
    Branches emanate from these special points of a branch:

    - SB, BP: the two halves of the crossing branch. The first half begins towards larger times or speeds.
    - PD: the branch of twice the period. Its other half consists of the same orbits, shifted by one period.
    - GR: the branches of the itineraries along which the branch itself does not continue.

    Loci emanate from these points of codimension two:

    - RG: the SN and the PD (for a symmetric orbit the SB) of the orbit with the grazing contact as an impact.
    - GPD: the SN of the period-doubled orbit.
    - DSB: the SN of an asymmetric orbit. The SN of its mirror image is the same curve in the parameter plane.
    - SN, PD and SB on a GR: the locus of that kind of the orbit without the grazing contact. From a PD or SB also
      emanates the GR of the period-doubled orbit or of an asymmetric orbit.
    - GR at which an SN, PD or SB ends: the GR through the point, and the other loci that emanate from that GR.

    Examples
    --------
    >>> special = branch.points("SB")[0]
    >>> halves = jv.switch(special, bounds=(3.0, 6.0), max_points=20)
    >>> [half.segments[0].label for half in halves]
    ['P111', 'P111']
    """
    limits = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    switch_curves = _switch_loci if isinstance(special, Codim2) else _switch_branches
    return switch_curves(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits)


def _switch_branches(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits):
    """Continue the branches that emanate from a `Special`."""
    if not isinstance(special, Special):
        raise check.ArgumentError("special", "must be a special point of a branch", special)
    if special.kind not in SWITCHING_KINDS:
        raise check.ArgumentError(
            "special",
            f"must be of kind {', '.join(SWITCHING_KINDS)}, because no branch emanates from other kinds",
            special.kind,
        )
    bounds = check_parameter_bounds(special.scene, special.name, special.bounds if bounds is None else bounds)
    settings = check_follow_settings(first_step, largest_step, tolerance, monitors, stop) | {"limits": limits}
    return tuple(follow_away_from_point(special, start, bounds, **settings) for start in branch_starts(special))


def _switch_loci(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits):
    """Continue the loci that emanate from a `Codim2`."""
    _require_switchable(special, monitors, stop)
    bounds, step_settings = special.bounds if bounds is None else bounds, (first_step, largest_step, tolerance, limits)
    values_text = ", ".join(f"{name} {value:.12g}" for name, value in special.values.items())
    start_reason = f"it left {special.kind} at {values_text}"
    return tuple(
        build_locus(*track_emanating_locus(*directions, step_settings), start_reason)
        for directions in find_emanating_directions(special, bounds, *step_settings)
    )


def _require_switchable(special, monitors, stop):
    """Raise ArgumentError if no loci emanate from a point, or if an argument applies to branches only."""
    if special.on not in DEPARTURE_LOCI.get(special.kind, ()):
        kinds = ", ".join(
            f"{kind} of a locus of {' or '.join(locus_kinds)}" for kind, locus_kinds in DEPARTURE_LOCI.items()
        )
        actual_value = f"{special.kind} of a locus of {special.on}"
        raise check.ArgumentError("special", f"must be a point from which other loci emanate: {kinds}", actual_value)
    for argument_name, actual_value in (("monitors", monitors), ("stop", stop)):
        if actual_value:
            raise check.ArgumentError(argument_name, "must be omitted for loci", actual_value)
