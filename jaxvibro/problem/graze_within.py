"""Grazing from within: a mass within a soft wall comes back to it, and just does not leave, or just does.

Where it leaves for a moment and enters again, one contact is two. With h how far it comes out, a its acceleration into
the wall, the speeds of leaving and entering are sqrt(2 a h), to first order, and the force has no jump where
`soft_grazing.is_smooth`: the motion outside differs from that within by h^(3/2), so that the orbits of one contact and
those of two are one branch, its tangent continuous. Of the equations with two it is a singular point, as the time of
leaving changes like the root of h; and those with one lose their stay's end, which jumps to the touch. It is a regular
point of the equations with one contact whose stay goes on past the touch (`Cycle.passed`): there it is found, and left.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import event_search, locate
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight import flow, soft_contact
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..scene.codes import Contact
from . import grazing
from .equations import OrbitEquations, cycle_at, problem, there
from .grazing import LOOSE, Hit, with_impacts
from .soft_grazing import ASIDE, is_smooth
from .touches import Touch, flight_times, scales, span, stays

NEAR = 1e-2  # of the scene's length: a contact that comes as near to its wall, or enters as slowly, may be about to
DEEP = 1e-12  # of the scene's length: below the wall there the orbits with one contact end
SLOW = 1e-6, 3e-6  # of the scene's length per t: at that speed of entering those with two end, the first that is met
SAMPLE, MOST = 0.2, 512  # of a stay's own time between samples; samples of a stay
HALF = 1.25  # half-swings: in a shorter stay the mass does not come back twice
ROUNDS = 6  # of Newton's steps to a turning point


def is_pressed_in(along, z, row):
    """Whether a mass that comes to its wall at a row without speed is pressed into it: it came from within."""
    return along.scene.force is None and bool(_at(along, z, row, 0.0)[2] > 0)


class Dip(NamedTuple):
    """Where a mass comes back to its wall within a stay. row: of the contact; late: the time since it began; depth, how
    far it is past the wall there; pull: its acceleration into the wall."""

    row: int
    late: float
    depth: float
    pull: float


class WithinGraze(NamedTuple):
    """A grazing from within. whole: the equations with one contact, its stay going on past the touch; z: its orbit;
    row: of the contact; late: when the touch is since that began; tangent: of the branch, towards orbits that stay
    within; rate: how fast the depth at the touch grows along it; pull: the acceleration into the wall; residual."""

    whole: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    row: int
    late: float
    tangent: Float[np.ndarray, " unknowns"]
    rate: float
    pull: float
    residual: float


def _within(z, times, along, row):
    """(depth, its rate, the acceleration into the wall) at times since the contact in a row began."""
    built, given = framed(there(along, z)), cycle_at(along, z)
    like = 0.0 * times
    side, touch = given.sides[row] + like, given.sides[row] * float(Contact.ENTERED) + like
    here = soft_contact.feeling(built, touch)
    angle = given.phase + built.frequency * given.times[row] + like
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    response = soft_contact.response(here, touch, times)
    y, v = soft_contact.flown(here, touch, response, (like, side * given.speeds[row]), cosine, sine)
    turned = flow.rotated(cosine, sine, built.frequency * times)
    pull, _ = flow_of(here).accelerations(here, y, v, *turned, soft_contact.biases(here, touch, *turned, 1))
    return jnp.stack([side * y, side * v, side * pull])


@persistent_jit(compiler_options=SOON, numpy_first=_within)
def _inside(z, times, along, row):
    return one_kernel(_within, z, times, along, row)


def _at(along, z, row, late):
    """The same at one time: three numbers."""
    return np.asarray(_inside(z, np.array([late]), along, np.int32(row)))[:, 0]


def dips(along, z):
    """The `Dip`s of the contacts with walls of a spring and a damper at which the force has no jump, one of each: the
    nearest to its wall."""
    scene, found = along.scene, []
    if not scene.soft_sides or scene.force is not None or not len(along.cycle.sides):
        return found
    held = stays(along, z)
    for row in along.hits:
        side = int(along.cycle.sides[row])
        if not is_smooth(scene, side) or not np.isfinite(held[row]):
            continue
        rate, half = _swing(along, z, side)
        if held[row] > HALF * half:
            one = _nearest(along, z, int(row), float(held[row]), rate)
            found += [one] if one else []
    return found


def _swing(along, z, side):
    """(how fast the mass swings within a wall, its half-swing, inf where it creeps)."""
    name = "left" if side < 0 else "right"
    soft = {term: _number(along, z, name, term) for term in ("stiffness", "damping")}
    rate = np.sqrt(1.0 + soft["stiffness"])
    spare = rate * rate - soft["damping"] ** 2
    return rate, np.pi / np.sqrt(spare) if spare > 0 else 0.0


def _number(along, z, side, term):
    """A number of a wall at z, its hardness counted."""
    return float(np.asarray(there(along, z).replace().parameter(f"{side}.{term}")))


def _nearest(along, z, row, held, rate):
    """The `Dip` of a stay of so long, None where the mass does not come back to its wall before the end."""
    count = min(MOST, 1 << int(np.ceil(np.log2(held * rate / SAMPLE + 8.0))))
    times = held * np.arange(1, count + 1) / (count + 1.0)
    depth, closing, _ = np.asarray(_inside(z, times, along, np.int32(row)))
    cells = np.flatnonzero((closing[:-1] < 0) & (closing[1:] >= 0))
    if not len(cells):
        return None
    best = cells[np.argmin(depth[cells])]
    share = closing[best] / (closing[best] - closing[best + 1])
    return _settled(along, z, row, times[best] + share * (times[1] - times[0]))


def _settled(along, z, row, late):
    """The `Dip` near a time."""
    for _ in range(ROUNDS):
        _, closing, pull = _at(along, z, row, late)
        late -= closing / pull
    depth, _, pull = _at(along, z, row, late)
    return Dip(row, float(late), float(depth), float(pull)) if np.isfinite(late) and pull > 0 else None


def past(along, row, late, reach):
    """The `OrbitEquations` whose stay at a row goes on past a touch at a time: a little later it is within."""
    passed = np.zeros(len(along.cycle.sides))
    passed[row] = late + reach
    return along._replace(cycle=along.cycle._replace(passed=passed))


def located(along, z, row, late, length):
    """The `WithinGraze` near z where a stay touches its wall at about a time, None where none is found."""
    rate, _ = _swing(along, z, int(along.cycle.sides[row]))
    whole = past(along, row, late, 1.0 / rate)
    towards = partial(_touching, along, row)

    def system(y):
        value, slopes = (np.asarray(each) for each in locate.evaluated(problem(whole), y[:-1], whole))
        both = np.vstack([np.pad(slopes, ((0, 0), (0, 1))), locate.differences(towards, y)])
        return np.concatenate([value, towards(y)]), both

    found = locate.newton(system, np.append(z, late))
    if found.z is None or not np.isfinite(found.z).all():
        return None
    z, late = found.z[:-1], float(found.z[-1])
    pull = float(_at(along, z, row, late)[2])
    tangent = event_search.tangent(problem(whole), z, scales(along, length), whole)
    rate = _growing(along, z, tangent, row, late)
    if not (late > 0 and pull > 0 and abs(rate) > 0):
        return None
    sign = np.sign(rate)
    return WithinGraze(whole, z, row, late, sign * tangent, abs(rate), pull, float(found.residual))


def _touching(along, row, y):
    return _at(along, y[:-1], row, y[-1])[:2]


def _growing(along, z, direction, row, late):
    """How fast the depth at a time of a stay grows in a direction of z."""
    ends = (_at(along, z + sign * locate.APART * direction, row, late)[0] for sign in (1, -1))
    return float(np.subtract(*ends) / (2.0 * locate.APART))


class Ahead(NamedTuple):
    """A grazing from within that a branch is about to meet. z: its orbit where the branch ends; step: how far ahead;
    residual; touches, exits, sure: as `grazing.exits` gives them."""

    z: Float[np.ndarray, " unknowns"]
    step: float
    residual: float
    touches: list[Touch]
    exits: list[grazing.GrazingExit]
    sure: bool


def ahead(along, points, control, length):
    """(the place of the last of a branch's points before a grazing from within, its `Ahead`), None where there is none
    near. points: as `arclength.Point`s, the last one that from which no step was tried yet, or failed."""
    if along.scene.force is not None or not along.scene.soft_sides or not len(along.cycle.sides):
        return None
    for k in range(1, len(points.z)):
        found = _joins(along, points.z[k], points.tangent[k], control, length)
        if found is not None:
            return k, found
    last = len(points.z) - 1
    found = _splits(along, points.z[last], points.tangent[last], control, length)
    return found and (last, found)


def _splits(along, z, tangent, control, length):
    """One contact that is about to be two."""
    for dip in dips(along, z):
        if not 0 < dip.depth < NEAR * length:
            continue
        rate = _growing(along, z, tangent, dip.row, dip.late)
        found = located(along, z, dip.row, dip.late, length) if rate < 0 else None
        if found is None:
            continue
        way = float(np.sum(control.scale**2 * tangent * (found.z - z)))
        if abs(way + dip.depth / rate) < -0.5 * dip.depth / rate:
            end = found.z + DEEP * length / found.rate * found.tangent
            met = [Touch(found.row, int(along.cycle.sides[found.row]), found.late, False)]
            one = _apart(along, found, length)
            return Ahead(end, way, found.residual, met, [one] if one else [], one is not None)
    return None


def _apart(along, found, length):
    """The `GrazingExit` along orbits of two contacts, None where Newton's method comes to none."""
    z, row, rows = found.z, found.row, len(along.cycle.sides)
    side, begun = int(along.cycle.sides[row]), found.z[found.row] + found.late
    hits = [Hit(z[k], z[rows + k], int(along.cycle.sides[k]), True) for k in along.hits]
    hits.insert(row + 1, Hit(begun, 0.0, side, True))
    new, start = with_impacts(along._replace(cycle=along.cycle._replace(passed=None)), z, hits)
    size, moved = len(new.cycle.sides), np.zeros(len(start))
    places = [k + (k > row) for k in along.hits]
    moved[places], moved[np.add(size, places)] = -found.tangent[along.hits], -found.tangent[rows + along.hits]
    moved[row + 1], moved[-1] = -found.tangent[row], -found.tangent[-1]
    for aside in (10.0 * ASIDE[0], *ASIDE):
        speed = aside * length
        guess = start + speed**2 / (2.0 * found.pull * found.rate) * moved
        guess[row + 1] += speed / found.pull
        guess[size + row + 1] = speed
        tangent = np.zeros(len(start))
        tangent[row + 1], tangent[size + row + 1] = 1.0 / found.pull, 1.0
        tangent /= np.linalg.norm(scales(new, length) * tangent)
        way, _ = grazing.stepped(new, guess, tangent, length, (True,), LOOSE, (0.0,))
        if way:
            tangent = event_search.tangent(problem(new), way.near, scales(new, length), new, tangent)
            return way._replace(point=way.point._replace(z=way.near, tangent=tangent))
    return None


def _joins(along, z, tangent, control, length):
    """Two contacts that are about to be one: the first of them ends as the second begins."""
    size, sides = len(along.cycle.sides), along.cycle.sides
    hits = [int(k) for k in along.hits]
    for place, row in enumerate(hits):
        before = hits[place - 1]
        slow = 0 < z[size + row] < NEAR * length and tangent[size + row] < 0
        if not slow or before == row or sides[before] != sides[row] or not is_smooth(along.scene, sides[row]):
            continue
        flights, held = flight_times(along, z), stays(along, z)
        _, _, pull = _at(along, z, row, 0.0)
        if not pull > 0 or flights[before] > 4.0 * z[size + row] / pull:
            continue
        found = _joined(along, z, row, before, held, flights, length)
        if found is None:
            continue
        bare, one, kept = found
        met = np.array(z)
        for k, place_k in kept:
            met[k], met[size + k] = one.z[place_k], one.z[len(bare.cycle.sides) + place_k]
        turns = span(along, z)
        met[row] = one.z[one.row] + one.late
        met[row] -= turns * np.round((met[row] - z[row]) / turns)
        met[size + row], met[-1] = 0.0, one.z[-1]
        way = float(np.sum(control.scale**2 * tangent * (met - z)))
        rest = -z[size + row] / tangent[size + row]
        if not abs(way - rest) < 0.5 * rest:
            continue
        pinned = (event_search.pinned(problem(along), met, size + row, u * length, control, along) for u in SLOW)
        end = next((one for one in pinned if one.met), None)
        if end is None:
            continue
        plain = bare._replace(cycle=bare.cycle._replace(passed=None))
        out, sure = grazing.leave(plain, one.z, one.tangent, np.array([one.rate]), length, (False,))
        out = out and out._replace(point=out.point._replace(z=out.near))
        touch = [Touch(row, int(sides[row]), 0.0, True)]
        return Ahead(end.z, way, one.residual, touch, [out] if out else [], sure)
    return None


def _joined(along, z, row, before, held, flights, length):
    """(equations without the contact at a row, the `WithinGraze` there, [(row of those kept, the place there)])."""
    size, sides = len(along.cycle.sides), along.cycle.sides
    keep = [int(k) for k in along.hits if k != row]
    bare, start = with_impacts(along, z, [Hit(z[k], z[size + k], int(sides[k]), True) for k in keep], keep)
    late = held[before] + 0.5 * flights[before]
    found = located(bare, start, keep.index(before), float(late), length)
    return found and (bare, found, list(zip(keep, range(len(keep)), strict=True)))
