"""The Taylor series of a mass within a soft wall beside a force of the user's own, in a time that runs like its depth.

Depth y = e^2 and dt = 2 e ds make

    de/ds = w,   dw/ds = 2 e a,   dt/ds = 2 e

of y' = w, w' = a: what goes with y^1.5 is e^3, analytic also where the mass enters and leaves, and the stay goes from
e = 0 to e = 0. With e = scale f and w = scale g, the scale being the speed of entering, it is smooth where that is
zero.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, most, stage
from . import traced_force
from .drive import wave
from .series import Series, Square, driven, minus, plus, product, scaled, shifted, times
from .wall import chosen

TINY = 1e10  # times the smallest number: a term as small is none


class Within(NamedTuple):
    """Where a lane is within a wall: y = (scale root)^2, w = scale rate; the drive's cosine and sine."""

    root: Float[jax.Array, "*lanes"]
    rate: Float[jax.Array, "*lanes"]
    scale: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class Terms(NamedTuple):
    """The Taylor coefficients in s, from the constant on, of root, rate and the time since."""

    root: list[Float[jax.Array, "*lanes"]]
    rate: list[Float[jax.Array, "*lanes"]]
    time: list[Float[jax.Array, "*lanes"]]


def coefficients(frame, side, now, order):
    """The `Terms` up to an order of lanes within the wall on a side."""
    root = Series(lambda own, k: times(1.0 / k, rate[k - 1]), now.root)
    rate = Series(lambda own, k: times(2.0 / k, drawn[k - 1]), now.rate)
    time = Series(lambda own, k: times(2.0 / k, depth_root[k - 1]), jnp.zeros_like(now.root))
    depth_root, pace = scaled(now.scale, root), scaled(now.scale, rate)
    pull, push = _acceleration(frame, side, now, Square(depth_root), pace, time)
    drawn = product(root, minus(scaled(side, pull), push))
    return Terms(*([each[k] for k in range(order + 1)] for each in (root, rate, time)))


def motion_in_time(frame, side, now, depth, rate, order):
    """(Derivatives of the depth, of its rate) by time from the constant up to an order; the last counts as a constant.

    Unlike `coefficients` they are right where the depth is 0 or a rounding, where time runs as the square of s. Of
    orders above 1 they are nan at the depth 0 where the law has no such derivative, as one with y^1.5.
    """
    one = jnp.ones_like(depth)
    deep = Series(lambda own, k: times(1.0 / k, fast[k - 1]), depth)
    fast = Series(lambda own, k: times(1.0 / k, drawn[k - 1]), rate)
    time = Series(lambda own, k: None, jnp.zeros_like(depth), one)
    pull, push = _acceleration(frame, side, now, deep, fast, time)
    drawn = minus(scaled(side, pull), push)
    found = []
    for each in (deep, fast):
        terms = [each[k] * float(math.factorial(k)) for k in range(order + 1)]
        found.append([*terms[:-1], lax.stop_gradient(terms[-1])])
    return found


def _acceleration(frame, side, now, depth, pace, time):
    """(the acceleration along x relative to the wall but for the wall's push, the push away from it), `Series`."""
    angle = scaled(frame.frequency, time)
    cosine, _ = _turned(angle, now.cosine, now.sine)
    where, speed, bend = _course(frame, side, now, angle)
    x, v = plus(where, scaled(side, depth)), scaled(side, pace)
    v = v if speed is None else plus(speed, v)
    clock = shifted(stage(_time, frame.frequency, now.cosine, now.sine), time)
    pull = plus(traced_force.along(frame.law, clock, x, v), scaled(frame.force, cosine))
    for term in frame.terms:
        own, _ = _turned(scaled(float(term.harmonic), angle), *wave(term, now.cosine, now.sine))
        pull = plus(pull, scaled(term.force, own))
    return pull if bend is None else minus(pull, bend), _push(frame, side, depth, pace, v)


def _time(frequency, cosine, sine):
    return lax.atan2(sine, cosine) / frequency


def _turned(angle, cosine, sine):
    """(cosine, sine) of what is at these at first and turns by an angle."""
    pair: list[Series] = []
    pair.append(driven(angle, cosine, lambda own: scaled(-1.0, pair[1])))
    pair.append(driven(angle, sine, lambda own: pair[0]))
    return pair


def _course(frame, side, now, angle):
    """Position, velocity, acceleration of the wall on a side; None where no wall moves."""
    walls = frame.walls
    none = jnp.zeros_like(now.root)
    middle = chosen(side, walls, [wall.position + none for wall in walls])
    if all(wall.swing is None for wall in walls):
        return Series(None, middle), None, None
    swing, harmonic, cosine, sine = (
        chosen(side, walls, each) for each in zip(*(_swing(wall, now, none) for wall in walls), strict=True)
    )
    cosine, sine = _turned(scaled(harmonic, angle), cosine, sine)
    rate = frame.frequency * harmonic
    return (
        shifted(middle, scaled(swing, cosine)),
        scaled(-swing * rate, sine),
        scaled(-swing * rate * rate, cosine),
    )


def _swing(wall, now, none):
    """(swing, harmonic, cosine, sine) of a wall's motion."""
    if wall.swing is None:
        return none, none + 1.0, none + 1.0, none
    return wall.swing + none, none + float(wall.harmonic), *wave(wall, now.cosine, now.sine)


def _push(frame, side, depth, pace, v):
    """The push of the wall on a side: its law's, or k2 y + 2 gamma2 v, v the mass's own velocity."""
    soft = [wall for wall in frame.walls if wall.restitution is None]
    kinds = [wall.law and (wall.law.function, tuple(wall.law.numbers)) for wall in soft]
    if len(soft) == 2 and kinds[0] == kinds[1]:
        numbers = [(wall.law, wall.stiffness, wall.damping) for wall in soft]
        law, stiffness, damping = jax.tree.map(partial(choose, side < 0), *numbers)
        soft = [replace(soft[0], law=law, stiffness=stiffness, damping=damping)]
    found = [_of_wall(wall, side, depth, pace, v) for wall in soft]
    if len(found) == 1:
        return found[0]
    left, right = found
    return Series(lambda own, k: _either(side < 0, left[k], right[k]), _either(side < 0, left[0], right[0]))


def _either(first, a, b):
    return None if a is None and b is None else choose(first, 0.0 if a is None else a, 0.0 if b is None else b)


def _of_wall(wall, side, depth, pace, v):
    if wall.law is not None:
        return traced_force.pushed(wall.law, depth, pace)
    return plus(scaled(wall.stiffness, depth), scaled(2.0 * wall.damping * side, v))


def reach(frame, terms, scale):
    """A step in s at which the last terms are tolerated beside the largest of the first, and no angle turns by more
    than 1."""
    return stage(_reach, terms, scale, frame.reach, tolerance=frame.law.tolerance)


def _reach(terms, scale, longest, tolerance):
    tiny = TINY * float(jnp.finfo(scale.dtype).tiny)
    last = len(terms.root) - 1
    fast, bent = (2.0 * lax.abs(scale * each) + tiny for each in (terms.root[0], terms.rate[0]))
    found = lax.min(0.5 * longest / fast, lax.sqrt(longest / bent))
    for each in (terms.root, terms.rate):
        for k in (last - 1, last):
            size = lax.abs(each[k]) + tiny
            near = [lax.log((tolerance * lax.abs(each[j]) + tiny) / size) / float(k - j) for j in range(3)]
            found = lax.min(found, lax.exp(most(most(near[0], near[1]), near[2])))
    return found


def onwards(terms, scaled_span):
    """(root, rate, time) a span of s later."""
    found = []
    for each in terms:
        total = each[-1]
        for term in each[-2::-1]:
            total = total * scaled_span + term
        found.append(total)
    return found


def turned(frame, now, time):
    """(cosine, sine) of the drive a time later, of any sign."""
    angle = frame.frequency * time
    half = lax.sin(0.5 * angle)
    versed, sined = -2.0 * half * half, lax.sin(angle)
    return now.cosine + (now.cosine * versed - now.sine * sined), now.sine + (now.sine * versed + now.cosine * sined)


def chosen_lanes(lanes, new, old):
    """A tree of lanes with those of some replaced."""
    return jax.tree.map(lambda new, old: choose(lanes, new, old), new, old)
