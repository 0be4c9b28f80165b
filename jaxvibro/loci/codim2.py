"""Points of codimension two on a locus: where it meets another, or where what crosses it changes its kind.

On a locus of SN a cusp (CP), where w F_uu v v is zero, v and w being the right and left null vectors of F_u; on one of
PD or SB a generalized period doubling (GPD) or degenerate symmetry breaking (DSB), where w (F_uuu v v v + 3 F_uu v h)
is, with F_u h = -F_uu v v (Kuznetsov, Elements of Applied Bifurcation Theory, 5.4); on one of GR a resonant grazing
(RG), where the equations with the touch as an impact are singular, those of SN and of PD together, and a nonhyperbolic
one (SN, PD, SB), where those without it are. F is entire in times and speeds: central differences over many points give
these derivatives to rounding.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation import locate
from continuation.arrays import Array
from continuation.event_search import Event
from continuation.linear import solve
from continuation.persistent_jit import persistent_jit
from continuation.points import between

from ..compiled.kernels import one_kernel
from ..flight import drive, flow
from ..flight.coefficients import framed
from ..orbits import cyclic_system, impact_equations, saltation
from ..problem import grazing
from ..problem.diagnostics import diagnose
from ..problem.equations import cycle_at, problem, there
from .extended_system import Grazing

APART = 0.03  # between the nearest of the points of a difference, times the fastest rate
PLACES = np.array([-8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8])


def _weights(nine, order, power):
    """Of a derivative at PLACES: of nine points, and of nine twice as far apart, so that the first error falls out."""
    near, far = (
        np.array([nine[k // n + 4] if k % n == 0 and abs(k) <= 4 * n else 0.0 for k in PLACES]) for n in (1, 2)
    )
    return (2.0**power * near - far / 2.0**order) / (2.0**power - 1.0)


# places and weights of the second and the third derivative: to rounding, and for a sign alone
THIRTEEN = (
    PLACES,
    _weights([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560], 2, 8),
    _weights([-7 / 240, 3 / 10, -169 / 120, 61 / 30, 0, -61 / 30, 169 / 120, -3 / 10, 7 / 240], 3, 6),
)
SEVEN = (
    np.arange(-3, 4),
    np.array([1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90]),
    np.array([1 / 8, -1, 13 / 8, 0, -13 / 8, 1, -1 / 8]),
)
ORDERS = {"CP": 2, "GPD": 3, "DSB": 3}  # of the derivative that is zero there
STEP = 1e-5  # of 1 + abs z: the points of a difference, for Newton's method
NONE = 1e-10  # `_Bend.across`: as small, an impact has no speed, and the third derivative no value
SAME = 1e-7  # of z: two points as near are one
LANES = 132  # points of a compiled call


def events(task, points, look):
    """The `Event`s between points in a row, of which the `Diagnostics` is known; task: the `driver.Task` of the
    locus."""
    curve, found = task.args, []
    if curve.cycle.releases is not None:  # what forgets has no fold, and does not double
        return found
    for kind, values in _watched(curve, points, look).items():
        for after in np.flatnonzero(values[:-1] * values[1:] < 0):
            one = _located(task, kind, points, int(after), values)
            if one is not None and np.linalg.norm(task.control.scale * (one.z - points.z[0])) > SAME:
                found.append(one)
    return sorted(found, key=lambda one: (one.after, one.length))


def _watched(curve, points, look):
    """{kind: values at points that change their sign there}."""
    if not isinstance(curve, Grazing):
        if float(curve.closing) > 0:
            turned = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
            return {"CP": np.cumprod(np.append(1.0, np.sign(turned)))}
        bend = _bent(curve, points.z, 3, False)
        return {_doubling(curve, "GPD", "DSB"): np.where(bend.across > NONE, bend.value, np.nan)}
    found = {"RG": look.fold} if curve.cycle.still is None else {}
    without = _without(curve, points.z, look)
    if without is None:
        return found
    return found | dict(zip(("SN", _doubling(curve, "PD", "SB")), without, strict=True))


def _without(curve, zs, look):
    """What is zero on a GR where the orbit without the touch is an SN, and where a PD or SB; None where that has no
    impacts and the touch does something. With a smooth touch the equations of the impacts are always singular: there it
    is the monodromy matrix less or plus 1, its determinant."""
    if curve.cycle.still is not None:
        turn = -1.0 if float(curve.cycle.turn) < 0 else 1.0
        return tuple(1.0 + look.determinant - sign * turn * look.trace for sign in (1.0, -1.0))
    if not len(curve.hits):
        return None
    rows, kept = len(curve.cycle.sides), curve.hits
    cycle = grazing.padded(curve, [(0.0, 0.0, curve.cycle.sides[k]) for k in kept])
    wide, count = len(cycle.sides), len(kept)
    bare = np.zeros((len(zs), 2 * wide + 2))
    bare[:, :count], bare[:, wide : wide + count], bare[:, -2:] = zs[:, kept], zs[:, rows + kept], zs[:, -2:]
    found = diagnose(grazing.recut(curve, cycle, kept), bare)
    return found.fold, found.flip


def _doubling(curve, whole, half):
    return half if float(curve.cycle.turn) < 0 else whole


def _located(task, kind, points, after, values):
    here, length = points.z[after], float(points.step[after + 1])
    share = values[after] / (values[after] - values[after + 1])
    for guess in (share, 0.5):
        near = between(task, points, after, guess * length)
        z = here + guess * length * points.tangent[after] if near is None else near.z
        found = _polished(task.args, kind, z)
        if found.z is None:
            continue
        along = float(np.sum(task.control.scale**2 * points.tangent[after] * (found.z - here)))
        if -0.05 * length <= along <= 1.05 * length:
            return Event(kind, after, min(max(along, 0.0), length), found.z, found.residual)
    return None


def _polished(curve, kind, z):
    """Newton's method on the locus and the event's equation: `locate.Located`."""
    found, vectors = _measured(curve, kind, z[None])
    size = abs(found[0]) or 1.0

    def system(z):
        value, slopes = (np.asarray(each) for each in locate.evaluated(problem(curve), z, curve))
        steps = STEP * (1.0 + abs(z))
        both = np.concatenate([z + np.diag(steps), z - np.diag(steps), z[None]])
        found = _measured(curve, kind, both, vectors)[0] / size
        count = len(z)
        more = (found[:count] - found[count : 2 * count]) / (2.0 * steps)
        return np.append(value, found[-1]), np.vstack([slopes, more])

    return locate.newton(system, z)


def _measured(curve, kind, zs, reference=None):
    """(what is zero at an event, at some points; the null vectors that give it its sign, as `_Bend`)."""
    if kind in ORDERS:
        bend = _bent(curve, zs, ORDERS[kind], True, reference)
        return bend.value, (bend.v[0], bend.w[0])
    look = diagnose(curve, zs)
    if kind == "RG":
        return look.fold, None
    fold, flip = _without(curve, zs, look)
    return fold if kind == "SN" else flip, None


class _Bend(NamedTuple):
    """value: the derivative of second or third order along the null vectors v and w; across: how w F_u v changes with
    the closing; where that is positive the sign of the third derivative is a normal form's. Near an impact without
    speed h and the third derivative grow like 1 / speed: so h is a direction of its own, taken with length 1."""

    value: Float[Array, "*points"]
    v: Float[Array, "*points unknowns"]
    w: Float[Array, "*points unknowns"]
    across: Float[Array, "*points"]


def _bent(curve, zs, order, fine, reference=None):
    """The `_Bend` at each point. fine: to rounding, else to seven digits or so; reference: the (v, w) that give these
    their signs."""
    reference = tuple(np.zeros((2, 2 * len(curve.cycle.sides)))) if reference is None else reference
    parts = []
    for first in range(0, len(zs), LANES):
        some = zs[first : first + LANES]
        padded = np.concatenate([some, np.repeat(some[-1:], LANES - len(some), axis=0)])
        found = jax.tree.map(np.asarray, _bending(curve, padded, reference, np.int32(len(some)), order, fine))
        parts.append([each[: len(some)] for each in found])
    return _Bend(*(np.concatenate(each) for each in zip(*parts, strict=True)))


@persistent_jit(static_argnums=(4, 5))
def _bending(curve, zs, reference, count, order, fine):
    return one_kernel(_each, curve, zs, reference, count, order=order, fine=fine)


def _each(curve, zs, reference, count, order, fine):
    def bend(k, found):
        new = _bend(curve, lax.dynamic_index_in_dim(zs, k, keepdims=False), reference, order, fine)
        return jax.tree.map(lambda whole, part: lax.dynamic_update_index_in_dim(whole, part, k, 0), found, new)

    line, plane = (jnp.zeros((len(zs), *shape), zs.dtype) for shape in ((), reference[0].shape))
    return lax.fori_loop(0, count, bend, _Bend(line, plane, plane, line))


def _bend(curve, z, reference, order, fine):
    built, cycle = framed(there(curve, z)), cycle_at(curve, z)
    flown = impact_equations.flights(built, cycle)
    found = cyclic_system.of(impact_equations.equations(built, cycle, flown)[1])
    w, v = (each / jnp.sqrt(jnp.sum(each * each)) for each in cyclic_system.nulls(found, curve.closing))
    v, w = (jnp.where(jnp.sum(one * given) < 0, -one, one) for one, given in zip((v, w), reference, strict=True))
    across = cyclic_system.by_turn(w, found, v)
    step = APART / _rate(built, flown.met, cycle.sides)
    places, *weights = THIRTEEN if fine else SEVEN

    def along(h):
        """The second and the third derivative along v + h."""
        beside = jax.vmap(lambda place: _ahead(curve, built, z, v, h, place * step))(jnp.array(places, z.dtype))
        return [jnp.array(each, z.dtype) @ beside / step**power for power, each in zip((2, 3), weights, strict=True)]

    def look(k, given):  # along v, then v + h and v - h, h of length 1
        second, third, mixed, _ = given
        h = jnp.where(k > 0, -solve(cyclic_system.dense(found), second).x, 0.0)
        length = jnp.sqrt(jnp.sum(h * h))
        length = jnp.where(length > 0, length, 1.0)
        two, three = along(jnp.where(k > 1, -h, h) / length)
        first = k == 0
        mixed = jnp.where(first, mixed, mixed + jnp.where(k > 1, -0.25, 0.25) * two)
        return jnp.where(first, two, second), jnp.where(first, three, third), mixed, length

    zero = jnp.zeros_like(v)
    if order == 2:
        last = along(zero)[0]
    else:
        _, third, mixed, size = lax.fori_loop(0, 3, look, (zero, zero, zero, jnp.ones(())))
        last = third + 3.0 * size * mixed
    return _Bend(jnp.sum(w * last), v, w, across)


def _rate(built, met, sides):
    """The fastest of the flights', and of what is felt within soft walls."""
    found = flow.rate(built.frequency, built.damping)
    if built.terms:
        found = jnp.maximum(found, built.frequency * float(drive.fastest(built.terms)))
    return found if met.stay is None else jnp.maximum(found, saltation.rate(built, met, sides))


def _ahead(curve, built, z, v, h, s):
    """F of the impacts moved by s (v + h), the first impact of the next time round by v as its closing says."""
    rows, moves = len(curve.cycle.sides), ((s * v, curve.closing), (s * h, 1.0))
    value = impact_equations.equations(built, impact_equations.unwound(cycle_at(curve, z), built.period, moves))[0]
    own = jnp.arange(rows) < jnp.sum(curve.cycle.sides != 0)
    return jnp.concatenate([jnp.where(own, value[:rows], 0.0), jnp.where(own, value[rows + 1 : 2 * rows + 1], 0.0)])
