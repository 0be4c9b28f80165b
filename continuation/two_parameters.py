"""`curve`: a special point's curve in two parameters, with the points of codimension two on it.

To F(u, p) = 0 the determinant of the matrix that is singular at the point is added: dF/du at SN, that of the second
iterate's at PD, a bialternate product at HB and NS. Its gradient is not zero where the matrix has one null vector.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from . import event_search, locate
from .arclength import bordered
from .branch import Branch, Special
from .driver import End, Watch
from .errors import ContinuationError
from .event_search import Event
from .one_parameter import both_ways, branch_of, checked_bounds, task_of
from .points import between
from .problem import (
    EQUILIBRIA,
    FIXED_POINTS,
    Given,
    Problem,
    Test,
    is_oscillation,
    is_pair,
    residual_at,
    singular_matrix,
    slopes_at,
)

KINDS = ("SN", "PD", "HB", "NS")
NEAR = 1e-4  # eigenvalues as near, over 1 + the largest, are one: a double one is known to the root of a rounding
# What else becomes singular on a curve of each kind: {kind: {label: the matrix of that kind}}
MEETING = {
    EQUILIBRIA: {"SN": {"BT": "HB"}, "HB": {"BT": "SN"}},
    FIXED_POINTS: {"SN": {"FF": "PD", "R1": "NS"}, "PD": {"FF": "SN", "R2": "NS"}, "NS": {"R1": "SN", "R2": "PD"}},
}
# {label: (the eigenvalue of dF/du that is double there, what it is where that is simple, what must hold then)}
DOUBLE = {"BT": (0.0, "ZH", is_oscillation), "R1": (0.0, "FN", is_pair), "R2": (-2.0, "PN", is_pair)}
BENT = {"SN": "CP", "PD": "GPD"}  # where the normal form's first coefficient is zero


def curve(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, Sequence[float]],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float = 1e-12,
    stop: Sequence[str] = (),
) -> Branch:
    """The curve of a special point in two parameters: a `Branch` of its kind.

    special: a `Special` of kind SN, PD, HB or NS; names: two parameters of its system; bounds: {name: (low, high)}.
    The rest as in `trace`. Located are cusps (CP) and Bogdanov-Takens points (BT), of maps cusps, generalized period
    doublings (GPD), fold-flips (FF) and the resonances R1 and R2; zero-Hopf points (ZH), of maps those with a fold (FN)
    or a period doubling (PN). A curve of HB or NS ends where the eigenvalues become real.

    Raises ContinuationError for points of other kinds and arguments that cannot be.
    """
    if not isinstance(special, Special) or special.kind not in KINDS:
        raise ContinuationError("special", f"must be a special point of kind {', '.join(KINDS)}", special)
    pair = tuple(names) if isinstance(names, tuple | list) else ()
    if len(pair) != 2 or pair[0] == pair[1]:
        raise ContinuationError("names", "must be two different parameters", names)
    if set(bounds) != set(pair):
        raise ContinuationError("bounds", f"must be given for {pair[0]} and {pair[1]}", bounds)
    bounds = checked_bounds(special.p, {name: bounds[name] for name in pair})
    given = Given({name: value for name, value in special.p.items() if name not in pair}, special.args)
    z = np.append(special.u, [special.p[name] for name in pair])
    watch = OnCurve(special.system, special.kind, pair)
    task = task_of(special.system, z, bounds, given, first_step, largest_step, tolerance, stop=stop)
    task = task._replace(problem=special_problem(special.system, special.kind, pair), watch=watch)
    ahead = event_search.tangent(task.problem, z, task.control.scale, given)
    back, on = both_ways(task, z, ahead)
    return branch_of(special.system, special.kind, bounds, given, back, on)


@lru_cache
def special_problem(system, kind, names):
    """The `Problem` of special points of a kind along two parameters: z = (u, values of the names)."""

    def values(z, given):
        matrix = singular_matrix(system, kind, names, z, given)
        return jnp.append(residual_at(system, names, z, given), jnp.linalg.det(matrix))

    def function(z, given):
        return values(z, given), jax.jacfwd(values)(z, given)

    met = MEETING[system.kind].get(kind, {})
    tests = tuple(Test(label, partial(singular_matrix, system, of, names)) for label, of in met.items())
    return Problem(function, bordered, function, tests)


class OnCurve(Watch):
    """What is watched along a curve of special points: where others meet it, and where its own normal form changes."""

    def __init__(self, system, kind, names):
        self.system, self.kind, self.names = system, kind, names

    def events(self, task, points, view, known, end):
        values = event_search.watched(task.problem, points, task.args)
        found = event_search.events(task.problem, points, values, task.control, task.args, known)
        met = [self.named(one, task.args) for one in found if one.kind in values]
        return [*(one for one in met if one), *self.bends(task, points)]

    def stops(self, z, kind):
        """A curve of HB or NS ends where the two eigenvalues are one: beyond they are real."""
        return End.STOPPED if self.kind in ("HB", "NS") and kind in DOUBLE else None

    def named(self, event, given):
        """The event as what it is by the eigenvalues there; None where these are a neutral saddle's."""
        if event.kind not in DOUBLE:
            return event
        slopes = np.asarray(slopes_at(self.system, self.names, event.z, given))[:, : -len(self.names)]
        value, other, holds = DOUBLE[event.kind]
        found = np.linalg.eigvals(slopes)
        if np.sum(abs(found - value) < NEAR * (1.0 + abs(found).max())) > 1:
            return event
        return event._replace(kind=other) if holds(slopes) else None

    def bends(self, task, points):
        """The `Event`s where the first coefficient of the normal form is zero."""
        if self.kind == "SN":
            turned = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
            values = np.cumprod(np.append(1.0, np.sign(turned)))
        elif self.kind == "PD":
            values = np.array([self.bend(z, task.args) for z in points.z])
        else:
            return
        for after in np.flatnonzero(values[:-1] * values[1:] < 0):
            found = self.bend_located(task, points, int(after))
            if found is not None:
                yield found

    def bend(self, z, given, reference=None):
        matrix = singular_matrix(self.system, self.kind, self.names, z, given)
        return float(_bend(self.system, self.kind, self.names, z, given, reference or border(matrix)))

    def bend_located(self, task, points, after):
        """Newton's method on the curve's equations and the coefficient: the `Event`, None where it leads to none."""
        here, length = points.z[after], float(points.step[after + 1])
        near = between(task, points, after, 0.5 * length)
        z = here + 0.5 * length * points.tangent[after] if near is None else near.z
        vectors = border(singular_matrix(self.system, self.kind, self.names, z, task.args))

        def system(z):
            value, slopes = (np.asarray(each) for each in locate.evaluated(task.problem, z, task.args))
            more = locate.differences(lambda z: self.bend(z, task.args, vectors), z)
            return np.append(value, self.bend(z, task.args, vectors)), np.vstack([slopes, more])

        found = locate.newton(system, z)
        if found.z is None:
            return None
        along = float(np.sum(task.control.scale**2 * points.tangent[after] * (found.z - here)))
        inside = -0.05 * length <= along <= 1.05 * length
        return Event(BENT[self.kind], after, min(max(along, 0.0), length), found.z, found.residual) if inside else None


def border(matrix):
    """(b, c): the nearly null vectors of a matrix's transpose and of the matrix."""
    left, _, right = np.linalg.svd(np.asarray(matrix))
    return left[:, -1], right[-1]


@partial(jax.jit, static_argnums=(0, 1, 2))
def _bend(system, kind, names, z, given, reference):
    """w F_uu v v at SN, the coefficient of the cubic normal form at PD (Kuznetsov, 5.4), (w, v) the null vectors by the
    bordered systems with a reference (b, c)."""
    matrix = singular_matrix(system, kind, names, z, given)
    b, c = reference
    whole = jnp.block([[matrix, b[:, None]], [c[None], jnp.zeros((1, 1))]])
    unit = jnp.zeros(len(whole)).at[-1].set(1.0)
    v, w = jnp.linalg.solve(whole, unit)[:-1], jnp.linalg.solve(whole.T, unit)[:-1]
    size = len(z) - len(names)

    def along(*directions):
        """The derivative of F by u along each of some directions."""
        function = lambda u: residual_at(system, names, jnp.concatenate([u, z[size:]]), given)  # noqa: E731
        for one in directions:
            function = partial(_derived, function, one)
        return function(z[:size])

    second = along(v, v)
    if kind == "SN":
        return w @ second
    h = jnp.linalg.solve(-slopes_at(system, names, z, given)[:, :size], second)
    return (w @ (along(v, v, v) + 3.0 * along(v, h))) / (6.0 * (w @ v))


def _derived(function, direction, u):
    return jax.jvp(function, (u,), (direction,))[1]


def sensitivity(special: Special, names: str | Sequence[str]) -> Float[np.ndarray, " names"]:
    """How the value of a special point's parameter changes with other parameters of its system: (names,).

    special: a `Special` of a branch, SN, PD, HB or NS; names: of parameters but its own. With z = (u, p) the curve's
    equations G(z, q) = 0 are regular in z: dz/dq = -G_z^-1 G_q.

    Raises ContinuationError for points of other kinds and names that cannot be.
    """
    if not isinstance(special, Special) or special.kind not in KINDS or len(special.names) != 1:
        raise ContinuationError("special", f"must be a special point of a branch, {', '.join(KINDS)}", special)
    others = tuple(names) if isinstance(names, tuple | list) else (names,)
    if not others or len({*special.names, *others}) <= len(others) or not set(others) <= set(special.p):
        raise ContinuationError("names", f"must be different parameters, none {special.names[0]}", others)
    every = (*special.names, *others)
    given = Given({name: value for name, value in special.p.items() if name not in every}, special.args)
    z = np.append(special.u, [special.p[name] for name in every])
    slopes = locate.slopes_of(special_problem(special.system, special.kind, every), z, given)
    size = len(z) - len(others)
    return -np.linalg.solve(slopes[:, :size], slopes[:, size:])[-1]
