"""The next event of a flight, certified: a step that cannot pass a wall, or the time at which it is met.

The progress towards a wall, G = minus the clearance, is its Taylor polynomial g0 + g1 t + ... + g6 t^6 and a rest that
is at most `rest` t^6 over the step. A cubic above G gives a step with no contact; where G provably rises up to the root
of the polynomial, the root is the first contact. After an impact G has the root t = 0: it is divided out. A mass that
rests on a wall waits for the press on it to end: then G is minus the press.
"""

import math

import jax.numpy as jnp
from jax import lax

from .lanes import choose, least, most, negative, positive

TERMS = 7  # of the polynomial
SHORTER = 0.99  # a horizon at which a quadratic still bends away in spite of rounding
MARGIN = 1.05  # the root must be the only one, and the other wall out of reach, this much further


def landing(dtype):
    """How near its event, in units of the flight's own time, a step must end for the event's correction to be exact."""
    return float(jnp.finfo(dtype).eps) ** (1 / 3)


def progress(sign, jet, path, low, bound, reach, on):
    """The polynomial of G and its rest for one wall: jet of x, the wall's path, both of 7 derivatives at least.

    low: the low part of x; bound: on the seventh derivative of x - x_b; on: the lane rests on or leaves this wall.
    """
    clear = [(jet[0] - path[0]) + low]
    clear += [jet[k] if path[k] is None else jet[k] - path[k] for k in range(1, TERMS)]
    g = [clear[k] * (sign / math.factorial(k)) for k in range(TERMS)]
    bound = bound * (1.0 / math.factorial(7))
    g = [choose(on, after, before) for before, after in zip(g, [*g[1:], lax.full_like(low, 0.0)], strict=True)]
    return [negative(g[0]), *g[1:]], choose(on, bound, bound * reach)


def cubic(g, rest, reach):
    """K >= 0 with G <= g0 + g1 t + g2 t^2 + K t^3 for 0 <= t <= reach."""
    total = rest + positive(g[6])
    for k in (5, 4):
        total = total * reach + positive(g[k])
    return positive(total * reach + g[3])


def free_step(g, bend, reach):
    """A step without contact, from one division: G <= g0 + g1 t + (g2 + bend reach) t^2."""
    clear, steep = -g[0], g[2] + bend * reach
    most_steep = positive(steep)
    rise = g[1] + reach * most_steep
    ahead = g[1] >= 0
    never = (clear >= reach * rise) | ((steep < 0) & (g[1] * g[1] <= -4.0 * steep * clear))
    time = choose(ahead, clear, -g[1]) / choose(ahead, rise, most_steep)
    return choose(never, reach, least(time, reach))


def _quadratic(clear, slope, bend):
    """(time, exists): the first positive root of slope t + bend t^2 = clear, without cancellation."""
    ahead = slope > 0
    inside = slope * slope + 4.0 * bend * clear
    sum_ = lax.abs(slope) + lax.sqrt(positive(inside))
    time = choose(ahead, 2.0 * clear, sum_) / choose(ahead, sum_, 2.0 * bend)
    return time, (inside >= 0) & (ahead | (bend > 0))


def sure_step(g, bend, reach, floor):
    """(step without contact, root of the quadratic part, whether there is one): two roots on ever shorter horizons."""
    time, exists = _quadratic(-g[0], g[1], g[2])
    ahead = g[1] > 0
    turn = choose(ahead, g[1], -g[2]) / choose(ahead, -g[2], bend)
    horizon = choose(exists, 2.0 * time, choose(g[2] < 0, SHORTER * turn, 0.0))
    horizon = least(horizon, reach)
    steep = g[2] + bend * horizon
    bound, meets = _quadratic(-g[0], g[1], steep)
    return most(choose(meets, least(horizon, bound), horizon), floor), time, exists


def horner(g, time):
    """The polynomial with these coefficients, from the constant on, and its slope at a time."""
    value, slope = g[-1], lax.full_like(time, 0.0)
    for coefficient in g[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def root(g, rest, reach, time, exists):
    """(time, error bound, certain) of the first contact: from the quadratic's root, Halley's step and then Newton's.

    Certain: G rises at a fifth of its slope at least up to MARGIN times the root, so that there is no other before.
    """
    value, slope = horner(g, time)
    bend = horner([k * g[k] for k in range(1, TERMS)], time)[1]
    time = time - value * slope / (slope * slope - 0.5 * value * bend)
    value, slope = horner(g, time)
    step = value / slope
    time = time - step
    far = time * MARGIN
    rise = negative(6.0 * g[6]) - 7.0 * rest
    for k in (5, 4, 3, 2):
        rise = rise * far + negative(float(k) * g[k])
    rise = rise * far + g[1]
    cube = time * time * time
    error = (rest * (cube * cube) + 2.0 * lax.abs(bend) * (step * step)) / lax.abs(rise)
    certain = exists & (g[1] > 0) & (far <= reach) & (rise > 0.2 * g[1]) & (time >= 0)
    return time, error, certain


def rounding(dtype):
    """Half a unit in the last place of 1."""
    return float(jnp.finfo(dtype).eps) / 2
