"""Fit parameters of a scene to a record of impacts, samples or special points: `fit`."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene import check
from ..scene.input_warnings import warn_if_times_in_seconds
from ..scene.scene import SIDES, Scene
from ..scene.scene_parameters import common_parameter_value
from . import fit_result, sample_fit, special_point_fit
from .constrained_least_squares import FreeParameterSpec
from .fit_result import Fit, FitStatus
from .free_parameters import bounds_of_changes, check_free_parameters
from .impact_chain_equations import fit_chain_parameters
from .impact_chain_search import match_impact_record
from .impact_chains import IMPOSSIBLE_COST, ImpactFitProblem, chain_measurements, is_possible_motion
from .records import ImpactRecord, PointRecord, SampleRecord, count_impact_information, count_sample_information

# Unknown phase: number of start phases, impacts that rank them, and chains that are continued.
N_PHASES, HEAD_IMPACTS, MAX_CHAINS = 8, 10, 3
PHASE_SCALE = 0.5  # scale of an unknown phase, in rad


@check.host_only("use the chain's equations")
def fit(
    scene: Scene,
    data: ImpactRecord | SampleRecord | PointRecord,
    free: Mapping[str | tuple[str, ...], float],
    bounds: Mapping[str | tuple[str, ...], Sequence[float]] | None = None,
) -> Fit:
    """Fit parameters of a scene to a record and estimate their errors.

    Parameters
    ----------
    scene : Scene
        Initial scene, in double precision. The values of the free parameters may have errors of a few times their
        scales.
    data : ImpactRecord or SampleRecord or PointRecord
        The record.
    free : dict of str or tuple of str to float
        Free parameters, each with its scale, a typical error of its initial value. For a `PointRecord`, a tuple of
        names is one parameter of several numbers that share a value.
    bounds : dict of str or tuple of str to sequence of float, optional
        Lower and upper bound of free parameters. By default their domains.

    Returns
    -------
    Fit
        Parameter values, errors, and the combinations that the record does not determine.

    Raises
    ------
    ArgumentError
        If the scene is a batch, in single precision or under a user-defined force, if a name is not a parameter of the
        scene, if a scale is not a positive number, if `bounds` does not contain the values of the scene, if the record
        refers to a wall that the scene does not have, if the record holds fewer values than there are unknowns, or
        fewer independent values than there are free parameters. If the motion has settled, only the values of one cycle
        are independent: the phases of its impacts, or its samples, and the period if the frequency is free.

    See Also
    --------
    ImpactRecord : Record of impacts.
    SampleRecord : Record of samples.
    PointRecord : Record of special points.

    Notes
    -----
    The initial state of the motion is always unknown. The time of an impact on a soft wall is the time of entry.

    Special points are functions of the scene (`located`) and are fitted by the Gauss-Newton method. Impacts are fitted
    by a chain of flights, each as exact as in `strobe`. Samples are fitted by short trajectories, each as exact as in
    `sample`. This multiple shooting [1]_ fits chaotic motions as accurately as periodic motions. Errors follow from the
    linear theory of least squares.

    References
    ----------
    .. [1] H. G. Bock, "Numerical treatment of inverse problems in chemical reaction kinetics", 1981.

    Examples
    --------
    >>> record = jv.PointRecord(branch.points("SN"), [0.52], sigma=0.01)
    >>> result = jv.fit(scene, record, {"damping": 0.01})
    >>> round(result.values["damping"], 5), result.status.name
    (0.05298, 'OK')
    """
    check.require_single_scene(scene)
    check.require_spring(scene, "fit")
    if scene.dtype != np.float64:
        raise check.ArgumentError("scene", "must be in double precision", np.dtype(scene.dtype).name)
    if isinstance(data, PointRecord):
        return _fit_special_points(scene, data, free, bounds or {})
    parameter_units = check_free_parameters(scene, free)
    change_bounds = bounds_of_changes(scene, parameter_units, bounds or {})
    warn_if_times_in_seconds(scene, data)
    fit_record = _fit_impacts if isinstance(data, ImpactRecord) else _fit_samples
    return fit_record(scene, data, parameter_units, change_bounds)


def _fit_impacts(scene, data, parameter_units, change_bounds):
    for side in np.unique(data.sides):
        if SIDES[int(side > 0)] not in scene.walls:
            raise check.ArgumentError(
                "data.sides", f"must be sides of its walls; the scene has no {SIDES[int(side > 0)]} wall", int(side)
            )
    _require_enough_data(len(data.times), "times", parameter_units, data.phase)
    free_spec = _make_free_spec(scene, data.phase, parameter_units, change_bounds)
    sigma = np.full(len(data.times), data.sigma)
    fit_problem = ImpactFitProblem(data.times, data.sides.astype(float), sigma, free_spec)
    chain = _match_impact_record(fit_problem, data)
    search_solution = None if chain is None or chain.cost >= IMPOSSIBLE_COST else chain.solution

    def solve_with_spec(free_spec):
        measurements = chain_measurements(fit_problem, chain)
        return fit_chain_parameters(search_solution.nodes, measurements, free_spec, search_solution.parameters)

    def missed_and_spurious(solution):
        missed_indices = np.flatnonzero(chain.record_indices < 0)
        missed_nodes = zip(solution.nodes.times[missed_indices], solution.nodes.sides[missed_indices], strict=True)
        return tuple((float(time), int(side)) for time, side in missed_nodes), tuple(sorted(chain.spurious_indices))

    n_independent_values = count_impact_information(data, float(scene.frequency), "frequency" in parameter_units)
    return _fit_identifiable(
        data,
        free_spec,
        search_solution,
        n_independent_values,
        solve_with_spec,
        lambda solution: is_possible_motion(free_spec, solution),
        missed_and_spurious,
    )


def _fit_samples(scene, data, parameter_units, change_bounds):
    _require_enough_data(data.measured[0].size, "values", parameter_units, data.phase)
    free_spec = _make_free_spec(scene, data.phase, parameter_units, change_bounds)
    fit_problem = sample_fit.make_sample_problem(data, free_spec)
    search_solution = sample_fit.follow_sample_record(fit_problem)

    def solve_with_spec(free_spec):
        return sample_fit.solve_first_shots(fit_problem, search_solution.nodes, free_spec, search_solution.parameters)

    return _fit_identifiable(
        data,
        free_spec,
        search_solution,
        None if "frequency" in parameter_units else count_sample_information(data, float(scene.frequency)),
        solve_with_spec,
        lambda solution: solution.converged,
    )


def _fit_identifiable(
    data,
    free_spec,
    search_solution,
    n_independent_values,
    solve_with_spec,
    is_motion,
    missed_and_spurious=lambda solution: ((), ()),
):
    """Return the `Fit` of the identifiable parameters to a record of a motion.

    Parameters
    ----------
    data : ImpactRecord or SampleRecord
        The record.
    free_spec : FreeParameterSpec
        Free parameters.
    search_solution : LeastSquaresSolution or None
        Solution for the whole record with a prior on all parameters. None if no motion follows the record.
    n_independent_values : int or None
        Number of independent values of a settled record. None for other records.
    solve_with_spec : callable
        Function of a `FreeParameterSpec` that solves the least-squares problem from `search_solution`.
    is_motion : callable
        Function of a solution that returns True if the solution is a motion of its scene.
    missed_and_spurious : callable, optional
        Function of a solution that returns the fields `missed` and `spurious` of the `Fit`.

    Returns
    -------
    Fit
        The fit.

    Raises
    ------
    ArgumentError
        If the record is settled and has fewer independent values than there are free parameters.
    """
    _refuse_underdetermined(data, free_spec, search_solution, n_independent_values)
    if search_solution is None:
        return fit_result.build_empty_fit(free_spec.scene, free_spec.names, free_spec.start_values)
    free_spec = free_spec.with_start_phase(search_solution.parameters)
    solution, identifiable_directions = fit_result.solve_identifiable(search_solution, free_spec, solve_with_spec)
    dof = len(solution.residuals) - 2 - int(np.sum(~identifiable_directions.is_undetermined))
    status = FitStatus.MISFIT
    if is_motion(solution):
        status = fit_result.status_of_solution(free_spec, solution, identifiable_directions, dof)
    return fit_result.build_fit(
        free_spec.scene_and_start_phase(solution.parameters)[0],
        free_spec.names,
        free_spec.scales,
        solution.parameters,
        identifiable_directions,
        solution.covariance,
        solution.residuals,
        dof,
        status,
        *missed_and_spurious(solution),
    )


def _require_enough_data(n_measured_values, value_noun, parameter_units, start_phase):
    n_unknowns = len(parameter_units) + 2 + (start_phase is None)
    if n_measured_values < n_unknowns:
        rule = f"must hold at least {n_unknowns} values, as many as unknowns including the initial state"
        raise check.ArgumentError("data", rule, f"{n_measured_values} {value_noun}")


def _make_free_spec(scene, start_phase, parameter_units, change_bounds):
    """Make the `FreeParameterSpec`, including the phase of the drive at time 0 if it is unknown."""
    names, scales, (lower_change, upper_change) = (
        tuple(parameter_units),
        np.array(list(parameter_units.values())),
        change_bounds,
    )
    start_values = np.array([float(scene.parameter(name)) for name in names])
    if start_phase is None:
        names, scales, start_values = (*names, "phase"), np.append(scales, PHASE_SCALE), np.append(start_values, 0.0)
        lower_change, upper_change = np.append(lower_change, -np.inf), np.append(upper_change, np.inf)
    return FreeParameterSpec(
        scene, start_phase or 0.0, names, scales, start_values, lower_change, upper_change, np.eye(len(names))
    )


def _match_impact_record(fit_problem, data):
    """Return the `ImpactChain` of a record of impacts, or None; if the phase is unknown, try several start phases."""
    if data.phase is not None:
        return match_impact_record(fit_problem, data.flawed)
    head_fit_trials = []
    for start_phase in 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES:
        phase_problem = fit_problem._replace(free_spec=fit_problem.free_spec.with_start_phase(np.array([start_phase])))
        head_problem = phase_problem._replace(
            times=phase_problem.times[:HEAD_IMPACTS],
            sides=phase_problem.sides[:HEAD_IMPACTS],
            sigma=phase_problem.sigma[:HEAD_IMPACTS],
        )
        chain = match_impact_record(head_problem, False)
        if chain is not None:
            head_fit_trials.append((chain.cost, start_phase, phase_problem))
    head_fit_trials.sort(key=lambda trial: trial[:2])
    chains = [match_impact_record(phase_problem, data.flawed) for _, _, phase_problem in head_fit_trials[:MAX_CHAINS]]
    return min((chain for chain in chains if chain is not None), key=lambda chain: chain.cost, default=None)


def _refuse_underdetermined(data, free_spec, solution, n_independent_values):
    """Raise ArgumentError if a settled record holds fewer independent values than there are free parameters."""
    if n_independent_values is None or n_independent_values >= len(free_spec.names):
        return
    combinations_text = ""
    if solution is not None:
        identifiable_directions = fit_result.identify_directions(
            np.linalg.inv(solution.covariance) - free_spec.prior_information
        )
        combinations_text = ": " + "; ".join(
            map(str, identifiable_directions.combinations(free_spec.names, slice(n_independent_values)))
        )
    rule = (
        f"must hold at least {len(free_spec.names)} independent values, one per free parameter;"
        f" a settled motion with {n_independent_values} is recorded{combinations_text}"
    )
    raise check.ArgumentError("data", rule, f"{len(data.times)} times")


def _fit_special_points(scene, data, unit_by_group, bounds):
    name_groups = [(key,) if isinstance(key, str) else tuple(key) for key in unit_by_group]
    if len(data.values) < len(name_groups):
        rule = f"must hold at least {len(name_groups)} values, as many as unknowns"
        raise check.ArgumentError("data", rule, f"{len(data.values)} points")
    scales, lower, upper = _group_scales_and_bounds(scene, unit_by_group, name_groups, bounds)
    parameter_group_labels, start_values = (
        [" = ".join(name_group) for name_group in name_groups],
        np.array([common_parameter_value(scene, name_group) for name_group in name_groups]),
    )
    solution = special_point_fit.fit_special_points(
        special_point_fit.make_point_problem(data, tuple(name_groups), scales, lower, upper), start_values
    )
    if solution is None or not solution.converged:
        return fit_result.build_empty_fit(scene, parameter_group_labels, start_values)
    identifiable_directions = fit_result.identify_directions(solution.jacobian.T @ solution.jacobian)
    is_determined = ~identifiable_directions.is_undetermined
    dof = len(solution.residuals) - int(np.sum(is_determined))
    determined_vectors = identifiable_directions.combination_vectors[:, is_determined]
    covariance = (determined_vectors * identifiable_directions.errors[is_determined] ** 2) @ determined_vectors.T
    status = fit_result.status_if_misfit(float(solution.residuals @ solution.residuals), dof)
    status = status or (FitStatus.UNIDENTIFIABLE if identifiable_directions.is_undetermined.any() else FitStatus.OK)
    values = {
        name: float(parameter_value)
        for name_group, parameter_value in zip(name_groups, solution.parameters, strict=True)
        for name in name_group
    }
    return fit_result.build_fit(
        scene.replace(**values),
        parameter_group_labels,
        scales,
        solution.parameters,
        identifiable_directions,
        covariance,
        solution.residuals,
        dof,
        status,
    )


def _group_scales_and_bounds(scene, unit_by_group, name_groups, bounds):
    """Return (scales, lower bounds, upper bounds) of the free parameters, each a group of names.

    Raises ArgumentError if `unit_by_group` or `bounds` is invalid.
    """
    if not isinstance(unit_by_group, Mapping) or not unit_by_group:
        raise check.ArgumentError("free", "must be {name: unit} with at least one parameter", unit_by_group)
    for key in bounds:
        if key not in unit_by_group:
            raise check.ArgumentError(f"bounds.{key}", "must belong to a free parameter", key)
    scales_and_bounds = []
    for key, name_group in zip(unit_by_group, name_groups, strict=True):
        value, member_bounds = common_parameter_value(scene, name_group), []
        for name in name_group:
            unit_by_name = check_free_parameters(scene, {name: unit_by_group[key]})
            member_bounds.append(
                [
                    value + unit_by_name[name] * change_limit[0]
                    for change_limit in bounds_of_changes(
                        scene, unit_by_name, {name: bounds[key]} if key in bounds else {}
                    )
                ]
            )
        scales_and_bounds.append(
            (unit_by_name[name], max(lower for lower, _ in member_bounds), min(upper for _, upper in member_bounds))
        )
    return np.array(scales_and_bounds).T
