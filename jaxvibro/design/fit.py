"""Fit parameters of a scene to a record of impacts, samples or special points: `fit`."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene import check
from ..scene.input_warnings import warn_about_record
from ..scene.parameters import common_value
from ..scene.scene import SIDES, Scene
from . import chain_fit, fitted, point_fit, sample_fit
from .chain_search import match_record
from .fitted import Fit, FitStatus
from .free_parameters import allowed_changes, check_units
from .impact_chains import IMPOSSIBLE_COST, Record, is_possible, measurements_of, scene_and_phase
from .least_squares import FreeParameters
from .periodic_records import count_impact_values, count_sample_values
from .records import ImpactRecord, PointRecord, SampleRecord

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
        Initial scene, in double precision. The free parameters may be off by a few times their scale.
    data : ImpactRecord or SampleRecord or PointRecord
        The record.
    free : dict of str or tuple of str to float
        Free parameters, each with the scale by which it may be off. For a `PointRecord`, a tuple of names is one
        parameter of several numbers that share a value.
    bounds : dict of str or tuple of str to sequence of float, optional
        Lower and upper bound of free parameters. By default their domains.

    Returns
    -------
    Fit
        Parameter values, errors, and the combinations that the record does not determine.

    Raises
    ------
    ArgumentError
        If the scene is in single precision, if a name is not a parameter of the scene, if a scale is not a positive
        number, if `bounds` does not contain the scene, if the record refers to a wall that the scene does not have, or
        if the record holds fewer values than there are unknowns. A record of a settled motion holds only the phases of
        its impacts, or the samples of one cycle, and its period if the frequency is free.

    See Also
    --------
    ImpactRecord : Record of impacts.
    SampleRecord : Record of samples.
    PointRecord : Record of special points.

    Notes
    -----
    The initial state of the motion is always unknown. The time of an impact on a soft wall is the time of entry.

    Special points are functions of the scene (`located`), fitted by the Gauss-Newton method. Impacts are explained by a
    chain of flights, each as exact as in `strobe`, and samples by short shots as exact as in `sample`. Chaotic motions
    are fitted as accurately as periodic ones (multiple shooting [1]_). Errors follow from the linear theory of least
    squares.

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
    if not isinstance(scene, Scene):
        raise check.ArgumentError("scene", "must be a Scene", scene)
    check.require_single(scene)
    check.require_spring(scene, "fit")
    if scene.dtype != np.float64:
        raise check.ArgumentError("scene", "must be in double precision", np.dtype(scene.dtype).name)
    if isinstance(data, PointRecord):
        return _fit_points(scene, data, free, bounds or {})
    if not isinstance(data, ImpactRecord | SampleRecord):
        raise check.ArgumentError("data", "must be an ImpactRecord, a SampleRecord or a PointRecord", data)
    units = check_units(scene, free)
    change_bounds = allowed_changes(scene, units, bounds or {})
    warn_about_record(scene, data)
    return (_fit_impacts if isinstance(data, ImpactRecord) else _fit_samples)(scene, data, units, change_bounds)


def _fit_impacts(scene, data, units, change_bounds):
    for side in np.unique(data.sides):
        if SIDES[int(side > 0)] not in scene.walls:
            raise check.ArgumentError(
                "data.sides", f"must be sides of its walls; the scene has no {SIDES[int(side > 0)]} wall", int(side)
            )
    _require_enough_data(len(data.times), "times", units, data.phase)
    free_params, sigma = (
        _make_free_params(scene, data.phase, units, change_bounds),
        np.full(len(data.times), data.sigma),
    )
    record = Record(scene, data.phase or 0.0, data.times, data.sides.astype(float), sigma, free_params)

    chain = _match_record(record, data)
    first_solution = None if chain is None or chain.cost >= IMPOSSIBLE_COST else chain.solution
    _refuse_undetermined(
        data, free_params, first_solution, count_impact_values(data, float(scene.frequency), "frequency" in units)
    )
    if first_solution is None:
        return fitted.build_empty_fit(scene, free_params.names, free_params.start_values)
    free_params, measurements = free_params.with_start_phase(first_solution.parameters), measurements_of(record, chain)

    def solve_with(free_params):
        return chain_fit.fit_chain_parameters(
            scene, record.phase, first_solution.nodes, measurements, free_params, first_solution.parameters
        )

    solution, directions = fitted.solve_identifiable(first_solution, free_params, solve_with)
    dof = len(measurements.node_indices) - 2 - int(np.sum(~directions.is_undetermined))
    status = (
        fitted.fit_status(free_params, solution, directions, dof) if is_possible(record, solution) else FitStatus.MISFIT
    )
    missed_impacts = tuple(
        (float(solution.nodes.first_unknown[k]), int(solution.nodes.sides[k]))
        for k in np.flatnonzero(chain.record_indices < 0)
    )
    return _build_fit(
        scene_and_phase(record, solution.parameters)[0],
        free_params,
        solution,
        directions,
        dof,
        status,
        missed_impacts,
        tuple(sorted(chain.spurious_indices)),
    )


def _fit_samples(scene, data, units, change_bounds):
    n_values = data.measured[0].size
    _require_enough_data(n_values, "values", units, data.phase)
    free_params = _make_free_params(scene, data.phase, units, change_bounds)
    samples = sample_fit.make_samples(scene, data, free_params)
    first_solution = sample_fit.follow_record(samples)
    _refuse_undetermined(
        data,
        free_params,
        first_solution,
        None if "frequency" in units else count_sample_values(data, float(scene.frequency)),
    )
    if first_solution is None:
        return fitted.build_empty_fit(scene, free_params.names, free_params.start_values)
    free_params = free_params.with_start_phase(first_solution.parameters)

    def solve_with(free_params):
        return sample_fit.solve_samples(samples, first_solution, free_params)

    solution, directions = fitted.solve_identifiable(first_solution, free_params, solve_with)
    dof = n_values - 2 - int(np.sum(~directions.is_undetermined))
    status = fitted.fit_status(free_params, solution, directions, dof) if solution.converged else FitStatus.MISFIT
    return _build_fit(samples.scene_and_phase(solution.parameters)[0], free_params, solution, directions, dof, status)


def _require_enough_data(n_values, data_name, units, phase):
    n_unknowns = len(units) + 2 + (phase is None)
    if n_values < n_unknowns:
        rule = f"must hold at least {n_unknowns} values, as many as unknowns including the initial state"
        raise check.ArgumentError("data", rule, f"{n_values} {data_name}")


def _make_free_params(scene, phase, units, change_bounds):
    """Make the `FreeParameters`, including the phase of the drive at time 0 if it is unknown."""
    names, scales, (lower, upper) = tuple(units), np.array(list(units.values())), change_bounds
    start_values = np.array([float(scene.parameter(name)) for name in names])
    if phase is None:
        names, scales, start_values = (*names, "phase"), np.append(scales, PHASE_SCALE), np.append(start_values, 0.0)
        lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
    return FreeParameters(names, scales, start_values, lower, upper, np.eye(len(names)))


def _match_record(record, data):
    """Return the `ImpactChain` of a record of impacts, the best of several start phases if the phase is unknown."""
    if data.phase is not None:
        return match_record(record, data.flawed)
    trials = []
    for angle in 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES:
        candidate = record._replace(free_params=record.free_params.with_start_phase(np.array([angle])))
        head_record = candidate._replace(
            times=candidate.times[:HEAD_IMPACTS],
            sides=candidate.sides[:HEAD_IMPACTS],
            sigma=candidate.sigma[:HEAD_IMPACTS],
        )
        chain = match_record(head_record, False)
        if chain is not None:
            trials.append((chain.cost, angle, candidate))
    trials.sort(key=lambda trial: trial[:2])
    chains = [match_record(candidate, data.flawed) for _, _, candidate in trials[:MAX_CHAINS]]
    return min((candidate for candidate in chains if candidate is not None), key=lambda chain: chain.cost, default=None)


def _refuse_undetermined(data, free_params, solution, n_independent):
    """Refuse a settled record that holds fewer values than there are free parameters."""
    if n_independent is None or n_independent >= len(free_params.names):
        return
    hint = ""
    if solution is not None:
        directions = fitted.identify_directions(np.linalg.inv(solution.covariance) - free_params.prior_information)
        hint = ": " + "; ".join(map(str, directions.combinations(free_params.names, slice(n_independent))))
    rule = (
        f"must hold at least {len(free_params.names)} independent values, one per free parameter;"
        f" a settled motion with {n_independent} is recorded{hint}"
    )
    raise check.ArgumentError("data", rule, f"{len(data.times)} times")


def _build_fit(scene, free_params, solution, directions, *details):
    return fitted.build_fit(
        scene,
        free_params.names,
        free_params.scales,
        solution.parameters,
        directions,
        solution.covariance,
        solution.residuals,
        *details,
    )


def _fit_points(scene, data, free, bounds):
    name_groups = [(key,) if isinstance(key, str) else tuple(key) for key in free]
    if len(data.values) < len(name_groups):
        rule = f"must hold at least {len(name_groups)} values, as many as unknowns"
        raise check.ArgumentError("data", rule, f"{len(data.values)} points")
    scales, lower, upper = _group_bounds(scene, free, name_groups, bounds)
    labels, start_values = (
        [" = ".join(name_group) for name_group in name_groups],
        np.array([common_value(scene, name_group) for name_group in name_groups]),
    )
    solution = point_fit.fit_points(
        point_fit.make_point_functions(data, tuple(name_groups), scales, lower, upper), start_values
    )
    if solution is None or not solution.converged:
        return fitted.build_empty_fit(scene, labels, start_values)
    directions, dof = fitted.identify_directions(solution.jacobian.T @ solution.jacobian), len(solution.residuals)
    dof -= int(np.sum(~directions.is_undetermined))
    covariance = (
        directions.vectors[:, ~directions.is_undetermined] * directions.errors[~directions.is_undetermined] ** 2
    ) @ directions.vectors[:, ~directions.is_undetermined].T
    status = fitted.misfit_status(float(solution.residuals @ solution.residuals), dof)
    status = status or (FitStatus.UNIDENTIFIABLE if directions.is_undetermined.any() else FitStatus.OK)
    values = {
        name: float(parameter)
        for name_group, parameter in zip(name_groups, solution.parameters, strict=True)
        for name in name_group
    }
    changed_scene = scene.replace(**values)
    return fitted.build_fit(
        changed_scene, labels, scales, solution.parameters, directions, covariance, solution.residuals, dof, status
    )


def _group_bounds(scene, free, name_groups, bounds):
    """Return (scales, lower, upper) of the free parameters, each of one or several names. Raises ArgumentError."""
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit} with at least one parameter", free)
    for key in bounds:
        if key not in free:
            raise check.ArgumentError(f"bounds.{key}", "must belong to a free parameter", key)
    rows = []
    for key, name_group in zip(free, name_groups, strict=True):
        value, name_bounds = common_value(scene, name_group), []
        for name in name_group:
            unit = check_units(scene, {name: free[key]})
            name_bounds.append(
                [
                    value + unit[name] * change[0]
                    for change in allowed_changes(scene, unit, {name: bounds[key]} if key in bounds else {})
                ]
            )
        rows.append((unit[name], max(lower for lower, _ in name_bounds), min(upper for _, upper in name_bounds)))
    return np.array(rows).T
