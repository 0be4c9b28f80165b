"""Which numbers of a scene made a record: `fit`."""

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

N_PHASES, HEAD_IMPACTS, MAX_CHAINS = (
    8,
    10,
    3,
)  # of an unknown phase: starts, impacts that choose among them, how many are gone on with
PHASE_SCALE = 0.5  # rad: the scale of an unknown phase


@check.host_only("use the chain's equations")
def fit(
    scene: Scene,
    data: ImpactRecord | SampleRecord | PointRecord,
    free: Mapping[str | tuple[str, ...], float],
    bounds: Mapping[str | tuple[str, ...], Sequence[float]] | None = None,
) -> Fit:
    """The numbers of a scene that made a record, with their errors: a `Fit`.

    scene: where it begins, some scales off at most; data: an `ImpactRecord`, a `SampleRecord` or a `PointRecord`; free:
    {name: scale}, of the numbers that are not known, and by how much each may be off; bounds: {name: (low, high)} of
    free numbers, by default their domains. Of a `PointRecord` a tuple of names is one number, of several that have one
    value. The first state of a motion is never known. An impact on a soft wall is when the mass comes to it.

    Points are functions of the scene (`located`), fitted by Gauss and Newton. Impacts are explained by a chain of
    flights, each as exact as in `strobe`, samples by short shots as exact as in `sample`; where the motion is chaotic
    nothing is lost (multiple shooting; Bock 1981). Errors are those of least squares, of the linear theory.

    Raises ArgumentError for a scene in single precision, names that the scene lacks, scales that are none, bounds that
    do not hold the scene, walls that the scene lacks, and where more is unknown than the record holds: a settled record
    holds its impacts' phases alone, or its samples of one round, and its period where the frequency is free.
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
            raise check.ArgumentError("data.sides", f"the scene has no {SIDES[int(side > 0)]} wall", int(side))
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
    _require_enough_data(n_values, "numbers", units, data.phase)
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
        rule = f"must hold as many numbers as are unknown, {n_unknowns} with the first state"
        raise check.ArgumentError("data", rule, f"{n_values} {data_name}")


def _make_free_params(scene, phase, units, change_bounds):
    """The `FreeParameters` numbers, the drive's phase at time 0 among them where it is not known."""
    names, scales, (lower, upper) = tuple(units), np.array(list(units.values())), change_bounds
    start_values = np.array([float(scene.parameter(name)) for name in names])
    if phase is None:
        names, scales, start_values = (*names, "phase"), np.append(scales, PHASE_SCALE), np.append(start_values, 0.0)
        lower, upper = np.append(lower, -np.inf), np.append(upper, np.inf)
    return FreeParameters(names, scales, start_values, lower, upper, np.eye(len(names)))


def _match_record(record, data):
    """The `Chain` of a record of impacts: of an unknown phase the best of several."""
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
    """Refuse a settled record that holds fewer numbers than are free."""
    if n_independent is None or n_independent >= len(free_params.names):
        return
    hint = ""
    if solution is not None:
        directions = fitted.identify_directions(np.linalg.inv(solution.covariance) - free_params.prior_information)
        hint = ": " + "; ".join(map(str, directions.combinations(free_params.names, slice(n_independent))))
    rule = (
        f"is settled, holds {n_independent} numbers and must hold as many as are free, {len(free_params.names)}{hint}"
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
        rule = f"must hold as many numbers as are unknown, {len(name_groups)}"
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
    """(scales, low, high) of free numbers, each of one or several names. Raises ArgumentError."""
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit}, one number at least", free)
    for key in bounds:
        if key not in free:
            raise check.ArgumentError(f"bounds.{key}", "must be of a free number", key)
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
