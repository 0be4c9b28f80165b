"""Follow orbits along two parameters with one quantity held fixed.

Equations, for `continuation`, of orbits along two parameters with one quantity held fixed. The unknowns z are the times
and speeds of the impacts, or x and v for an orbit without impacts, then the first and the second parameter. The
gradient of the quantity is a central difference. The gradient only affects the direction of the steps; the quantity
itself is exact.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jaxtyping import Float

from continuation.arclength import make_control, solve_bordered
from continuation.array_type import Array
from continuation.branch_segment import join_segments, reverse_segment
from continuation.continuation_loop import ContinuationTask, follow_both_directions
from continuation.problem import Problem

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits.orbit import OrbitError
from ..output.units import scales_attributes
from ..problem.curve_ends import OrbitEventDetector, convert_segment_end
from ..problem.orbit_curve import describe_segment_end
from ..problem.orbit_equations import (
    FREE_PROBLEM,
    IMPACT_PROBLEM,
    STICKING_PROBLEM,
    flight_without_impacts,
    scene_at,
    sequence_at,
)
from ..problem.orbit_problem import Condition, OrbitProblem, make_orbit_problem
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, limit_bounds_to_domains
from .assemble import column_descriptions, dataset_columns
from .branch import Branch
from .held_branch import HeldBranch
from .largest_position import branch_peak_positions, peak_of_flight, peak_of_sequence

DIFFERENCE_STEP = 1e-5  # relative to 1 + abs(z)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class HeldCondition(Condition):
    """Condition that one quantity has a value.

    Attributes
    ----------
    quantity_mask : Array
        Array of shape (2,), 1 at the held quantity among `HELD_QUANTITIES`.
    value : Array
        Value of the held quantity.
    """

    quantity_mask: Float[Array, "2"]
    value: Float[Array, ""]

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the quantity minus its value as the last residual."""
        return HELD_EQUATIONS[super().equations(problem)]


def _largest_position(z, problem):
    if len(problem.sequence.sides):
        return peak_of_sequence(flow_coefficients(scene_at(problem, z)), sequence_at(problem, z))
    return peak_of_flight(*flight_without_impacts(problem, z))


def _least_impact_speed(z, problem):
    n_rows = len(problem.sequence.sides)
    return jnp.min(jnp.where(problem.sequence.sides != 0, z[n_rows : 2 * n_rows], jnp.inf), initial=jnp.inf)


HELD_QUANTITIES = {"peak": _largest_position, "least_speed": _least_impact_speed}


def held_quantity(z, problem):
    """Return the held quantity at z."""
    return sum(
        problem.condition.quantity_mask[k]
        * jnp.where(problem.condition.quantity_mask[k] > 0, quantity_function(z, problem), 0.0)
        for k, quantity_function in enumerate(HELD_QUANTITIES.values())
    )


def _residual_and_jacobian(orbit_residual_function, z, problem):
    """Return F and dF/dz; the last residual is the quantity minus its value."""
    residual, jacobian = orbit_residual_function(z, problem)
    step_sizes = DIFFERENCE_STEP * (1.0 + abs(z))
    z_directions = np.concatenate([np.zeros((1, len(z))), np.eye(len(z)), -np.eye(len(z))])
    quantity_values = lax.map(
        lambda direction: held_quantity(z + direction * step_sizes, problem), jnp.asarray(z_directions, z.dtype)
    )
    quantity_gradient = (quantity_values[1 : len(z) + 1] - quantity_values[len(z) + 1 :]) / (2.0 * step_sizes)
    return jnp.append(residual, quantity_values[0] - problem.condition.value), jnp.concatenate(
        [jacobian, quantity_gradient[None]]
    )


def _hold_quantity(orbit_equations):
    """Append the held quantity to the equations of orbits without a condition."""
    residual_and_jacobian = partial(_residual_and_jacobian, orbit_equations.dense_function)
    return Problem(
        residual_and_jacobian,
        solve_bordered,
        residual_and_jacobian,
        (),
        call_as_kernel,
        orbit_equations.is_valid,
        compile_at_once=True,
    )


HELD_EQUATIONS = {
    equations: _hold_quantity(equations) for equations in (IMPACT_PROBLEM, STICKING_PROBLEM, FREE_PROBLEM)
}


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
