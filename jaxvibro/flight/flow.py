"""Free flight, x'' + 2 gamma x' + x = A cos(omega t) (paper, (3)): exact, with no division by D or sqrt(1 - gamma^2).

Within a soft wall the same with a stiffness of 1 + k2 before x; a stiffness that is None is 1.

Over a step that is short beside the fastest of omega, 1 and 2 gamma the flow is its own Taylor series, which needs
products alone and so is right at resonance, at critical damping and beyond. Any longer time is such a step doubled.
"""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene import check

STEP = 1.0  # longest step, in units of 1 / rate
ORDER = 18  # STEP^19 / 19! < 1e-17
SPARED = 5  # of the degrees of a `Series`, by `shortened`


Number = Float[jax.Array, "..."]
FreeFlow = tuple[Number, Number, Number]  # p00, p01, p11
ForcedFlow = tuple[tuple[Number, Number], tuple[Number, Number]]  # x, v under cos, under sin
Rows = Float[jax.Array, "_ ..."] | list[Float[jax.Array, "..."]]


class Series(NamedTuple):
    """Taylor coefficients of the `Gains`, their order first, each from its first power of t that is not zero."""

    stay: Rows
    move: Rows
    lift: Rows
    lag: Rows


class Gains(NamedTuple):
    """What a flight of a given time does, from its series.

    stay: p00 - 1 and move: p01 of the free flow ((p00, p01), (-p01, p00 - 2 gamma p01)); lift, lag: x after a start
    from rest under the force cos(omega t), sin(omega t); versed, sined: cos - 1 and sin of the drive's angle.
    """

    stay: Float[jax.Array, "*lanes"]
    move: Float[jax.Array, "*lanes"]
    lift: Float[jax.Array, "*lanes"]
    lag: Float[jax.Array, "*lanes"]
    versed: Float[jax.Array, "*lanes"]
    sined: Float[jax.Array, "*lanes"]


def rate(frequency, damping, stiffness=None):
    """An upper bound, at least 1, of how fast the drive and the free oscillation turn or decay, in radians over t."""
    own = 1.0 if stiffness is None else lax.sqrt(stiffness)
    fast = choose(frequency > own, frequency, own)
    return choose(2.0 * damping > fast, 2.0 * damping, fast)


def pulled(stiffness, x):
    """The spring's pull at x."""
    return x if stiffness is None else stiffness * x


def series(frequency, damping, stiffness=None):
    """The `Series` of an oscillator: derivatives at t = 0 by the equation of motion, over factorials."""
    one = jnp.ones_like(frequency * damping * (1.0 if stiffness is None else stiffness))
    none = jnp.zeros_like(one)

    def extended(pairs, _):
        (drive, drive_next), (free, free_next), (forced, forced_next) = pairs
        new = (
            (drive_next, -(frequency * frequency) * drive),
            (free_next, -2.0 * damping * free_next - pulled(stiffness, free)),
            (forced_next, drive - 2.0 * damping * forced_next - pulled(stiffness, forced)),
        )
        return new, (free, forced)

    _, (free, forced) = lax.scan(extended, ((one, none), (none, one), (none, none)), length=ORDER + 1)

    def over(values, more):
        found = [1.0 / math.factorial(k + more) for k in range(ORDER + 1)]
        return values * jnp.array(found, values.dtype).reshape(-1, *[1] * one.ndim)

    # p00' = -stiffness p01, lag' = omega lift
    return Series(
        -pulled(stiffness, over(free, 1)[1:-1]),
        over(free, 0)[1:],
        over(forced, 0)[2:],
        frequency * over(forced, 1)[2:-1],
    )


def shortened(series):
    """The `Series` with polynomials of `SPARED` degrees less, for times from 0 to a longest step, which is to be 1.

    They are the old ones without Chebyshev's polynomials beyond the degree (economisation): less than 1e-16 of the
    first coefficient, as those of a flow fall like 1 / k!.
    """
    return Series(*(rows if rows is None else _shortened(rows) for rows in series))


def _shortened(rows):
    kept = len(rows) - SPARED
    total = rows[:kept]
    for shares, row in zip(_shares(kept), rows[kept:], strict=True):
        total = total + jnp.array(shares, rows.dtype).reshape(-1, *[1] * row.ndim) * row
    return total


@lru_cache(8)
def _shares(kept):
    """For each power of t that is spared, what it adds to the coefficients that are kept."""
    chebyshev = [[1], [-1, 2]]  # in t from 0 to 1
    for _ in range(kept - 2):
        last, before = chebyshev[-1], [*chebyshev[-2], 0, 0]
        chebyshev.append([4 * a - 2 * b - c for a, b, c in zip([0, *last], [*last, 0], before, strict=True)])
    found = []
    for power in range(kept, kept + SPARED):
        total = [Fraction(0)] * kept
        for j, own in enumerate(chebyshev):
            part = Fraction(math.comb(2 * power, power - j) * (2 if j else 1), 4**power)
            total[: j + 1] = [old + part * each for old, each in zip(total, own, strict=False)]
        found.append([float(each) for each in total])
    return found


def gains(series, frequency, time):
    """The `Gains` over 0 <= time <= STEP / rate."""
    angle = frequency * time
    square = time * time
    stay, move = horner(series.stay, time) * square, horner(series.move, time) * time
    return Gains(stay, move, *lifts(series, time), versine(angle), sinus(angle))


def lifts(series, time):
    """(lift, lag) of the `Gains`."""
    square = time * time
    return horner(series.lift, time) * square, horner(series.lag, time) * (square * time)


def horner(coefficients, time):
    """The polynomial with these coefficients, from the constant on: rows of an array, or a list."""
    total = coefficients[len(coefficients) - 1]
    for k in range(len(coefficients) - 2, -1, -1):
        total = total * time + coefficients[k]
    return total


def extend(frequency, damping, stiffness, drive, bias, jet):
    """The next two derivatives of the drive's force and of x from the last two of each: (drive, jet).

    bias: those of another force, None where it is zero.
    """
    square, drag = -(frequency * frequency), -2.0 * damping
    first, second = (own if more is None else own + more for own, more in zip(drive, bias, strict=True))
    third = first + (drag * jet[1] - pulled(stiffness, jet[0]))
    fourth = second + (drag * third - pulled(stiffness, jet[1]))
    return (drive[0] * square, drive[1] * square), (third, fourth)


def versine(angle):
    """cos(angle) - 1 to rounding for abs(angle) <= STEP."""
    square = angle * angle
    total = lax.full_like(angle, -1.0 / math.factorial(18))
    for k in range(8, 0, -1):
        total = total * square + (-1.0) ** k / math.factorial(2 * k)
    return total * square


def sinus(angle):
    """sin(angle) to rounding for abs(angle) <= STEP."""
    square = angle * angle
    total = lax.full_like(angle, 1.0 / math.factorial(17))
    for k in range(7, -1, -1):
        total = total * square + (-1.0) ** k / math.factorial(2 * k + 1)
    return total * angle


def turn(cosine, sine, versed, sined):
    """The drive's cosine and sine, turned by an angle given by its cosine less 1 and its sine."""
    return cosine + (cosine * versed - sine * sined), sine + (sine * versed + cosine * sined)


def rotated(cosine, sine, angle):
    """The drive's cosine and sine, turned by any angle."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return cosine * c - sine * s, sine * c + cosine * s


def fly(scene, state, time):
    """The state after a free flight of a given length under A cos(omega t): walls are not looked at.

    scene: amplitude, frequency and damping are used; state: x, v, phase; time >= 0, in t. All broadcast together.
    Returns (x, v). Error below 1e-13 (1 + t)^2 (abs x + abs v + A) over damping [0, 5] and frequency [0.05, 20].
    """
    check.require_one_harmonic(scene, "fly")
    values = (scene.amplitude, scene.frequency, scene.damping, state.x, state.v, state.phase, time)
    values = jnp.broadcast_arrays(*(jnp.asarray(value, scene.dtype) for value in values))
    force, frequency, damping, x, v, phase, time = values
    return flown(responses(frequency, damping, time), force * jnp.cos(phase), force * jnp.sin(phase), x, v)


def flown(responses, cosine, sine, x, v, stiffness=None):
    """(x, v) after the flight of these `responses`, under the force cosine cos(omega t) - sine sin(omega t)."""
    (p00, p01, p11), (in_phase, in_quadrature) = responses
    moved = p00 * x + p01 * v + (cosine * in_phase[0] - sine * in_quadrature[0])
    return moved, p11 * v - p01 * pulled(stiffness, x) + (cosine * in_phase[1] - sine * in_quadrature[1])


def responses(frequency, damping, time):
    """((p00, p01, p11), (of cos, of sin)): the free flow's matrix ((p00, p01), (-p01, p11)) over a time >= 0, and x, v
    after a start from rest under the force cos(omega t), sin(omega t). All of one shape."""
    return doubled(series(frequency, damping), frequency, damping, time)[:2]


@jax.jit
def doubled(series, frequency, damping, time, stiffness=None):
    """The `responses` over any time >= 0 from a `Series`, and cos - 1 and sin of the drive's angle.

    The free flow's matrix is ((p00, p01), (-stiffness p01, p11)).
    """
    fast, zero = rate(frequency, damping, stiffness), lax.full_like(time, 0.0)

    def is_long(carry):
        return jnp.any(carry[0] * fast > STEP)

    def halve(carry):
        step, count = carry
        long = step * fast > STEP
        return choose(long, 0.5 * step, step), count + choose(long, zero + 1.0, 0.0)

    _, count = lax.while_loop(is_long, halve, (lax.stop_gradient(time), zero))

    def double(carry):
        left, now = carry
        new = twice(stiffness, *now)
        return left - 1.0, jax.tree.map(lambda new, old: choose(left > 0, new, old), new, now)

    start = (count, _short(series, frequency, damping, time * jnp.exp2(-count)))
    return lax.while_loop(lambda carry: jnp.any(carry[0] > 0), double, start)[1]


def redoubled(series, frequency, damping, time, stiffness, count):
    """As `doubled`, the time at most 2^count of the longest steps."""
    now = _short(series, frequency, damping, time * 0.5**count)
    for _ in range(count):
        now = twice(stiffness, *now)
    return now


def _short(series, frequency, damping, time):
    """As `doubled`, over a time no longer than a step."""
    step = gains(series, frequency, time)
    free = (1.0 + step.stay, step.move, 1.0 + step.stay - 2.0 * damping * step.move)
    forced = ((step.lift, step.move - frequency * step.lag), (step.lag, frequency * step.lift))
    return free, forced, (step.versed, step.sined)


def twice(stiffness, free, forced, angle):
    (p00, p01, p11), (u, w), (versed, sined) = free, forced, angle
    cosine = 1.0 + versed

    def move(first, second):
        return p00 * first + p01 * second, p11 * second - p01 * pulled(stiffness, first)

    (ux, uv), (wx, wv) = move(*u), move(*w)
    u = (ux + cosine * u[0] - sined * w[0], uv + cosine * u[1] - sined * w[1])
    w = (wx + cosine * w[0] + sined * (u_before := forced[0])[0], wv + cosine * w[1] + sined * u_before[1])
    turned = p01 * pulled(stiffness, p01)
    free = (p00 * p00 - turned, p01 * (p00 + p11), p11 * p11 - turned)
    return free, (u, w), (2.0 * versed * (2.0 + versed), 2.0 * sined * cosine)
