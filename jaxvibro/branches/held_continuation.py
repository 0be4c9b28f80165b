"""Follow orbits along two parameters with one quantity held fixed."""

import numpy as np
import xarray as xr

from continuation import continuation_loop, event_search
from continuation.arclength import StepControl
from continuation.branch_segment import SpecialIndex, join_segments, reverse_segment
from continuation.continuation_loop import ContinuationTask, Termination
from continuation.intermediate_points import make_start_point

from ..orbits.orbit import OrbitError
from ..output.units import scales_attributes
from ..problem.curve_grazing import OrbitEventDetector, truncate_at_grazing
from ..problem.end import End, convert_segment_end
from ..problem.grazing_contact import arclength_weights
from ..problem.orbit_curve import dataset_row, parse_orbit_point
from ..problem.orbit_equations import continuation_problem
from ..problem.orbit_point import set_up_equations
from ..problem.plane_curve_end import describe_end
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, mark_parameters, parameter_domain
from ..scene.typical_scales import typical_length
from .assemble import column_descriptions, dataset_columns
from .branch import Branch
from .held_branch import HeldBranch
from .held_equations import HELD_QUANTITIES, HeldOrbitEquations
from .largest_position import branch_peak_positions

MIN_STEP = 1e-8  # arclength


class HeldGrazingDetector(OrbitEventDetector):
    """Event detector that ends a held branch at its first grazing."""

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """End the curve at the grazing before the first inadmissible point."""
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad, self.length_scale)
        return None if residual is None else Termination(points, SpecialIndex(0, "GR", residual), End.GRAZE)

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        """Return no special points."""
        return []


def check_held_arguments(scene, names, bounds, hold):
    """Check the arguments of a held branch. Raises ArgumentError.

    Returns the two names, ``{name: (low, high)}``, and the name and value of the held quantity.
    """
    hold_items = list(hold.items()) if isinstance(hold, dict) else []
    if (
        len(hold_items) != 1
        or hold_items[0][0] not in HELD_QUANTITIES
        or not np.isscalar(hold_items[0][1])
        or not np.isfinite(hold_items[0][1])
    ):
        raise check.ArgumentError("hold", f"must map {' or '.join(HELD_QUANTITIES)} to one finite number", hold)
    name_pair = tuple(names) if isinstance(names, tuple | list) else ()
    for name in name_pair:
        check.require_parameter(name, scene.names, name)
    if len(name_pair) != 2 or name_pair[0] == name_pair[1]:
        raise check.ArgumentError("name", "must be two different parameters if `hold` is given", names)
    check.require_independent(*name_pair)
    if not isinstance(bounds, dict) or set(bounds) != set(name_pair):
        raise check.ArgumentError(
            "bounds", f"must give (low, high) for {name_pair[0]} and for {name_pair[1]}, by name", bounds
        )
    return (
        name_pair,
        {name: check_parameter_bounds(scene, name, bounds[name]) for name in name_pair},
        hold_items[0][0],
        float(hold_items[0][1]),
    )


def locate_held_start(scene, names, quantity_name, value, orbit_problem, z):
    """Locate an orbit close to z with the held value, the second parameter being fixed.

    Returns `HeldOrbitEquations`, z and the tangent towards greater values of the second parameter; None if Newton's
    method fails. `orbit_problem` and `z` belong to an orbit along the first parameter.
    """
    marked_scene, parameter_marks = mark_parameters(scene, *names)
    quantity_mask = np.array([float(name == quantity_name) for name in HELD_QUANTITIES])
    problem = HeldOrbitEquations(
        marked_scene, parameter_marks, orbit_problem.sequence, quantity_mask, np.asarray(value)
    )
    z = np.append(z, float(scene.parameter(names[1])))
    control_values = (np.float64(number) for number in (0.0, 1.0, 1.0, -np.inf, np.inf))
    control = StepControl(arclength_weights(problem, typical_length(scene)), *control_values)
    point = event_search.solve_with_fixed_entry(continuation_problem(problem), z, -1, z[-1], control, problem)
    detector = HeldGrazingDetector(problem, typical_length(scene))
    if not point.converged or not detector.is_admissible(point.z[None], detector.diagnose(point.z[None]))[0]:
        return None
    return problem, point.z, point.tangent


def orbits_near_value(branch, quantity_name, value):
    """Yield the equations and z of the points next to which the quantity takes a value, nearest to the start first."""
    quantity_values = _quantity_along_branch(branch, quantity_name)
    branch_start_row = int(np.argmin(abs(branch.values - float(branch.scene.parameter(branch.name)))))
    crossing_rows = np.flatnonzero((quantity_values[:-1] - value) * (quantity_values[1:] - value) <= 0)
    for row_before in sorted(crossing_rows.tolist(), key=lambda k: abs(k - branch_start_row)):
        row = row_before + int(abs(quantity_values[row_before + 1] - value) < abs(quantity_values[row_before] - value))
        yield set_up_equations(branch.scene, branch.name, parse_orbit_point(dataset_row(branch.data, row), branch.name))


def _quantity_along_branch(branch, quantity_name):
    return branch_peak_positions(branch) if quantity_name == "peak" else branch.data["least_speed"].values


def unreachable_value_error(branch: Branch, quantity_name: str, value: float) -> OrbitError:
    """Make the error for a value that the quantity does not take on a branch."""
    quantity_values = _quantity_along_branch(branch, quantity_name)
    message = (
        f"{quantity_name} does not take the value {value:.12g} along {branch.name}; it ranges from"
        f" {min(quantity_values):.4g} to {max(quantity_values):.4g}"
    )
    return OrbitError(message, float(np.max(branch.data["residual"].values)), "use another orbit or wider bounds")


def follow_held_branch(scene, names, bounds, quantity_name, value, held_start, direction, settings):
    """Follow a held branch from the result of `locate_held_start`, in one or both directions."""
    problem, z, start_tangent = held_start
    domains, bound_intervals = [parameter_domain(scene, name) for name in names], [bounds[name] for name in names]
    parameter_bounds = tuple(
        (max(lower, domain_lower), min(upper, domain_upper))
        for (lower, upper), (domain_lower, domain_upper) in zip(bound_intervals, domains, strict=True)
    )
    domain_end_values = tuple(
        tuple(number for number in domain_interval if number not in bound_interval)
        for domain_interval, bound_interval in zip(domains, bound_intervals, strict=True)
    )
    first_step, largest_step, tolerance = (settings[key] for key in ("first_step", "largest_step", "tolerance"))
    control_values = (
        np.float64(number) for number in (min(MIN_STEP, first_step), largest_step, tolerance, *parameter_bounds[1])
    )
    length_scale = typical_length(scene)
    control = StepControl(arclength_weights(problem, length_scale), *control_values)
    detector = HeldGrazingDetector(problem, length_scale)
    limits = settings["limits"]
    task = ContinuationTask(
        continuation_problem(problem),
        problem,
        control,
        min(first_step, largest_step),
        parameter_bounds,
        domain_end_values,
        detector,
        starts=(),
        limits=limits,
    )
    forward_task = task._replace(limits=limits.half_points() if direction == "both" else limits)
    forward = (
        continuation_loop.follow_branch(forward_task, make_start_point(z, start_tangent))
        if direction != "backward"
        else None
    )
    task = task._replace(limits=limits.after_points(0 if forward is None else len(forward.points.z) - 1))
    backward = (
        continuation_loop.follow_branch(task, make_start_point(z, -start_tangent)) if direction != "forward" else None
    )
    joined_segment = (
        forward
        if backward is None
        else reverse_segment(backward)
        if forward is None
        else join_segments([reverse_segment(backward), forward])
    )
    reasons = tuple(
        "the start" if segment is None else _describe_segment_end(convert_segment_end(segment), names)
        for segment in (backward, forward)
    )
    return HeldBranch(
        names,
        quantity_name,
        value,
        bounds,
        scene,
        _build_dataset(scene, convert_segment_end(joined_segment), names),
        reasons,
    )


def _describe_segment_end(segment, names):
    return describe_end(segment.end, names[segment.end_param_index], segment.end_value)


def _build_dataset(scene, segment, names):
    n_impacts = int(np.sum(segment.args.sequence.sides != 0))
    columns = dataset_columns(segment, names[1], n_impacts, 0) | {names[0]: segment.points.z[:, -2]}
    descriptions = column_descriptions(names[0]) | column_descriptions(names[1])
    column_order = [*names, *(key for key in columns if key not in names)]
    data = {key: xr.Variable(descriptions[key][0], columns[key], descriptions[key][1]) for key in column_order}
    return xr.Dataset(data, attrs=scales_attributes(scene))
