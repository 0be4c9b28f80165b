"""Normal forms of special points: on which side of the parameter the others live, how fast they part, what is met.

At an SN, PD or SB an orbit's equations F(u, p) = 0 have a null vector v, J v = 0, w J = 0, J = F_u; at a PD J is closed
so that a change comes back as its opposite, as for the orbit gone through twice. The others are u + s v, p + b s^2:

- SN: b = -w F_uu v v / (2 w F_p);
- PD, SB: b = -(w F_uuu v v v / 6 + w F_uu v y) / c, c = w F_uu v y' + w F_up v, with F_u y = -F_uu v v / 2, F_u y' =
  -F_p closed as the orbit itself (Golubitsky and Schaeffer, Singularities and Groups in Bifurcation Theory I, chapters
  I and VI). c over how w J v changes with the closing is how fast the multiplier passes, with its sign turned.

Slopes are exact, also with soft walls: J's derivatives are differences of them along v, nine points on a line.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import locate

from ..scene.scale import force_rates, scene_length
from .equations import OrbitEquations, problem
from .grazing import padded
from .touches import scales, span, stays

APART = 0.05  # between the points of a difference, over the fastest rate
FLIGHT = 0.05  # of a flight: more no point is moved by, and of a speed, where a wall is soft
PLACES = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, 8 / 5, -1 / 5, 8 / 315, -1 / 560])  # of what is 0 at the point


class Unfolding(NamedTuple):
    """bend: b, the others are at the point's value + bend s^2; null: v, (times, speeds), s being the root mean square
    over the impacts of the changes of time and of speed over the scene's length; rate: how fast the multiplier changes
    with the parameter along the orbits that the point lies on, nan at an SN, where it does as a root."""

    bend: float
    null: Float[np.ndarray, " unknowns"]
    rate: float


class _Line(NamedTuple):
    """along: orbits; z: one of them; closing: 1, or -1 where a change comes back as its opposite; v, w: null vectors of
    J, w over the length of a row; slopes: dF/dz; by: its first derivative along v; third: w F_uuu v v v."""

    along: OrbitEquations
    closing: float
    v: Float[np.ndarray, " unknowns"]
    w: Float[np.ndarray, " unknowns"]
    slopes: Float[np.ndarray, "unknowns z"]
    by: Float[np.ndarray, "unknowns z"]
    third: float


def folded(scene, along, z):
    """The `Unfolding` of an SN. scene: at the point, here and below."""
    line = _line(scene, along, z, 1.0)
    bend = -0.5 * line.w @ line.by[:, :-1] @ line.v / (line.w @ line.slopes[:, -1])
    return Unfolding(float(bend), _told(along, line.v), np.nan)


def broken(scene, along, z):
    """The `Unfolding` of an SB."""
    line = _line(scene, along, z, 1.0)
    return _forked(line, _told(along, line.v))


def doubled(scene, along, z):
    """The `Unfolding` of a PD. Of one impact the doubled orbit is looked at: there that change is its own null
    vector."""
    if len(along.hits) > 1:
        line = _line(scene, along, z, -1.0)
        return _forked(line, _told(along, line.v))
    late, speed = z[0] + span(along, z), z[len(along.cycle.sides)]
    cycle = along.cycle._replace(periods=np.asarray(2.0 * along.cycle.periods))
    twice = along._replace(cycle=cycle)
    side = along.cycle.sides[0]
    twice = twice._replace(cycle=padded(twice, [(z[0], speed, side), (late, speed, side)]))
    line = _line(scene, twice, np.concatenate([twice.cycle.times, twice.cycle.speeds, z[-1:]]), 1.0)
    found = _forked(line, line.v[[0, 2]])
    return found._replace(rate=-0.5 * found.rate)  # its multiplier is the square


def _told(along, v):
    """A change of the impacts alone, without those of empty rows."""
    rows, count = len(along.cycle.sides), len(along.hits)
    return np.concatenate([v[:count], v[rows : rows + count]])


def _line(scene, along, z, closing):
    args = problem(along), z, along
    slopes = locate.slopes_of(*args)
    scale = scales(along, scene_length(scene))[:-1]
    matrix = _closed(along, slopes[None], closing)[0][:, :-1]
    v, w = locate.null(matrix), locate.null(matrix.T)
    v = v / np.linalg.norm(scale * v)
    v = v * np.sign(v[np.flatnonzero(abs(v) > 0.5 * abs(v).max())[0]])
    step = _step(scene, along, z, v)
    found = locate.slopes_at(problem(along), z + np.outer(PLACES * step, np.append(v, 0.0)), along)
    if closing < 0:  # the rows of the flight back to the first impact are those where that is moved the other way
        turned = np.append(v, 0.0)
        turned[_ends(along)[0]] *= -1.0
        other = locate.slopes_at(problem(along), z + np.outer(PLACES * step, turned), along)
        found = np.array(found)
        rows = _ends(along)[1]
        found[:, rows] = other[:, rows]
    by = np.tensordot(FIRST, found, 1) / step
    second = np.tensordot(SECOND, found, 1) / step**2
    return _Line(along, closing, v, w, slopes, by, float(w @ _closed(along, second[None], closing)[0][:, :-1] @ v))


def _forked(line, null):
    """The `Unfolding` of a pitchfork: of the orbit twice round, or of one without its symmetry."""
    size = len(line.v)
    bent = _closed(line.along, line.by[None], line.closing)[0][:, :-1] @ line.v
    matrix = np.zeros((size + 1, size + 1))
    matrix[:size, :size] = line.slopes[:, :-1]
    if line.closing > 0:  # singular: what is solved for is in its range
        matrix[:size, -1], matrix[-1, :size] = line.w, line.v
    else:
        matrix[-1, -1] = 1.0
    right = np.vstack([np.stack([-0.5 * bent, -line.slopes[:, -1]], 1), np.zeros((1, 2))])
    still, moved = np.linalg.solve(matrix, right)[:size].T
    across = line.w @ line.by
    rate = across[:-1] @ moved + across[-1]
    first, rows = _ends(line.along)
    by_closing = line.w[rows] @ line.slopes[np.ix_(rows, first)] @ line.v[first]
    return Unfolding(float(-(line.third / 6.0 + across[:-1] @ still) / rate), null, float(-rate / by_closing))


def _ends(along):
    """(the unknowns of the first impact, the rows of the flight back to it)."""
    rows = len(along.cycle.sides)
    last = len(along.hits) - 1
    return [0, rows], [last, rows + last]


def _closed(along, slopes, closing):
    """Slopes, some, where a change of the first impact comes back times the closing."""
    found = np.array(slopes)
    if closing < 0:
        first, rows = _ends(along)
        for row in rows:
            found[:, row, first] *= -1.0
    return found


def _step(scene, along, z, v):
    """How far along v a difference's points are apart: so that what they are of is smooth over all of them."""
    rows, hits, length = len(along.cycle.sides), along.hits, scene_length(scene)
    times, speeds = abs(v[hits]), abs(v[rows + hits])
    flights = np.append(z[hits[1:]], z[hits[0]] + span(along, z)) - z[hits] - stays(along, z)[hits]
    change = [
        (times + np.roll(times, -1)) / (FLIGHT * flights),
        np.maximum(times, speeds / length) * max(_rate(scene), *_swings(scene, along, z)) / APART,
    ]
    if scene.soft_sides:
        change.append(speeds / (FLIGHT * abs(z[rows + hits])))
    return 1.0 / float(np.max(change))


def _swings(scene, along, z):
    """How fast what is within soft walls beside a force swings, by how long it stays: numbers, one at least."""
    held = stays(along, z)[along.hits] if scene.soft_sides and scene.force is not None else np.zeros(0)
    return [0.0, *(np.pi / held[held > 0])]


def _rate(scene):
    """How fast the fastest of what an orbit's equations hold turns or decays."""
    frequency = float(scene.frequency)
    if scene.force is None:
        damping = float(scene.damping)
        rates = [1.0, frequency, 2.0 * damping]
    else:
        rates = [frequency, *force_rates(scene)]
    rates += [term.harmonic * frequency for term in scene.drive]
    for wall in scene.walls.values():
        if wall.soft and scene.force is None:
            own = damping if wall.damping is None else damping + float(wall.damping)
            rates += [np.sqrt(1.0 + float(wall.stiffness)), 2.0 * own]
        if wall.motion is not None:
            rates.append(wall.motion.harmonic * frequency)
    return max(rates)
