"""Continue special points in two parameters (`curve`) and locate codimension-two points.

The equations state that F(u, p) and the determinant of a matrix are zero. This matrix is singular at the special point:
dF/du at SN, dF/du + 2 I at PD of a map (for an orbit dF/du with antiperiodic closure), a bialternate product at HB and
NS, and the antisymmetric block of dF/du at SB. The derivative of the determinant with respect to the matrix is nonzero
if the null space is one-dimensional.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import augmented_systems, event_search
from .branch import Branch, Special, unknowns_and_constants
from .branch_segment import make_limits
from .codim2_events import INTERSECTIONS, CurveEventDetector
from .continuation_loop import follow_both_directions
from .errors import ContinuationError, check_types
from .implicit_function import root_derivatives
from .one_parameter import assemble_branch, make_task
from .problem import extend_function, make_dense_problem, make_test_function, singular_matrix
from .validation import require_settings, validate_bounds

KINDS = ("SN", "PD", "HB", "NS", "SB")
TOLERANCE = 1e-12  # tolerance of Newton's method, a length


@check_types
def curve(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, Sequence[float]],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float | None = None,
    stop: Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Branch:
    """Continue a special point in two parameters.

    Parameters
    ----------
    special : Special
        Special point of kind SN, PD, HB, NS or SB.
    names : sequence of str
        Two parameters of the system of the point.
    bounds : mapping of str to sequence of float
        Lower and upper bound of each parameter.
    first_step : float, optional
        Length of the first step, measured in (u, parameters).
    largest_step : float, optional
        Largest step length, measured in (u, parameters).
    tolerance : float, optional
        Tolerance of Newton's method, as in `trace`, but with 1e-12 in place of 1e-10.
    stop : sequence of str, optional
        Kinds of special point at which the continuation ends.
    max_points : int, optional
        Largest number of points. None stands for no limit.
    max_seconds : float, optional
        Largest wall-clock time, in s. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.

    Returns
    -------
    Branch
        The curve, with its codimension-two points. Its `kind` is that of the point.

    Raises
    ------
    ContinuationError
        If the point is of another kind or an argument is invalid.

    See Also
    --------
    trace : Continue a solution in one parameter.
    sensitivity : Derivative of the parameter value of a special point.

    Notes
    -----
    Located points of equilibria are cusps (CP), Bogdanov-Takens (BT), zero-Hopf (ZH), double Hopf (HH) and generalized
    Hopf points (GH). Those of maps and periodic orbits are cusps, generalized period doublings (GPD), Chenciner points
    (CH), fold-flips (FF), the resonances R1 to R4, and NS with a fold (FN), a period doubling (PN) or another NS (NN);
    GPD and CH are located for maps only. Located points on curves of SB are degenerate symmetry breakings (DSB). A
    curve of HB or NS ends where its critical eigenvalues become real.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] + p["b"] * u - u**3)
    >>> branch = co.trace(system, [1.0], {"a": 0.0, "b": 1.0}, "a", bounds=(-1.0, 1.0))
    >>> folds = co.curve(branch.points("SN")[0], ("a", "b"), {"a": (-1.0, 1.0), "b": (-0.5, 1.5)})
    >>> [special.kind for special in folds.special]
    ['EP', 'CP', 'EP']
    """
    if not isinstance(special, Special) or special.kind not in KINDS:
        raise ContinuationError("special", f"must be a special point of kind {', '.join(KINDS)}", special)
    name_pair = tuple(names) if isinstance(names, tuple | list) else ()
    if len(name_pair) != 2 or name_pair[0] == name_pair[1]:
        raise ContinuationError("names", "must be two different parameters", names)
    require_settings("both", None, stop)
    bounds = validate_bounds(special.p, name_pair, bounds)
    limits = make_limits(max_points, max_seconds, progress, ContinuationError)
    start_z, constants = unknowns_and_constants(special, name_pair)
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    detector = CurveEventDetector(system, special.kind, name_pair)
    task = make_task(
        system,
        start_z,
        bounds,
        constants,
        first_step,
        largest_step,
        tolerance,
        stop_kinds=stop,
        default_tolerance=TOLERANCE,
    )
    task = task._replace(problem=curve_problem(system, special.kind, name_pair), detector=detector, limits=limits)
    tangent = event_search.unit_tangent(task.problem, start_z, task.control.scale, constants)
    backward_segment, forward_segment = follow_both_directions(task, start_z, tangent)
    return assemble_branch(system, special.kind, bounds, constants, backward_segment, forward_segment)


@lru_cache
def curve_problem(system, kind, param_names):
    """Make the `Problem` of special points of a kind, with z = (u, values of the named parameters)."""

    def determinant(z, constants):
        return jnp.linalg.det(singular_matrix(system, kind, param_names, z, constants))

    kinds_by_label = INTERSECTIONS[system.kind].get(kind, {})
    test_functions = [make_test_function(system, label, other, param_names) for label, other in kinds_by_label.items()]
    return make_dense_problem(system, extend_function(system, param_names, determinant), test_functions)


@check_types
def sensitivity(special: Special, names: str | Sequence[str]) -> Float[np.ndarray, " names"]:
    """Compute the derivative of the parameter value of a special point with respect to other parameters.

    Parameters
    ----------
    special : Special
        Special point of kind SN, PD, HB, NS or SB on a branch in one parameter.
    names : str or sequence of str
        Parameters of the system of the point, other than the continuation parameter.

    Returns
    -------
    ndarray
        Derivatives. Array of shape (names,).

    Raises
    ------
    ContinuationError
        If the point is of another kind or a name is invalid.

    See Also
    --------
    curve : Continue the special point in two parameters.

    Notes
    -----
    p is the continuation parameter and q are the other parameters. The equations G(z, q) = 0 of the special point, with
    z = (u, p), are regular in z. The result is the last row of ``dz/dq = -G_z^-1 G_q``.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - p["b"] - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5, "b": 0.5}, "a", bounds=(0.0, 2.0))
    >>> (fold,) = branch.points("SN")
    >>> np.round(co.sensitivity(fold, "b"), 6)
    array([1.])
    """
    if not isinstance(special, Special) or special.kind not in KINDS or len(special.names) != 1:
        raise ContinuationError(
            "special", f"must be a special point of kind {', '.join(KINDS)} on a branch in one parameter", special
        )
    other_param_names = (names,) if isinstance(names, str) else tuple(names)
    if (
        not other_param_names
        or len({*special.names, *other_param_names}) <= len(other_param_names)
        or not set(other_param_names) <= set(special.p)
    ):
        raise ContinuationError(
            "names", f"must be one or more different parameters other than {special.names[0]}", other_param_names
        )
    all_param_names = (*special.names, *other_param_names)
    z, constants = unknowns_and_constants(special, all_param_names)
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    problem = curve_problem(system, special.kind, all_param_names)
    _, jacobian = augmented_systems.evaluate_problem(problem, z, constants)
    n_unknowns = len(z) - len(other_param_names)
    return root_derivatives(jacobian[:, :n_unknowns], jacobian[:, n_unknowns:])[-1]
