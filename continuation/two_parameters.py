"""`curve`: a special point's curve in two parameters, with the points of codimension two on it.

To F(u, p) = 0 the determinant of the matrix that is singular at the point is added: dF/du at SN, that of the second
iterate's at PD, a bialternate product at HB and NS, the block of dF/du that the symmetry reverses at SB. Its gradient
is not zero where the matrix has one null vector.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import augmented_systems, event_search
from .arclength import solve_bordered
from .branch import Branch, Special
from .curve_events import INTERSECTIONS, CurveEventDetector
from .errors import ContinuationError, check_types
from .limits import limits_of
from .one_parameter import assemble_branch, follow_both_directions, make_task, validate_bounds
from .problem import Constants, Problem, TestFunction, noise_floor, residual_and_jacobian, singular_matrix
from .validation import require_settings

KINDS = ("SN", "PD", "HB", "NS", "SB")
TOLERANCE = 1e-12  # of Newton's method, a length


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
    """The curve of a special point in two parameters: a `Branch` of its kind.

    special: a `Special` of kind SN, PD, HB, NS or SB; names: two parameters of its system; bounds: {name: (low, high)}.
    The rest as in `trace`; a tolerance of None is 1e-12.

    Located are, of equilibria, cusps (CP), Bogdanov-Takens (BT), zero-Hopf (ZH), double Hopf
    (HH) and generalized Hopf points (GH); of maps and orbits cusps, generalized period doublings (GPD), Chenciner
    points (CH), fold-flips (FF), the resonances R1 to R4, NS with a fold (FN), a period doubling (PN) or another NS
    (NN); GPD and CH of maps alone; of SB the degenerate ones (DSB). A curve of HB or NS ends where the eigenvalues
    become real.

    Raises ContinuationError for points of other kinds and arguments that cannot be.
    """
    if not isinstance(special, Special) or special.kind not in KINDS:
        raise ContinuationError("special", f"must be a special point of kind {', '.join(KINDS)}", special)
    name_pair = tuple(names) if isinstance(names, tuple | list) else ()
    if len(name_pair) != 2 or name_pair[0] == name_pair[1]:
        raise ContinuationError("names", "must be two different parameters", names)
    if set(bounds) != set(name_pair):
        raise ContinuationError("bounds", f"must be given for {name_pair[0]} and {name_pair[1]}", bounds)
    require_settings("both", None, stop)
    bounds = validate_bounds(special.p, {name: bounds[name] for name in name_pair})
    limits = limits_of(max_points, max_seconds, progress, ContinuationError)
    constants = Constants({name: value for name, value in special.p.items() if name not in name_pair}, special.args)
    z = np.append(special.u, [special.p[name] for name in name_pair])
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    detector = CurveEventDetector(system, special.kind, name_pair)
    task = make_task(system, z, bounds, constants, first_step, largest_step, tolerance, stop=stop, default=TOLERANCE)
    task = task._replace(problem=curve_problem(system, special.kind, name_pair), detector=detector, limits=limits)
    tangent = event_search.unit_tangent(task.problem, z, task.control.scale, constants)
    backward, forward = follow_both_directions(task, z, tangent)
    return assemble_branch(system, special.kind, bounds, constants, backward, forward)


@lru_cache
def curve_problem(system, kind, names):
    """The `Problem` of special points of a kind along two parameters: z = (u, values of the names)."""

    def determinant(z, constants):
        return jnp.linalg.det(singular_matrix(system, kind, names, z, constants))

    def function(z, constants):
        residual, jacobian = residual_and_jacobian(system, names, z, constants)
        gradient = jax.jacfwd(determinant)(z, constants)
        return jnp.append(residual, determinant(z, constants)), jnp.concatenate([jacobian, gradient[None]])

    intersections = INTERSECTIONS[system.kind].get(kind, {})
    test_functions = tuple(
        TestFunction(label, partial(singular_matrix, system, other_kind, names))
        for label, other_kind in intersections.items()
    )
    return Problem(function, solve_bordered, function, test_functions, noise_floor=noise_floor(system))


@check_types
def sensitivity(special: Special, names: str | Sequence[str]) -> Float[np.ndarray, " names"]:
    """How the value of a special point's parameter changes with other parameters of its system: (names,).

    special: a `Special` of a branch, SN, PD, HB, NS or SB; names: of parameters but its own. With z = (u, p) the
    curve's equations G(z, q) = 0 are regular in z: dz/dq = -G_z^-1 G_q.

    Raises ContinuationError for points of other kinds and names that cannot be.
    """
    if not isinstance(special, Special) or special.kind not in KINDS or len(special.names) != 1:
        raise ContinuationError("special", f"must be a special point of a branch, {', '.join(KINDS)}", special)
    other_names = (names,) if isinstance(names, str) else tuple(names)
    if (
        not other_names
        or len({*special.names, *other_names}) <= len(other_names)
        or not set(other_names) <= set(special.p)
    ):
        raise ContinuationError("names", f"must be different parameters, none {special.names[0]}", other_names)
    all_names = (*special.names, *other_names)
    constants = Constants({name: value for name, value in special.p.items() if name not in all_names}, special.args)
    z = np.append(special.u, [special.p[name] for name in all_names])
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    jacobian = augmented_systems.jacobian_at(curve_problem(system, special.kind, all_names), z, constants)
    n_unknowns = len(z) - len(other_names)
    return -np.linalg.solve(jacobian[:, :n_unknowns], jacobian[:, n_unknowns:])[-1]
