"""Periodic orbits by their impacts: times and speeds as unknowns, for walls hit in a given order.

Between an impact at time t_i and the next at t_j the mass flies freely; there it must be at the wall, with the speed
u_j against it. These equations stay smooth where a speed goes to zero, and see no wall between impacts: whether an
orbit passes through one is asked afterwards (`flight_clearance`). All of it is for one cycle; arrays have a row an
impact, those beyond the last are empty, with side 0.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from continuation.arrays import Array
from continuation.newton import newton

from ..flight import response
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..maps.contact_duration import product
from .meeting_wall import pressed
from .saltation import Meeting, jump, meeting, stayed

LONGEST = 0.1  # of a drive period: the largest change of a time in one of Newton's steps


class Cycle(NamedTuple):
    """Impacts in order of travel. times: since the drive was at the section's phase; speeds: abs(y- - v_b), both
    (rows,); sides: -1, +1, 0 an empty row; phase: the section's, rad; periods: the number of drive periods. turn: 1, or
    -1 where what follows is the mirror image of the impacts, so that they are half an orbit; None is 1. closing: what a
    change of the first impact is multiplied by as it comes after the last, in derivatives alone; None is 1. still:
    (rows,), 1 at touches, impacts without speed, of a soft wall, which do nothing; None: there are none. releases:
    (rows,), 1 where a row is no impact but the end of a rest on its wall, without speed, 2 where R is 0 and the mass is
    drawn off that wall once more before the rest; None: there are none. passed:
    (rows,), a time of the stay within a soft wall before which the mass leaves for no return to it; None: 0."""

    times: Float[Array, "*lanes rows"]
    speeds: Float[Array, "*lanes rows"]
    sides: Float[Array, "*lanes rows"]
    phase: Float[Array, "*lanes"]
    periods: Float[Array, "*lanes"]
    turn: Float[Array, "*lanes"] | None = None
    closing: Float[Array, "*lanes"] | None = None
    still: Float[Array, "*lanes rows"] | None = None
    releases: Float[Array, "*lanes rows"] | None = None
    passed: Float[Array, "*lanes rows"] | None = None


class Flights(NamedTuple):
    """The flight that follows each impact: its time; x, v, and the drive's cosine and sine at its start; x and v at its
    end; the matrix of a flow's `matrix`; the row of the impact at its end, and -1 where that is met as its mirror
    image, else 1; and the `saltation.Meeting` at its start."""

    time: Float[Array, " rows"]
    x: Float[Array, " rows"]
    v: Float[Array, " rows"]
    cosine: Float[Array, " rows"]
    sine: Float[Array, " rows"]
    end_x: Float[Array, " rows"]
    end_v: Float[Array, " rows"]
    matrix: tuple[Float[Array, " rows"], ...]
    follows: Int[Array, " rows"]
    sign: Float[Array, " rows"]
    met: Meeting


@jax.jit
def flights(frame, cycle):
    """The `Flights` of a cycle."""
    sides, rows = cycle.sides, jnp.arange(len(cycle.sides))
    last = jnp.sum(sides != 0) - 1
    follows = jnp.where(rows < last, rows + 1, 0)
    one = jnp.ones((), cycle.times.dtype)
    sign = jnp.where(rows == last, one if cycle.turn is None else cycle.turn, one)
    angle = cycle.phase + frame.frequency * cycle.times
    met = meeting(frame, sides, jnp.cos(angle), jnp.sin(angle), cycle.speeds, cycle.still, cycle.passed)
    again = jnp.where(rows == last, cycle.periods * frame.period, 0.0)
    time = _following(cycle, cycle.times, follows) - cycle.times + again
    time = time if met.stay is None else time - met.stay
    flies = sides != 0 if cycle.releases is None else (sides != 0) & (cycle.releases[follows] == 0)
    time = jnp.where(flies, jnp.maximum(time, 0.0), 0.0)
    (x, v), (cosine, sine) = met.state, met.phasor
    (end_x, end_v), matrix = flow_of(frame).matrix(frame, x, v, cosine, sine, time)
    return Flights(time, x, v, cosine, sine, end_x, end_v, matrix, follows, sign, met)


def _following(cycle, values, follows):
    """The values of the impacts that follow."""
    found = values[follows]
    if cycle.closing is None:
        return found
    return found + jnp.where(follows == 0, cycle.closing - 1.0, 0.0) * (found - lax.stop_gradient(found))


def unwound(cycle, period, moves):
    """The cycle with its first impact once more after its last. moves: (a change of its unknowns, by what that is
    multiplied where the first comes again), some."""
    rows, last = len(cycle.sides), jnp.sum(cycle.sides != 0)
    place = jnp.arange(rows + 1)
    again, source = place == last, jnp.where(place < last, place, 0)
    times = cycle.times[source] + jnp.where(again, cycle.periods * period, 0.0)
    speeds = cycle.speeds[source] + 0.0
    for change, back in moves:
        sign = jnp.where(again, back, 1.0)
        times, speeds = times + sign * change[:rows][source], speeds + sign * change[rows:][source]
    turn = 1.0 if cycle.turn is None else cycle.turn
    sides = jnp.where(place <= last, jnp.where(again, turn, 1.0) * cycle.sides[source], 0.0)
    return Cycle(times, speeds, sides, cycle.phase, cycle.periods)


class Slopes(NamedTuple):
    """How each row's equations, first the gap, then the speed, change with its own time and speed: ((a, b), (c, d));
    and with the next impact's: ((e, 0), (f, -1)). last: the row whose next is the first."""

    own: tuple[tuple[Float[Array, " rows"], Float[Array, " rows"]], tuple[Float[Array, " rows"], Float[Array, " rows"]]]
    following: tuple[Float[Array, " rows"], Float[Array, " rows"]]
    last: Int[Array, ""]


def equations(frame, cycle, found=None):
    """(F, its `Slopes`) of the unknowns u = (times, speeds): how far each flight ends from its wall, from its speed.

    Before a release no flight ends: a rest forgets how it was come by, and the press on the wall and the speed are to
    be zero. found: the cycle's `Flights` where they are known.
    """
    found, sides = flights(frame, cycle) if found is None else found, cycle.sides
    hit = sides != 0

    def ahead(values):
        return found.sign * _following(cycle, values, found.follows)

    aim, met = ahead(sides), found.met
    speed = found.end_v - ahead(met.pace)
    pull, _ = flow_of(frame).accelerations(frame, found.end_x, found.end_v, ahead(met.cosine), ahead(met.sine))
    gap = found.end_x - ahead(met.where)
    excess = aim * speed - _following(cycle, cycle.speeds, found.follows)
    (a, c), (b, d) = (response.through(found.matrix, x, v) for x, v in (met.by_time, met.by_speed))
    c, d = aim * c, aim * d
    own = (a, b), (c, d)
    following = speed, aim * (pull - ahead(met.bend))
    if cycle.releases is not None:
        rests = cycle.releases[found.follows] > 0
        push, change = (ahead(each) for each in pressed(frame, sides, (met.cosine, met.sine)))
        gap = jnp.where(rests, push, gap)
        excess = jnp.where(rests, -_following(cycle, cycle.speeds, found.follows), excess)
        own = jax.tree.map(lambda each: jnp.where(rests, 0.0, each), own)
        following = jnp.where(rests, change, following[0]), jnp.where(rests, 0.0, following[1])
    values = jnp.where(jnp.tile(hit, 2), jnp.concatenate([gap, excess]), 0.0)
    return values, Slopes(own, following, jnp.sum(hit) - 1)


def solve(slopes, values):
    """(the change of the unknowns that these values ask for, how far from singular): row by row, each next change from
    the one before, and the first so that the circle closes."""
    rows = len(values) // 2
    ((a, b), (c, d)), (e, f) = slopes.own, slopes.following
    gap, excess = values[:rows], values[rows:]
    # (e, 0; f, -1) next = value - (a, b; c, d) own
    transfer = (-a / e, -b / e, c - f * a / e, d - f * b / e)
    shift = (gap / e, f * gap / e - excess)
    zero, one = jnp.zeros_like(gap[0]), jnp.ones_like(gap[0])

    def compose(carry, row):
        place, ((t00, t01, t10, t11), (s0, s1)) = row
        (m00, m01, m10, m11), (h0, h1) = carry
        new = (t00 * m00 + t01 * m10, t00 * m01 + t01 * m11, t10 * m00 + t11 * m10, t10 * m01 + t11 * m11)
        new = new, (t00 * h0 + t01 * h1 + s0, t10 * h0 + t11 * h1 + s1)
        return jax.tree.map(lambda new, old: jnp.where(place <= slopes.last, new, old), new, carry), None

    places = jnp.arange(rows)
    start = (one, zero, zero, one), (zero, zero)
    (whole, (h0, h1)), _ = lax.scan(compose, start, (places, (transfer, shift)))
    m00, m01, m10, m11 = whole
    a, d = 1.0 - m00, 1.0 - m11
    determinant = a * d - m01 * m10
    first = (d * h0 + m01 * h1) / determinant, (m10 * h0 + a * h1) / determinant

    def advance(change, row):
        place, ((t00, t01, t10, t11), (s0, s1)) = row
        here = jax.tree.map(lambda each: jnp.where(place <= slopes.last, each, 0.0), change)
        return (t00 * change[0] + t01 * change[1] + s0, t10 * change[0] + t11 * change[1] + s1), here

    _, (times, speeds) = lax.scan(advance, first, (places, (transfer, shift)))
    return jnp.concatenate([times, speeds]), abs(determinant) / (1.0 + abs(m00 * m11) + abs(m01 * m10))


def solved(scene, cycle):
    """What Newton's method makes of a cycle's times and speeds: `newton.Solved`."""
    built, rows = framed(scene), len(cycle.sides)

    def function(unknowns):
        return equations(built, cycle._replace(times=unknowns[:rows], speeds=unknowns[rows:]))

    longest = jnp.repeat(jnp.array([LONGEST * built.period, jnp.inf]), rows, total_repeat_length=2 * rows)
    return newton(function, jnp.concatenate([cycle.times, cycle.speeds]), longest, solve=solve)


def ordered(scene, cycle, unknowns):
    """The cycle with these times and speeds, its times within its periods and in order."""
    rows, span = len(cycle.sides), cycle.periods * 2.0 * jnp.pi / scene.frequency
    times, speeds = unknowns[:rows], unknowns[rows:]
    times = jnp.where(cycle.sides != 0, times - span * jnp.floor(times / span), jnp.inf)
    order = jnp.argsort(times)
    times = jnp.where(jnp.isfinite(times), times, 0.0)
    releases = None if cycle.releases is None else cycle.releases[order]
    return Cycle(times[order], speeds[order], cycle.sides[order], cycle.phase, cycle.periods, releases=releases)


def invariants(frame, found, sides):
    """(trace, determinant) of the monodromy matrix, the product of P and Q of all flights; the determinant is the
    product of theirs. Of orbits that rest both are zero, and are not asked for here."""
    jumps, shrink = jump(frame, found.met, sides)

    def on(k, carry):
        matrix, determinant = carry
        flight = [each[k] for each in found.matrix]
        q00, q01, q10, q11 = product([each[k] for each in jumps], matrix)
        (m00, m10), (m01, m11) = response.through(flight, q00, q10), response.through(flight, q01, q11)
        new = (m00, m01, m10, m11), determinant * shrink[k] * response.determinant(flight)
        return jax.tree.map(lambda new, old: jnp.where(sides[k] != 0, new, old), new, carry)

    one, zero = jnp.ones_like(found.time[0]), jnp.zeros_like(found.time[0])
    (m00, _, _, m11), determinant = lax.fori_loop(0, len(sides), on, ((one, zero, zero, one), one))
    return m00 + m11, determinant


def at(frame, cycle, found, time):
    """(x, v) of the cycle at times since the section's phase, (any number,)."""
    span = cycle.periods * frame.period
    since = time[:, None] - cycle.times
    since = jnp.where(cycle.sides != 0, since - span * jnp.floor(since / span), jnp.inf)
    k = jnp.argmin(since, axis=1)
    since = jnp.take_along_axis(since, k[:, None], 1)[:, 0]
    late = since if found.met.stay is None else jnp.maximum(since - found.met.stay[k], 0.0)
    state = flow_of(frame).fly(frame, found.x[k], found.v[k], found.cosine[k], found.sine[k], late)[:2]
    return state if found.met.stay is None else stayed(frame, found.met, cycle.sides, k, since, state)
