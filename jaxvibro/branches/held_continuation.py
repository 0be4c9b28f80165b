"""Follow orbits along two parameters with one quantity held fixed."""

import numpy as np
import xarray as xr

from continuation.arclength import make_control
from continuation.branch_segment import join_segments, reverse_segment
from continuation.continuation_loop import ContinuationTask, follow_both_directions

from ..orbits.orbit import OrbitError
from ..output.units import scales_attributes
from ..problem.curve_grazing import OrbitEventDetector
from ..problem.end import convert_segment_end
from ..problem.orbit_problem import make_orbit_problem
from ..problem.plane_curve import describe_segment_end
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, limit_bounds_to_domains
from .assemble import column_descriptions, dataset_columns
from .branch import Branch
from .held_branch import HeldBranch
from .held_equations import HELD_QUANTITIES, HeldCondition
from .largest_position import branch_peak_positions


class HeldGrazingDetector(OrbitEventDetector):
    """Event detector that ends a held branch at its first grazing."""

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

    Returns an `OrbitProblem`, z and the tangent towards greater values of the second parameter; None if Newton's
    method fails. `orbit_problem` and `z` belong to an orbit along the first parameter.
    """
    quantity_mask = np.array([float(name == quantity_name) for name in HELD_QUANTITIES])
    problem = make_orbit_problem(scene, *names, periods=orbit_problem.sequence.periods)._replace(
        sequence=orbit_problem.sequence, condition=HeldCondition(quantity_mask, np.asarray(value))
    )
    z = np.append(z, float(scene.parameter(names[1])))
    point, detector = problem.solve_at(z, -1, z[-1]), HeldGrazingDetector(problem)
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
        _, orbit_point = branch.located(row)
        yield orbit_point.problem, orbit_point.z


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
    parameter_bounds, domain_end_values = limit_bounds_to_domains(scene, names, [bounds[name] for name in names])
    first_step, largest_step, tolerance = (settings[key] for key in ("first_step", "largest_step", "tolerance"))
    control = make_control(problem.weights(), first_step, largest_step, tolerance, parameter_bounds[1])
    task = ContinuationTask(
        problem.equations,
        problem,
        control,
        min(first_step, largest_step),
        parameter_bounds,
        domain_end_values,
        HeldGrazingDetector(problem),
        starts=(),
        limits=settings["limits"],
    )
    backward, forward = follow_both_directions(task, z, start_tangent, direction)
    joined_segment = (
        forward
        if backward is None
        else reverse_segment(backward)
        if forward is None
        else join_segments([reverse_segment(backward), forward])
    )
    reasons = tuple(
        "the start" if segment is None else describe_segment_end(convert_segment_end(segment), names)
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


def _build_dataset(scene, segment, names):
    columns = dataset_columns(segment, names[1], segment.args.n_used_rows, 0) | {names[0]: segment.points.z[:, -2]}
    descriptions = column_descriptions(names[0]) | column_descriptions(names[1])
    column_order = [*names, *(key for key in columns if key not in names)]
    data = {key: xr.Variable(descriptions[key][0], columns[key], descriptions[key][1]) for key in column_order}
    return xr.Dataset(data, attrs=scales_attributes(scene))
