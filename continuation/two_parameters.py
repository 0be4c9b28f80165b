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

from . import event_search, locate
from .arclength import bordered
from .arguments import require_settings
from .branch import Branch, Special
from .errors import ContinuationError, typed
from .limits import limits_of
from .on_curve import MEETING, OnCurve
from .one_parameter import both_ways, branch_of, checked_bounds, task_of
from .problem import Given, Problem, Test, equations_at, noise_of, singular_matrix

KINDS = ("SN", "PD", "HB", "NS", "SB")
TOLERANCE = 1e-12  # of Newton's method, a length


@typed
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
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    if len(pair) != 2 or pair[0] == pair[1]:
        raise ContinuationError("names", "must be two different parameters", names)
    if set(bounds) != set(pair):
        raise ContinuationError("bounds", f"must be given for {pair[0]} and {pair[1]}", bounds)
    require_settings("both", None, stop)
    bounds = checked_bounds(special.p, {name: bounds[name] for name in pair})
    limits = limits_of(max_points, max_seconds, progress, ContinuationError)
    given = Given({name: value for name, value in special.p.items() if name not in pair}, special.args)
    z = np.append(special.u, [special.p[name] for name in pair])
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    watch = OnCurve(system, special.kind, pair)
    task = task_of(system, z, bounds, given, first_step, largest_step, tolerance, stop=stop, usual=TOLERANCE)
    task = task._replace(problem=special_problem(system, special.kind, pair), watch=watch, limits=limits)
    ahead = event_search.tangent(task.problem, z, task.control.scale, given)
    back, on = both_ways(task, z, ahead)
    return branch_of(system, special.kind, bounds, given, back, on)


@lru_cache
def special_problem(system, kind, names):
    """The `Problem` of special points of a kind along two parameters: z = (u, values of the names)."""

    def singular(z, given):
        return jnp.linalg.det(singular_matrix(system, kind, names, z, given))

    def function(z, given):
        value, slopes = equations_at(system, names, z, given)
        more = jax.jacfwd(singular)(z, given)
        return jnp.append(value, singular(z, given)), jnp.concatenate([slopes, more[None]])

    met = MEETING[system.kind].get(kind, {})
    tests = tuple(Test(label, partial(singular_matrix, system, of, names)) for label, of in met.items())
    return Problem(function, bordered, function, tests, noise=noise_of(system))


@typed
def sensitivity(special: Special, names: str | Sequence[str]) -> Float[np.ndarray, " names"]:
    """How the value of a special point's parameter changes with other parameters of its system: (names,).

    special: a `Special` of a branch, SN, PD, HB, NS or SB; names: of parameters but its own. With z = (u, p) the
    curve's equations G(z, q) = 0 are regular in z: dz/dq = -G_z^-1 G_q.

    Raises ContinuationError for points of other kinds and names that cannot be.
    """
    if not isinstance(special, Special) or special.kind not in KINDS or len(special.names) != 1:
        raise ContinuationError("special", f"must be a special point of a branch, {', '.join(KINDS)}", special)
    others = (names,) if isinstance(names, str) else tuple(names)
    if not others or len({*special.names, *others}) <= len(others) or not set(others) <= set(special.p):
        raise ContinuationError("names", f"must be different parameters, none {special.names[0]}", others)
    every = (*special.names, *others)
    given = Given({name: value for name, value in special.p.items() if name not in every}, special.args)
    z = np.append(special.u, [special.p[name] for name in every])
    system = special.system._replace(within=special.kind == "SB" or special.system.within)
    slopes = locate.slopes_of(special_problem(system, special.kind, every), z, given)
    size = len(z) - len(others)
    return -np.linalg.solve(slopes[:, :size], slopes[:, size:])[-1]
