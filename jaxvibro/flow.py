"""Free flight, x'' + 2 gamma x' + x = A cos(omega t) (paper, (3)): exact, with no division by D or sqrt(1 - gamma^2).

Over a step that is short beside the fastest of omega, 1 and 2 gamma the flow is its own Taylor series, which needs
products alone and so is right at resonance, at critical damping and beyond. Any longer time is such a step doubled.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from .lanes import choose

STEP = 1.0  # longest step, in units of 1 / rate
ORDER = 18  # STEP^19 / 19! < 1e-17
DOUBLINGS = 24


def rate(frequency, damping):
    """An upper bound, at least 1, of how fast the drive and the free oscillation turn or decay, in radians over t."""
    fast = choose(frequency > 1.0, frequency, 1.0)
    return choose(2.0 * damping > fast, 2.0 * damping, fast)


def jet(force, frequency, damping, x, v, cosine, sine, order):
    """The derivatives x, x', ..., x^(order) where the drive is at this cosine and sine, from the equation of motion."""
    drive = [force * cosine, -(force * sine) * frequency]
    square, drag = -(frequency * frequency), -2.0 * damping
    found = [x, v]
    for k in range(order - 1):
        if k > 1:
            drive.append(drive[k - 2] * square)
        found.append(drive[k] + (drag * found[k + 1] - found[k]))
    return found


def extend(frequency, damping, drive, jet):
    """The next two derivatives of the drive's force and of x from the last two of each: (drive, jet)."""
    square, drag = -(frequency * frequency), -2.0 * damping
    third = drive[0] + (drag * jet[1] - jet[0])
    return (drive[0] * square, drive[1] * square), (third, drive[1] + (drag * third - jet[1]))


def shift(series, time):
    """What the function with these derivatives gains over a time: Horner's rule, the constant term left out."""
    total = series[-1]
    for k in range(len(series) - 2, 0, -1):
        total = series[k] + total * (time * (1.0 / (k + 1)))
    return total * time


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


def fly(scene, state, time):
    """The state after a free flight of a given length: walls are not looked at.

    scene: amplitude, frequency and damping are used; state: x, v, phase; time >= 0, in t. All broadcast together.
    Returns (x, v). Error below 1e-13 (1 + t)^2 (abs x + abs v + A) over damping [0, 5] and frequency [0.05, 20].
    """
    values = (scene.amplitude, scene.frequency, scene.damping, state.x, state.v, state.phase, time)
    values = jnp.broadcast_arrays(*(jnp.asarray(value, scene.dtype) for value in values))
    force, frequency, damping, x, v, phase, time = values
    free, forced = _doubled(frequency, damping, time)
    (p00, p01, p11), (in_phase, in_quadrature) = free, forced
    cosine, sine = force * jnp.cos(phase), force * jnp.sin(phase)
    moved = p00 * x + p01 * v + (cosine * in_phase[0] - sine * in_quadrature[0])
    return moved, p11 * v - p01 * x + (cosine * in_phase[1] - sine * in_quadrature[1])


def _doubled(frequency, damping, time):
    """The free flow's matrix ((p00, p01), (-p01, p11)), and the responses from rest to cos and sin of omega t."""
    turns = time * rate(frequency, damping) / STEP
    count = jnp.ceil(jnp.log2(jnp.maximum(lax.stop_gradient(turns), 1.0)))
    step = time * jnp.exp2(-count)
    one, none = jnp.ones_like(step), jnp.zeros_like(step)
    series = partial(jet, frequency=frequency, damping=damping, order=ORDER)
    p01, v01 = _advance(series(none, x=none, v=one, cosine=none, sine=none), none, one, step)
    free = (v01 + 2.0 * damping * p01, p01, v01)
    forced = tuple(
        _advance(series(one, x=none, v=none, cosine=c, sine=s), none, none, step)
        for c, s in ((one, none), (none, -one))
    )
    angle = frequency * step
    carry = (free, forced, (versine(angle), sinus(angle)))

    def double(k, carry):
        return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), _double(*carry), carry)

    free, forced, _ = lax.fori_loop(0, DOUBLINGS, double, carry)
    return free, forced


def _advance(series, x, v, step):
    return x + shift(series, step), v + shift(series[1:], step)


def _double(free, forced, angle):
    (p00, p01, p11), (u, w), (versed, sined) = free, forced, angle
    cosine = 1.0 + versed

    def move(first, second):
        return p00 * first + p01 * second, p11 * second - p01 * first

    (ux, uv), (wx, wv) = move(*u), move(*w)
    u = (ux + cosine * u[0] - sined * w[0], uv + cosine * u[1] - sined * w[1])
    w = (wx + cosine * w[0] + sined * (u_before := forced[0])[0], wv + cosine * w[1] + sined * u_before[1])
    free = (p00 * p00 - p01 * p01, p01 * (p00 + p11), p11 * p11 - p01 * p01)
    return free, (u, w), (2.0 * versed * (2.0 + versed), 2.0 * sined * cosine)
