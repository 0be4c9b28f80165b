"""Place bifurcations at given parameter values by the least change of the scene: `place`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from continuation.limits import EXPIRED_REASON, UNLIMITED, limits_of

from ..branches.branch import Special
from ..output.table_text import align_columns
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from .free_parameters import allowed_changes, check_units
from .located import located
from .located_point import Located

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
        New scene. If the targets cannot be attained, the last scene on the path towards them.
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
        Names of the free parameters that are at a bound.
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
    names : tuple of str
        Names of the free parameters.
    units : numpy.ndarray
        Unit of each free parameter.
    start_values : numpy.ndarray
        Initial values of the free parameters.
    lower, upper : numpy.ndarray
        Bounds of the change, in units.
    evaluate : callable
        Function of changes of shape (points, free) that returns values and Jacobians.
    virtual_kinds : callable
        Function of a change of shape (free,) that returns the kinds of the points whose orbit is inadmissible.
    """

    names: tuple[str, ...]
    units: Float[np.ndarray, " free"]
    start_values: Float[np.ndarray, " free"]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]
    evaluate: Callable[
        [Float[np.ndarray, "places free"]],
        tuple[Float[np.ndarray, "places targets"], Float[np.ndarray, "places targets free"]],
    ]
    virtual_kinds: Callable[[Float[np.ndarray, " free"]], list[str]]


class _PathPoint(NamedTuple):
    """Point on the path to the targets.

    Attributes
    ----------
    fraction : float
        Fraction of the path.
    change : numpy.ndarray
        Change of the free parameters, in units.
    multipliers : numpy.ndarray
        Lagrange multipliers of the targets.
    at_bound : numpy.ndarray
        Mask of the free parameters at a bound.
    slope : float
        Residual of the optimality condition.
    is_expired : bool
        True if the time expired at this point.
    """

    fraction: float
    change: Float[np.ndarray, " free"]
    multipliers: Float[np.ndarray, " targets"]
    at_bound: Bool[np.ndarray, " free"]
    slope: float
    is_expired: bool = False


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
        Wall-clock time in s after which the search stops, which ``why`` then states. By default the time is unlimited.

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
    The targets are approached along the straight path from the present values. Newton's method solves the
    Karush-Kuhn-Tucker conditions at each point of the path. If the path ends before the targets, or if an orbit at the
    targets is inadmissible, ``met`` is False, ``why`` states the reason, and the scene, change and values are those of
    the last point on the path whose orbits are all admissible, to 1/256 of the path.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> placed = jv.place(special, None, 0.55, {"damping": 0.01})
    >>> round(float(placed.scene.damping), 6)
    0.060462
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    sources = tuple(what) if isinstance(what, list | tuple) else (what,)
    target_values = np.atleast_1d(np.asarray(target, float))
    value_functions = [located(source, name) if isinstance(source, Special) else source for source in sources]
    first_special = next((source for source in sources if isinstance(source, Special)), None)
    start_scene = scene if scene is not None else getattr(first_special, "scene", None)
    if not isinstance(start_scene, Scene):
        raise check.ArgumentError("scene", "must be a Scene if no Special is given", scene)
    if not all(callable(function) for function in value_functions):
        raise check.ArgumentError("what", "must be a Special or a function of a scene", what)
    free = check_units(start_scene, free)
    target_names = {function.name for function in value_functions if isinstance(function, Located)}
    for key in target_names & set(free):
        raise check.ArgumentError(f"free.{key}", "must not be a parameter that is placed", free[key])
    if (
        target_values.shape != (len(value_functions),)
        or not np.isfinite(target_values).all()
        or len(target_values) > len(free)
    ):
        rule = (
            f"must be a finite number for each of {len(value_functions)} values, and at most as many as free"
            f" parameters, {len(free)}"
        )
        raise check.ArgumentError("target", rule, target)
    problem = _make_problem(start_scene, free, bounds or {}, value_functions)
    return _make_placement(start_scene, problem, target_values, *_approach_targets(problem, target_values, limits))


def _make_problem(scene, free, bounds, value_functions):
    names, units = tuple(free), np.array(list(free.values()))
    start_values = np.array([float(scene.parameter(name)) for name in names])

    def evaluate_values(change):
        changed_scene = scene.replace(**dict(zip(names, jnp.asarray(start_values) + change * units, strict=True)))
        values = jnp.stack([function(changed_scene) for function in value_functions])
        return values, values

    jacobian_function = jax.vmap(jax.jacrev(evaluate_values, has_aux=True))
    # The functions that a special point calls are compiled already.
    if not all(isinstance(function, Located) for function in value_functions):
        jacobian_function = jax.jit(jacobian_function)

    def evaluate(changes):
        jacobians, values = jax.device_get(jacobian_function(changes))
        return values, jacobians

    def virtual_kinds(change):
        changed_scene = scene.replace(**dict(zip(names, start_values + change * units, strict=True)))
        located_points = [function for function in value_functions if isinstance(function, Located)]
        return [
            function.special.kind
            for function in located_points
            if function.solve(changed_scene).status == SolutionStatus.VIRTUAL
        ]

    return _PlacementProblem(names, units, start_values, *allowed_changes(scene, free, bounds), evaluate, virtual_kinds)


def _approach_targets(problem, target_values, limits=UNLIMITED):
    """Follow the path to the targets within the time limits.

    Returns the last admissible `_PathPoint`, a mask of the parameters that are at a bound there or block the path, and
    the kinds of the points that are inadmissible beyond it.
    """
    n_params = len(problem.names)
    path_point = last_admissible = _PathPoint(
        0.0, np.zeros(n_params), np.zeros(len(target_values)), np.zeros(n_params, bool), 0.0
    )
    start_values = problem.evaluate(_difference_points(path_point.change))[0][0]
    if not np.isfinite(start_values).all():
        raise check.ArgumentError("scene", "must have all points that are to be placed", start_values)

    def solve_at(path_point, fraction):
        solution, blocking_bounds = _solve_within_bounds(
            problem,
            path_point.change,
            path_point.multipliers,
            path_point.at_bound,
            start_values + fraction * (target_values - start_values),
        )
        return None if solution is None else _PathPoint(fraction, *solution), blocking_bounds

    fraction_step, virtual_kinds = 1.0, problem.virtual_kinds(path_point.change)
    blocking_bounds, is_expired = path_point.at_bound, False
    while path_point.fraction < 1.0 and fraction_step >= MIN_FRACTION and not (is_expired := limits.expired):
        next_point, blocking_bounds = solve_at(path_point, min(1.0, path_point.fraction + fraction_step))
        if next_point is None:
            fraction_step *= 0.5
        else:
            path_point, fraction_step = next_point, 2.0 * fraction_step
            virtual_kinds = problem.virtual_kinds(path_point.change)
            last_admissible = last_admissible if virtual_kinds else path_point
    if not virtual_kinds:
        return (
            path_point._replace(is_expired=is_expired),
            path_point.at_bound if path_point.fraction == 1.0 or is_expired else blocking_bounds,
            virtual_kinds,
        )
    upper_fraction = path_point.fraction
    while upper_fraction - last_admissible.fraction > MIN_FRACTION and not (is_expired := is_expired or limits.expired):
        middle_fraction = 0.5 * (last_admissible.fraction + upper_fraction)
        next_point, _ = solve_at(last_admissible, middle_fraction)
        if next_point is None or problem.virtual_kinds(next_point.change):
            upper_fraction = middle_fraction
        else:
            last_admissible = next_point
    return last_admissible._replace(is_expired=is_expired), last_admissible.at_bound, virtual_kinds


def _solve_within_bounds(problem, change, multipliers, at_bound, target_values):
    """Find the least change within the bounds that attains the target values, by an active-set method.

    Returns the solution (change, multipliers, mask of the parameters at a bound, slope) and the last mask. The solution
    is None if Newton's method fails.
    """
    for _ in range(2 * len(change) + 1):
        solution = _solve_kkt(problem, change, multipliers, at_bound, target_values)
        if solution is None:
            return None, at_bound
        change, multipliers, gradient, slope = solution
        excess = np.where(at_bound, 0.0, np.maximum(change - problem.upper, problem.lower - change))
        release_rates = np.where(change >= problem.upper, -gradient, gradient)
        release_excess = np.where(at_bound, release_rates, 0.0)  # positive if a parameter would leave its bound inwards
        if excess.max() > ROUNDING_TOLERANCE:
            worst_index = int(np.argmax(excess))
            at_bound = at_bound | (np.arange(len(at_bound)) == worst_index)
            change = np.clip(change, problem.lower, problem.upper)
        elif release_excess.max() > ROUNDING_TOLERANCE * (1.0 + abs(gradient).max()):
            at_bound = at_bound & (np.arange(len(at_bound)) != int(np.argmax(release_excess)))
        else:
            return (change, multipliers, at_bound, slope), at_bound
    return None, at_bound


def _difference_points(change):
    """Return the points of central differences about a change; the first is the change itself."""
    steps = DIFFERENCE_STEP * np.eye(len(change))
    return np.concatenate([change[None], change + steps, change - steps])


def _solve_kkt(problem, change, multipliers, at_bound, target_values):
    """Solve the Karush-Kuhn-Tucker conditions by Newton's method.

    Returns (change, multipliers, negative gradient of the Lagrangian, largest free component of the gradient), or None.
    """
    n_params, n_targets, step_length, is_free = len(change), len(target_values), np.inf, ~at_bound
    for _ in range(MAX_ITERATIONS):
        values, jacobians = problem.evaluate(_difference_points(change))
        if not (np.isfinite(values).all() and np.isfinite(jacobians).all()):
            return None
        jacobian, jacobian_derivatives = (
            jacobians[0],
            (jacobians[1 : n_params + 1] - jacobians[n_params + 1 :]) / (2.0 * DIFFERENCE_STEP),
        )
        hessian = np.eye(n_params) + np.einsum("jci,c->ij", jacobian_derivatives, multipliers)
        hessian = 0.5 * (hessian + hessian.T)
        gradient, value_errors = change + multipliers @ jacobian, values[0] - target_values
        tolerance = ROUNDING_TOLERANCE * (1.0 + abs(change).max())
        if step_length <= 1e-9 * (1.0 + abs(change).max()):
            return change, multipliers, -gradient, float(abs(gradient[is_free]).max(initial=0.0))
        if is_free.sum() < n_targets:
            return None
        kkt_matrix = np.zeros((is_free.sum() + n_targets,) * 2)
        free_hessian = hessian[np.ix_(is_free, is_free)]
        kkt_matrix[:-n_targets, :-n_targets] = (
            free_hessian if np.linalg.eigvalsh(free_hessian).min() > tolerance else np.eye(is_free.sum())
        )
        kkt_matrix[-n_targets:, :-n_targets], kkt_matrix[:-n_targets, -n_targets:] = (
            jacobian[:, is_free],
            jacobian[:, is_free].T,
        )
        try:
            solution = -np.linalg.solve(kkt_matrix, np.concatenate([change[is_free], value_errors]))
        except np.linalg.LinAlgError:
            return None
        full_step, new_multipliers = np.zeros(n_params), solution[-n_targets:]
        full_step[is_free] = solution[:-n_targets]
        step_fraction = min(1.0, MAX_STEP * (1.0 + np.linalg.norm(change)) / max(np.linalg.norm(full_step), 1e-300))
        change, multipliers, step_length = (
            change + step_fraction * full_step,
            new_multipliers,
            float(np.linalg.norm(full_step)),
        )
    return None


def _make_placement(scene, problem, target_values, path_point, at_bound, virtual_kinds):
    change = path_point.change
    new_scene = scene.replace(**dict(zip(problem.names, problem.start_values + change * problem.units, strict=True)))
    values = problem.evaluate(_difference_points(change))[0][0]
    names = tuple(name for name, is_bound in zip(problem.names, at_bound, strict=True) if is_bound)
    reason = _failure_reason(path_point.fraction, virtual_kinds, names, path_point.is_expired)
    return Placement(
        scene=new_scene,
        change=dict(zip(problem.names, map(float, change * problem.units), strict=True)),
        distance=float(np.linalg.norm(change)),
        values=values,
        targets=target_values,
        met=not reason,
        why=reason,
        at_bound=names,
        slope=path_point.slope,
    )


def _failure_reason(fraction, virtual_kinds, names, is_expired=False):
    """State why the path to the targets ends, or return an empty string if they are attained.

    `virtual_kinds` are the kinds of points whose orbits are inadmissible beyond the end, `names` the parameters at a
    bound.
    """
    if fraction == 1.0:
        return ""
    cause = "the point cannot be continued (it meets another point, or its value has an extremum)"
    if is_expired:
        cause = EXPIRED_REASON
    elif virtual_kinds:
        cause = f"the orbit of the {virtual_kinds[0]} passes through a wall beyond it"
    elif names:
        cause = f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} at a bound"
    return f"the path to the targets ends after {fraction:.3g} of its length: {cause}"
