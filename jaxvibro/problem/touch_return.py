"""What a change of the state at a touch has become at the next touch, along the orbit that leaves the touches out."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import locate
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight import response
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..orbits import impact_equations
from ..orbits.flight_clearance import OVERLAP, place
from ..orbits.saltation import jump
from ..scene.symmetry import stays_symmetric
from .depths import BareTouch, bare_touches
from .diagnostics import flight
from .equations import OrbitEquations, are_impacts, cycle_at, problem, there
from .grazing import Hit, with_impacts, with_touches
from .orbit_on_branch import OrbitPoint, is_own_image
from .touches import span, stays, touches

HALF = 1e-6  # of the orbit's length: touches as near to half of it apart are mirror images, as near are one
SAME = 1e-6  # of the scene's length: an orbit that misses itself by less is one of fewer periods


class TouchReturn(NamedTuple):
    """The orbit at a grazing without its touches, and from a touch to the next. bare, z: it; touches: `BareTouch`es;
    matrix: what it makes of a change of (x, v) from the first touch to the next, as seen by that: of a symmetric
    orbit that touches both walls half of it, the other half its mirror image; half: whether it is; length: how
    long that takes."""

    bare: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    touches: tuple[BareTouch, ...]
    matrix: Float[np.ndarray, "2 2"]
    half: bool
    length: float


def touch_return(scene, name, along, z, length):
    """The `TouchReturn` at a grazing, None where no wall is touched from outside. scene: at the point; name: of the
    branch's parameter; length: the scene's."""
    met = touches(along, z, length)
    if not met:
        return None
    bare, start, out = with_touches(along, z, met, (False,) * len(met))
    found = bare_touches(scene, bare, start, out, length)
    bare, start, found = _once(bare, start, found, length)
    half = _mirrored(scene, name, bare, start, found)
    ends = (found[0], found[1]) if half else (found[0], found[0])
    matrix = _between(bare, start, *ends) * (-1.0 if half else 1.0)
    return TouchReturn(bare, start, found, matrix, half, span(bare, start) * (0.5 if half else 1.0))


def _once(bare, z, found, length):
    """The orbit gone through once, and its touches: it may be that of a branch of more periods."""
    periods, hits = int(bare.cycle.periods), bare.hits if len(bare.cycle.sides) else ()
    for fewer in (each for each in range(1, periods) if periods % each == 0 and len(hits) * each % periods == 0):
        kept = [Hit(z[k], z[len(bare.cycle.sides) + k], bare.cycle.sides[k], True) for k in hits]
        short, start = with_impacts(bare, z, kept[: len(hits) * fewer // periods])
        short = short._replace(cycle=short.cycle._replace(periods=np.asarray(float(fewer))))
        left, _ = locate.evaluated(problem(short), start, short)
        if abs(np.asarray(left)).max() <= SAME * length:
            return short, start, _placed(short, start, found)
    return bare, z, found


def _placed(short, z, found):
    """Touches of an orbit gone through several times as those of once: `BareTouch`es."""
    whole, held, told = span(short, z), stays(short, z), []
    begins = z[short.hits] + held[short.hits] if len(short.cycle.sides) else np.zeros(1)
    for one in found:
        since = (one.time - begins) % whole
        row = int(np.argmin(since))
        new = one._replace(row=row, late=float(since[row]), time=float(begins[row] + since[row]))
        near = (abs((new.time - each.time + 0.5 * whole) % whole - 0.5 * whole) for each in told)
        if not any(away < HALF * whole for away in near):
            told.append(new)
    return tuple(told)


def _mirrored(scene, name, bare, z, found):
    """Whether two touches are mirror images of each other, and stay so along the branch."""
    if len(found) != 2 or found[0].depth.side == found[1].depth.side or not stays_symmetric(scene, name):
        return False
    whole = span(bare, z)
    if abs((found[1].time - found[0].time) % whole - 0.5 * whole) > HALF * whole:
        return False
    rows, hits = len(bare.cycle.sides), np.flatnonzero(are_impacts(bare.cycle))
    state = (0.0, 0.0) if rows else z[:2]
    parts = z[hits], z[rows + hits], np.asarray(bare.cycle.sides)[hits]
    return is_own_image(scene, OrbitPoint(z[-1], *parts, int(bare.cycle.periods), *state, 0.0))


def _between(bare, z, first, last):
    """The matrix from one `BareTouch` to another, or once round to the same: (2, 2)."""
    count = max(1, len(bare.hits))
    begin, end = np.zeros(max(1, len(bare.cycle.sides))), np.full(max(1, len(bare.cycle.sides)), np.inf)
    if first.row == last.row and first.late < last.late:
        begin[first.row], end[last.row] = first.late, last.late
        return _parts(bare, z, begin, end)[0][first.row]
    leaves, arrives = begin.copy(), end.copy()
    leaves[first.row], arrives[last.row] = first.late, last.late
    out, back, whole = (_parts(bare, z, *each) for each in ((leaves, end), (begin, arrives), (begin, end)))
    matrix, row = out[0][first.row], first.row
    while True:
        row = (row + 1) % count
        flights, jumps = back if row == last.row else whole
        matrix = flights[row] @ jumps[row] @ matrix
        if row == last.row:
            return matrix


def _passed(along, z, begin, end):
    if len(along.cycle.sides):
        built, cycle = framed(there(along, z)), cycle_at(along, z)
        found = impact_equations.flights(built, cycle)
        jumps, time = jump(built, found.met, cycle.sides)[0], found.time
    else:
        built, found = flight(along, z)
        one, time = jnp.ones_like(found.time), found.time / OVERLAP
        jumps = one, 0.0 * one, 0.0 * one, one
    x, v, cosine, sine = place(built, found, begin)
    _, matrix = flow_of(built).matrix(built, x, v, cosine, sine, jnp.minimum(end, time) - begin)
    return jnp.stack(response.by_rows(matrix)), jnp.stack(jumps)


@persistent_jit(compiler_options=SOON, numpy_first=_passed)
def _passed_as_run(along, z, begin, end):
    return one_kernel(_passed, along, z, begin, end)


def _parts(along, z, begin, end):
    """(the matrix of the flight after each row's impact between two times of it, that of each impact): (rows, 2, 2)."""
    found = _passed_as_run(along, z, begin, end)
    return tuple(np.moveaxis(np.asarray(each), 0, -1).reshape(-1, 2, 2) for each in found)
