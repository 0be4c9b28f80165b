"""Place bifurcations at given parameter values by the least change of the scene: `place`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from continuation.branch_segment import EXPIRED_REASON, make_limits

from ..branches.branch import Special
from ..output.table_text import align_columns
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import SolutionStatus
from .free_parameters import FreeParameters, bounds_of_changes, check_free_parameters
from .located import Located, located

MAX_ITERATIONS = 30  # Newton steps
DIFFERENCE_STEP = 1e-5  # in units: step of central differences
MIN_FRACTION = 1.0 / 256.0  # of the path: the search ends if a shorter step fails
MAX_STEP = 1.0  # longest Newton step, relative to 1 + the change in units
ROUNDING_TOLERANCE = 1e-13  # relative to 1 + the largest entry: rounding
ValueFunction = Callable[[Scene], Float[jax.Array, ""]]


@dataclass(frozen=True, eq=False)
class Placement:
    """Result of `place`.

    Attributes
    ----------
    scene : Scene
        New scene. If the targets are not attained, the last scene with admissible orbits on the path towards them.
    change : dict of str to float
        Change of each free parameter.
    distance : float
        Root of the sum of squares of change / unit.
    values : numpy.ndarray
        Values that were placed, in the new scene. Array of shape (targets,).
    targets : numpy.ndarray
        Target values. Array of shape (targets,).
    met : bool
        True if the values attain the targets.
    why : str
        Reason why the targets are not attained, or an empty string.
    at_bound : tuple of str
        Names of the free parameters that are at a bound, or that end the path because they reach a bound just beyond
        this end.
    slope : float
        Largest residual of the condition that the change is minimal.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> placed = jv.place(special, None, 0.55, {"damping": 0.01})
    >>> placed.met, {name: round(change, 6) for name, change in placed.change.items()}
    (True, {'damping': 0.010462})
    """

    scene: Scene = field(repr=False)
    change: dict[str, float]
    distance: float
    values: Float[np.ndarray, " targets"]
    targets: Float[np.ndarray, " targets"]
    met: bool
    why: str
    at_bound: tuple[str, ...]
    slope: float

    def table(self) -> str:
        """Format the free parameters before and after, and the values, as text.

        Returns
        -------
        str
            Table with one line per free parameter, one line per value, and the reason if the targets are not attained.
        """
        rows = [("parameter", "before", "after")]
        for name, change in self.change.items():
            new_value = float(self.scene.parameter(name))
            rows.append(
                (name, f"{new_value - change:.9g}", f"{new_value:.9g}" + (" (bound)" if name in self.at_bound else ""))
            )
        value_lines = [
            f"value {value:.9g}, target {target:.9g}" for value, target in zip(self.values, self.targets, strict=True)
        ]
        return "\n".join([align_columns(rows), *value_lines, *([self.why] if self.why else [])])


class _PlacementProblem(NamedTuple):
    """Free parameters and functions of a placement.

    Attributes
    ----------
    parameters : FreeParameters
        Free parameters of the initial scene.
    evaluate : callable
        Function of changes of shape (points, free) that returns values and Jacobians.
    inadmissible_kinds : callable
        Function of a change of shape (free,) that returns the kinds of the points whose orbit is inadmissible.
    """

    parameters: FreeParameters
    evaluate: Callable[
        [Float[np.ndarray, "places free"]],
        tuple[Float[np.ndarray, "places targets"], Float[np.ndarray, "places targets free"]],
    ]
    inadmissible_kinds: Callable[[Float[np.ndarray, " free"]], list[str]]


class _TargetPathPoint(NamedTuple):
    """Point on the path to the targets.

    Attributes
    ----------
    fraction : float
        Fraction of the path.
    change : numpy.ndarray
        Change of the free parameters, in units.
    multipliers : numpy.ndarray
        Lagrange multipliers of the targets.
    is_at_bound : numpy.ndarray
        Mask of the free parameters at a bound.
    slope : float
        Residual of the optimality condition.
    is_time_expired : bool
        True if the time expired at this point.
    """

    fraction: float
    change: Float[np.ndarray, " free"]
    multipliers: Float[np.ndarray, " targets"]
    is_at_bound: Bool[np.ndarray, " free"]
    slope: float
    is_time_expired: bool = False


@check.host_only("use the function that located gives")
def place(
    what: Special | ValueFunction | Sequence[Special | ValueFunction],
    name: str | None,
    target: float | Sequence[float],
    free: Mapping[str, float],
    bounds: Mapping[str, Sequence[float]] | None = None,
    scene: Scene | None = None,
    *,
    max_seconds: float | None = None,
) -> Placement:
    """Place special points at given values by the least change of several parameters.

    Parameters
    ----------
    what : Special, callable, or sequence of these
        Special points, or JAX functions of a scene, for example a `Located` or the difference of two.
    name : str or None
        Parameter whose value is placed, for every `Special`. None selects the parameter of each point.
    target : float or sequence of float
        Target value of each entry of `what`.
    free : dict of str to float
        Free parameters, each with its unit. The sum of squares of change / unit is minimised.
    bounds : dict of str to sequence of float, optional
        Lower and upper bound of free parameters, by name. By default their domains.
    scene : Scene, optional
        Initial scene. By default the scene of the first `Special`.
    max_seconds : float, optional
        Wall-clock time in s after which the search stops. The attribute ``why`` then states this reason. By default the
        time is unlimited.

    Returns
    -------
    Placement
        The new scene, the change and the values.

    Raises
    ------
    ArgumentError
        If a free parameter is the placed parameter, if a unit is missing or not positive, if there are more targets
        than free parameters, or if another argument is invalid.

    See Also
    --------
    located : Special points as functions of scenes.
    sensitivity : Derivatives of the value of a special point.

    Notes
    -----
    The values approach the targets along the straight path from the present values. Newton's method solves the
    Karush-Kuhn-Tucker conditions at each point of the path. If the path ends before the targets, or if an orbit at the
    targets is inadmissible, ``met`` is False and ``why`` states the reason. The scene, change and values are then those
    of the last point on the path at which all orbits are admissible, to 1/256 of the path.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> placed = jv.place(special, None, 0.55, {"damping": 0.01})
    >>> round(float(placed.scene.damping), 6)
    0.060462
    """
    limits = make_limits(None, max_seconds, None, check.ArgumentError)
    value_sources = tuple(what) if isinstance(what, list | tuple) else (what,)
    target_values = np.atleast_1d(np.asarray(target, float))
    value_functions = [
        located(value_source, name) if isinstance(value_source, Special) else value_source
        for value_source in value_sources
    ]
    first_special = next((value_source for value_source in value_sources if isinstance(value_source, Special)), None)
    start_scene = scene if scene is not None else getattr(first_special, "scene", None)
    if not isinstance(start_scene, Scene):
        raise check.ArgumentError("scene", "must be a Scene if no Special is given", scene)
    if not all(callable(value_function) for value_function in value_functions):
        raise check.ArgumentError("what", "must be a Special or a function of a scene", what)
    units = check_free_parameters(start_scene, free)
    placed_names = {value_function.name for value_function in value_functions if isinstance(value_function, Located)}
    for key in placed_names & set(units):
        raise check.ArgumentError(f"free.{key}", "must not be a parameter that is placed", units[key])
    if (
        target_values.shape != (len(value_functions),)
        or not np.isfinite(target_values).all()
        or len(target_values) > len(units)
    ):
        rule = (
            f"must be a finite number for each of {len(value_functions)} values, and at most as many as free"
            f" parameters, {len(units)}"
        )
        raise check.ArgumentError("target", rule, target)
    parameters = FreeParameters(start_scene, units, *bounds_of_changes(start_scene, units, bounds or {}))
    problem = _make_placement_problem(parameters, value_functions)
    return _make_placement(problem, target_values, *_follow_path_to_targets(problem, target_values, limits))


def _make_placement_problem(parameters, value_functions):
    def evaluate_values(change):
        changed_scene = parameters.scene_after(change)
        values = jnp.stack([function(changed_scene) for function in value_functions])
        return values, values

    jacobians_and_values = jax.vmap(jax.jacrev(evaluate_values, has_aux=True))
    # The functions that a special point calls are compiled already.
    if not all(isinstance(value_function, Located) for value_function in value_functions):
        jacobians_and_values = jax.jit(jacobians_and_values)

    def values_and_jacobians(changes):
        jacobians, values = jax.device_get(jacobians_and_values(changes))
        return values, jacobians

    def inadmissible_kinds(change):
        changed_scene = parameters.scene_after(change)
        located_functions = [function for function in value_functions if isinstance(function, Located)]
        return [
            function.special.kind
            for function in located_functions
            if function.solve(changed_scene).status == SolutionStatus.VIRTUAL
        ]

    return _PlacementProblem(parameters, values_and_jacobians, inadmissible_kinds)


def _follow_path_to_targets(problem, target_values, limits):
    """Follow the path to the targets within the time limit.

    Returns the last admissible `_TargetPathPoint`, a mask of the parameters that are at a bound at this point or block
    the path beyond it, and the kinds of the special points whose orbits are inadmissible beyond it."""
    n_params = len(problem.parameters.names)
    path_point = last_admissible_point = _TargetPathPoint(
        0.0, np.zeros(n_params), np.zeros(len(target_values)), np.zeros(n_params, bool), 0.0
    )
    start_values = problem.evaluate(_difference_stencil(path_point.change))[0][0]
    if not np.isfinite(start_values).all():
        raise check.ArgumentError("scene", "must have all points that are to be placed", start_values)

    def solve_at_fraction(path_point, fraction):
        solution, is_blocking_bound = _solve_within_bounds(
            problem,
            path_point.change,
            path_point.multipliers,
            path_point.is_at_bound,
            start_values + fraction * (target_values - start_values),
        )
        return None if solution is None else _TargetPathPoint(fraction, *solution), is_blocking_bound

    fraction_step, inadmissible_kinds = 1.0, problem.inadmissible_kinds(path_point.change)
    is_blocking_bound, is_time_expired = path_point.is_at_bound, False
    while path_point.fraction < 1.0 and fraction_step >= MIN_FRACTION and not (is_time_expired := limits.expired):
        next_point, is_blocking_bound = solve_at_fraction(path_point, min(1.0, path_point.fraction + fraction_step))
        if next_point is None:
            fraction_step *= 0.5
        else:
            path_point, fraction_step = next_point, 2.0 * fraction_step
            inadmissible_kinds = problem.inadmissible_kinds(path_point.change)
            last_admissible_point = last_admissible_point if inadmissible_kinds else path_point
    if not inadmissible_kinds:
        return (
            path_point._replace(is_time_expired=is_time_expired),
            path_point.is_at_bound if path_point.fraction == 1.0 or is_time_expired else is_blocking_bound,
            inadmissible_kinds,
        )
    inadmissible_fraction = path_point.fraction
    while inadmissible_fraction - last_admissible_point.fraction > MIN_FRACTION and not (
        is_time_expired := is_time_expired or limits.expired
    ):
        middle_fraction = 0.5 * (last_admissible_point.fraction + inadmissible_fraction)
        next_point, _ = solve_at_fraction(last_admissible_point, middle_fraction)
        if next_point is None or problem.inadmissible_kinds(next_point.change):
            inadmissible_fraction = middle_fraction
        else:
            last_admissible_point = next_point
    return (
        last_admissible_point._replace(is_time_expired=is_time_expired),
        last_admissible_point.is_at_bound,
        inadmissible_kinds,
    )


def _solve_within_bounds(problem, change_iterate, multipliers, is_at_bound, target_values):
    """Find the least change within the bounds that attains the target values, by an active-set method.

    Returns the solution and the last mask of the parameters at a bound. The solution is (change, multipliers, mask,
    slope), or None if Newton's method fails.
    """
    lower, upper = problem.parameters.lower, problem.parameters.upper
    for _ in range(2 * len(change_iterate) + 1):
        solution = _solve_kkt(problem, change_iterate, multipliers, is_at_bound, target_values)
        if solution is None:
            return None, is_at_bound
        change_iterate, multipliers, lagrangian_descent, slope = solution
        bound_excess = np.where(is_at_bound, 0.0, np.maximum(change_iterate - upper, lower - change_iterate))
        inward_descent_rates = np.where(change_iterate >= upper, -lagrangian_descent, lagrangian_descent)
        descent_rates_at_bounds = np.where(
            is_at_bound, inward_descent_rates, 0.0
        )  # positive if a parameter would leave its bound inwards
        if bound_excess.max() > ROUNDING_TOLERANCE:
            worst_index = int(np.argmax(bound_excess))
            is_at_bound = is_at_bound | (np.arange(len(is_at_bound)) == worst_index)
            change_iterate = np.clip(change_iterate, lower, upper)
        elif descent_rates_at_bounds.max() > ROUNDING_TOLERANCE * (1.0 + abs(lagrangian_descent).max()):
            is_at_bound = is_at_bound & (np.arange(len(is_at_bound)) != int(np.argmax(descent_rates_at_bounds)))
        else:
            return (change_iterate, multipliers, is_at_bound, slope), is_at_bound
    return None, is_at_bound


def _difference_stencil(change):
    """Return a change, followed by the points at which central differences about this change are evaluated."""
    difference_steps = DIFFERENCE_STEP * np.eye(len(change))
    return np.concatenate([change[None], change + difference_steps, change - difference_steps])


def _solve_kkt(problem, change, multipliers, is_at_bound, target_values):
    """Solve the Karush-Kuhn-Tucker conditions by Newton's method, with the parameters at a bound fixed.

    Returns (change, multipliers, negative gradient of the Lagrangian, largest free component of the gradient), or None
    if the method fails.
    """
    n_params, n_targets, step_length, is_free = len(change), len(target_values), np.inf, ~is_at_bound
    for _ in range(MAX_ITERATIONS):
        values, jacobians = problem.evaluate(_difference_stencil(change))
        if not (np.isfinite(values).all() and np.isfinite(jacobians).all()):
            return None
        jacobian, jacobian_derivatives = (
            jacobians[0],
            (jacobians[1 : n_params + 1] - jacobians[n_params + 1 :]) / (2.0 * DIFFERENCE_STEP),
        )
        lagrangian_hessian = np.eye(n_params) + np.einsum("jci,c->ij", jacobian_derivatives, multipliers)
        lagrangian_hessian = 0.5 * (lagrangian_hessian + lagrangian_hessian.T)
        lagrangian_gradient, value_errors = change + multipliers @ jacobian, values[0] - target_values
        rounding_threshold = ROUNDING_TOLERANCE * (1.0 + abs(change).max())
        if step_length <= 1e-9 * (1.0 + abs(change).max()):
            return change, multipliers, -lagrangian_gradient, float(abs(lagrangian_gradient[is_free]).max(initial=0.0))
        if is_free.sum() < n_targets:
            return None
        kkt_matrix = np.zeros((is_free.sum() + n_targets,) * 2)
        free_hessian = lagrangian_hessian[np.ix_(is_free, is_free)]
        kkt_matrix[:-n_targets, :-n_targets] = (
            free_hessian if np.linalg.eigvalsh(free_hessian).min() > rounding_threshold else np.eye(is_free.sum())
        )
        kkt_matrix[-n_targets:, :-n_targets], kkt_matrix[:-n_targets, -n_targets:] = (
            jacobian[:, is_free],
            jacobian[:, is_free].T,
        )
        try:
            solution = -np.linalg.solve(kkt_matrix, np.concatenate([change[is_free], value_errors]))
        except np.linalg.LinAlgError:
            return None
        full_step, next_multipliers = np.zeros(n_params), solution[-n_targets:]
        full_step[is_free] = solution[:-n_targets]
        step_fraction = min(1.0, MAX_STEP * (1.0 + np.linalg.norm(change)) / max(np.linalg.norm(full_step), 1e-300))
        change, multipliers, step_length = (
            change + step_fraction * full_step,
            next_multipliers,
            float(np.linalg.norm(full_step)),
        )
    return None


def _make_placement(problem, target_values, path_point, is_at_bound, inadmissible_kinds):
    parameters, change = problem.parameters, path_point.change
    bound_names = parameters.select_names(is_at_bound)
    reason = _failure_reason(path_point.fraction, inadmissible_kinds, bound_names, path_point.is_time_expired)
    return Placement(
        scene=parameters.scene_after(change),
        change=parameters.changes_by_name(change),
        distance=float(np.linalg.norm(change)),
        values=problem.evaluate(_difference_stencil(change))[0][0],
        targets=target_values,
        met=not reason,
        why=reason,
        at_bound=bound_names,
        slope=path_point.slope,
    )


def _failure_reason(fraction, inadmissible_kinds, bound_names, is_time_expired):
    """Return the reason why the path to the targets ends, or an empty string if the targets are attained.

    `inadmissible_kinds` are the kinds of special points whose orbits are inadmissible beyond the end of the path.
    `bound_names` are the parameters at a bound."""
    if fraction == 1.0:
        return ""
    cause = "the point cannot be continued (it meets another point, or its value has an extremum)"
    if is_time_expired:
        cause = EXPIRED_REASON
    elif inadmissible_kinds:
        cause = f"the orbit of the {inadmissible_kinds[0]} passes through a wall beyond it"
    elif bound_names:
        cause = f"{', '.join(bound_names)} {'are' if len(bound_names) > 1 else 'is'} at a bound"
    return f"the path to the targets ends after {fraction:.3g} of its length: {cause}"
