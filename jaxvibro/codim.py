"""Points of codimension two on a locus: where it meets another, or where what crosses it changes its kind.

On a locus of SN a cusp (CP), where w F_uu v v is zero, v and w being the right and left null vectors of F_u; on one of
PD or SB a generalized period doubling (GPD) or degenerate symmetry breaking (DSB), where w (F_uuu v v v + 3 F_uu v h)
is, with F_u h = -F_uu v v (Kuznetsov, Elements of Applied Bifurcation Theory, 5.4); on one of GR a point of SN, PD or
SB, or of resonant grazing (RG), where SN and PD are one. F is entire in times and speeds: central differences over many
points give these derivatives to rounding.
"""

import jax
import jax.numpy as jnp
import numpy as np

from continuation import locate
from continuation.follow import Event

from . import cycle, flow, ring
from .along import cycle_at, problem, there
from .curve import Grazing
from .cycle import Cycle
from .frame import frame
from .rows import between

APART = 0.03  # between the nearest of the points of a difference, times the fastest rate
PLACES = np.array([-8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8])


def _weights(nine, order, power):
    """Of a derivative at PLACES: of nine points, and of nine twice as far apart, so that the first error falls out."""
    near, far = (
        np.array([nine[k // n + 4] if k % n == 0 and abs(k) <= 4 * n else 0.0 for k in PLACES]) for n in (1, 2)
    )
    return (2.0**power * near - far / 2.0**order) / (2.0**power - 1.0)


SECOND = _weights([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560], 2, 8)
THIRD = _weights([-7 / 240, 3 / 10, -169 / 120, 61 / 30, 0, -61 / 30, 169 / 120, -3 / 10, 7 / 240], 3, 6)
ORDERS = {"CP": 2, "GPD": 3, "DSB": 3}  # of the derivative that is zero there
STEP = 1e-5  # of 1 + abs z: the points of a difference, for Newton's method
SAME = 1e-7  # of z: two points as near are one
LANES = 132  # points of a compiled call


def events(curve, points, control):
    """The `Event`s between points in a row."""
    found = []
    for kind, values in _watched(curve, points).items():
        for after in np.flatnonzero(values[:-1] * values[1:] < 0):
            one = _located(curve, kind, points, int(after), values, control)
            if one is not None and np.linalg.norm(control.scale * (one.z - points.z[0])) > SAME:
                found.append(one)
    return _told_apart(sorted(found, key=lambda one: (one.after, one.length)))


def _watched(curve, points):
    """{kind: values at points that change their sign there}."""
    if not isinstance(curve, Grazing):
        if float(curve.closing) > 0:
            turned = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
            return {"CP": np.cumprod(np.append(1.0, np.sign(turned)))}
        return {_doubling(curve, "GPD", "DSB"): _bends(curve, points.z, 3)}
    same, opposite = _matrices(curve, points.z)
    return {"SN": np.linalg.det(same), _doubling(curve, "PD", "SB"): np.linalg.det(opposite)}


def _doubling(curve, whole, half):
    return half if float(curve.cycle.turn) < 0 else whole


def _located(curve, kind, points, after, values, control):
    here, length = points.z[after], float(points.step[after + 1])
    share = values[after] / (values[after] - values[after + 1])
    for guess in (share, 0.5):
        near = between(curve, points, after, guess * length, control)
        z = here + guess * length * points.tangent[after] if near is None else near.z
        found = _polished(curve, kind, z)
        if found.z is None:
            continue
        along = float(np.sum(control.scale**2 * points.tangent[after] * (found.z - here)))
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
    """(what is zero at an event, at some points; the null vectors that give it its sign, as `_bent`)."""
    if kind in ORDERS:
        return _bent(curve, zs, ORDERS[kind], reference)
    same, opposite = _matrices(curve, zs)
    return np.linalg.det(same if kind == "SN" else opposite), None


def _told_apart(found):
    """Events in order; SN and PD of a GR in one point are a resonant grazing."""
    kept = []
    for one in found:
        if kept and np.linalg.norm(one.z - kept[-1].z) < SAME * (1.0 + np.linalg.norm(one.z)):
            kept[-1] = kept[-1]._replace(kind="RG")
        else:
            kept.append(one)
    return kept


def _bends(curve, zs, order):
    """The derivative of second or third order along the null vectors, its sign being that of a normal form's."""
    return _bent(curve, zs, order, None, True)[0]


def _bent(curve, zs, order, reference, signed=False):
    """(the derivative at each point, (v, w) at the first); reference: the (v, w) that give these their signs."""
    same, opposite = _matrices(curve, zs)
    matrix = same if float(curve.closing) > 0 else opposite
    if not np.isfinite(matrix).all():  # where Newton's method is lost
        return np.full(len(zs), np.nan), reference
    left, _, right = np.linalg.svd(matrix)
    w, v = left[:, :, -1], right[:, -1]
    if signed:
        across = 0.5 * (same - opposite)  # by the closing
        sign = np.sign(np.einsum("ki,kij,kj->k", w, across, v))
        w = w * sign[:, None]
    elif reference is not None:
        v, w = (one * np.sign(one @ given)[:, None] for one, given in zip((v, w), reference, strict=True))
    none = np.zeros_like(v)
    rate = float(flow.rate(*(jnp.max(getattr(curve.scene, key)) for key in ("frequency", "damping"))))
    step = APART / rate
    second = np.einsum("s,ksi->ki", SECOND, _near(curve, zs, v, none, step)) / step**2
    if order == 2:
        return np.einsum("ki,ki->k", w, second), (v[0], w[0])
    try:
        h = -np.linalg.solve(same, second[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:  # at a fold too: Newton's method is lost
        return np.full(len(zs), np.nan), reference
    third = np.einsum("s,ksi->ki", THIRD, _near(curve, zs, v, h, step)) / step**3
    return np.einsum("ki,ki->k", w, third), (v[0], w[0])


def _matrices(curve, zs):
    """F_u closed as itself, and as its opposite, at each point."""
    return _by_lanes(_closed, curve, zs)


def _near(curve, zs, v, h, step):
    """F at u + s v + s^2 / 2 h, s being PLACES steps: (points, 13, rows of F)."""
    return _by_lanes(_beside, curve, zs, v, h, np.full(len(zs), step))


def _by_lanes(function, curve, *arrays):
    """The results for each row of arrays, by calls of one shape."""
    size, parts = len(arrays[0]), []
    for first in range(0, size, LANES):
        some = np.minimum(np.arange(first, first + LANES), size - 1)
        parts.append(jax.device_get(function(curve, *(each[some] for each in arrays))))
    return jax.tree.map(lambda *each: np.concatenate(each)[:size], *parts)


@jax.jit
def _closed(curve, zs):
    def one(z):
        found = ring.of(cycle.equations(frame(there(curve, z)), cycle_at(curve, z))[1])
        return ring.dense(found), ring.dense(found, -1.0)

    return jax.vmap(one)(zs)


@jax.jit
def _beside(curve, zs, vs, hs, steps):
    def one(z, v, h, step):
        return jax.vmap(lambda k: _ahead(curve, z, v, h, k * step))(jnp.array(PLACES, z.dtype))

    return jax.vmap(one)(zs, vs, hs, steps)


def _ahead(curve, z, v, h, s):
    """F of the impacts moved by s v + s^2 / 2 h, the first impact of the next time round by what its closing says."""
    given, rows = curve.cycle, len(curve.cycle.sides)
    built = frame(there(curve, z))
    last = jnp.sum(given.sides != 0)
    place = jnp.arange(rows + 1)
    again, source = place == last, jnp.where(place < last, place, 0)
    closing = curve.closing if not isinstance(curve, Grazing) else 1.0
    u = z[: 2 * rows]

    def moved(part, more):
        pick = slice(part * rows, (part + 1) * rows)
        sign = jnp.where(again, closing, 1.0)
        return u[pick][source] + more + sign * s * v[pick][source] + 0.5 * s * s * h[pick][source]

    times = moved(0, jnp.where(again, given.periods * built.period, 0.0))
    sides = jnp.where(place <= last, jnp.where(again, given.turn, 1.0) * given.sides[source], 0.0)
    value = cycle.equations(built, Cycle(times, moved(1, 0.0), sides, given.phase, given.periods))[0]
    own = jnp.arange(rows) < last
    return jnp.concatenate([jnp.where(own, value[:rows], 0.0), jnp.where(own, value[rows + 1 : 2 * rows + 1], 0.0)])
