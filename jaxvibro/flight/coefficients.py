"""What a flight needs of a scene, worked out once."""

import math
from enum import Enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene import check
from ..scene.force import Force
from ..scene.force_trace import without_rule
from ..scene.scale import swift
from . import drive, flow
from .event import TERMS, smallest, weights
from .soft_contact import SoftFlow, contact
from .traced_force import is_series_of_root
from .wall import Lane, extent, lane, tail

SIDES = (-1, 1)
TURN_LOW = 2.4492935982947064e-16  # 2 pi less its double


class Stays(Enum):
    """What stays within soft walls are: none, where all walls are rigid; of a spring and a damper on top of the
    oscillator's; or pushed back beside a force of the user's own."""

    NONE = "none"
    SPRING = "spring"
    PUSHED = "pushed"


class Frame(NamedTuple):
    """The oscillator, its drive, its walls, and bounds for the longest step; each number a scalar or one for each lane.

    force A, frequency omega, damping gamma; terms: of the drive, beside A cos(omega t); walls: those that exist, left
    first; period 2 pi / omega and its low part; swift: see `path`; series: of the flow; reach: the longest step (t),
    pace: 1 / reach, weights: reach^k / k!; size: a length of the scene, the walls' distances and the drive's amplitudes
    together, to measure rounding by, `smallest` where these are all 0; curb, slope: abs x^(8) is at most curb + slope
    (abs x^(6) + abs x^(7)) over a step, these at its start; tails, swings: see `wall.tail`, for each wall; rushes:
    bounds on the change of the press on each; gap: the walls are never nearer to each other; contacts: the
    `soft_contact.SoftFlow` within each wall, under a force of the user's own its `Lane` (`pushed_flow`), None for rigid
    ones.

    stiffness and its root are 1, and None, but where they are what a lane feels (`soft_contact.felt`). law: a force of
    the user's own; then damping and swift are 0, and what bounds the linear flow is None.
    """

    force: Float[jax.Array, "..."]
    frequency: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    walls: tuple[Lane, ...]
    period: Float[jax.Array, "..."]
    period_low: Float[jax.Array, "..."]
    swift: Float[jax.Array, "..."]
    series: flow.Series
    reach: Float[jax.Array, "..."]
    pace: Float[jax.Array, "..."]
    weights: tuple[Float[jax.Array, "..."], ...]
    size: Float[jax.Array, "..."]
    curb: Float[jax.Array, "..."]
    slope: Float[jax.Array, "..."]
    tails: tuple[Float[jax.Array, "..."], ...]
    swings: tuple[Float[jax.Array, "..."], ...]
    rushes: tuple[Float[jax.Array, "..."], ...]
    gap: Float[jax.Array, "..."]
    contacts: tuple[SoftFlow | Lane | None, ...] = ()
    stiffness: Float[jax.Array, "..."] | None = None
    root: Float[jax.Array, "..."] | None = None
    law: Force | None = None
    terms: tuple[drive.Term, ...] = ()

    @property
    def stays(self) -> Stays:
        """What its stays within soft walls are: asked for here alone."""
        if all(each is None for each in self.contacts):
            return Stays.NONE
        return Stays.SPRING if self.law is None else Stays.PUSHED


def frame(scene):
    """The `Frame` of a scene."""
    if scene.force is not None:
        return _of_force(scene)
    dtype = scene.dtype
    force, frequency, damping = (jnp.asarray(n, dtype) for n in (scene.amplitude, scene.frequency, scene.damping))
    walls, terms = _walls(scene), drive.terms(scene, frequency, damping)
    rate = flow.rate(frequency, damping)
    for wall in walls:
        rate = jnp.maximum(rate, frequency * (wall.harmonic if wall.swing is not None else 1.0))
    if terms:
        rate = jnp.maximum(rate, frequency * float(drive.fastest(terms)))
    reach = flow.STEP / rate
    # energy of x^(6): abs x^(6), abs x^(7) <= abs x^(6)(0) + abs x^(7)(0) + A omega^6 t, damping only helps
    forcing, slope = drive.largest(terms, force, frequency, 6), jnp.sqrt(1.0 + 4.0 * damping * damping)
    period = 2.0 * jnp.pi / frequency
    bounds = [tail(wall, force, frequency, damping, TERMS, terms) for wall in walls]
    return Frame(
        force=force,
        frequency=frequency,
        damping=damping,
        walls=walls,
        period=period,
        period_low=_remainder(frequency, period) / frequency,
        swift=swift(frequency, damping, force),
        series=flow.series(frequency, damping),
        reach=reach,
        pace=rate / flow.STEP,
        weights=weights(reach),
        size=_size(walls, drive.largest(terms, force, frequency, 0)),
        curb=forcing * (1.0 + slope * reach),
        slope=slope,
        tails=tuple(press for press, _ in bounds),
        swings=tuple(swing for _, swing in bounds),
        rushes=tuple(tail(wall, force, frequency, damping, 1, terms)[0] for wall in walls),
        gap=_gap(walls, force),
        contacts=tuple(contact(wall, force, frequency, terms) for wall in walls),
        terms=terms,
    )


def _of_force(scene):
    """The `Frame` of a scene with a force of the user's own."""
    force, dtype = scene.force, scene.dtype
    for side, wall in scene.walls.items():
        if wall.law is not None:
            _require_series(f"{side}.law", wall.law, dtype)
    amplitude, frequency = (jnp.asarray(number, dtype) for number in (scene.amplitude, scene.frequency))
    walls, terms = _walls(scene), drive.terms(scene, frequency, None)
    fast = max((wall.harmonic for wall in walls if wall.swing is not None), default=1)
    fast = max(fast, drive.fastest(terms))
    period, none = 2.0 * jnp.pi / frequency, jnp.zeros_like(frequency)
    reach = flow.STEP / (frequency * fast)
    return Frame(
        force=amplitude,
        frequency=frequency,
        damping=none,
        walls=walls,
        period=period,
        period_low=_remainder(frequency, period) / frequency,
        swift=none,
        series=None,
        reach=reach,
        pace=1.0 / reach,
        weights=weights(reach),
        size=_size(walls, drive.largest(terms, amplitude, frequency, 0)),
        curb=None,
        slope=None,
        tails=(),
        swings=tuple(tail(wall, none, frequency, none, TERMS)[1] for wall in walls),
        rushes=(),
        gap=_gap(walls, amplitude),
        contacts=tuple(None if wall.restitution is not None else wall for wall in walls),
        law=jax.tree.map(lambda number: jnp.asarray(number, dtype), force),
        terms=terms,
    )


def _require_series(key, law, dtype):
    """Refuse the law of a wall that is no power series in the root of the depth."""
    given = law.function, tuple(law.numbers), np.dtype(dtype)
    unknown = without_rule(*given, 2)
    if unknown:
        told = f"has operations of which no Taylor series is known ({', '.join(unknown)})"
        raise check.SceneError(key, told, law.function)
    if not is_series_of_root(*given):
        raise check.SceneError(key, "must be a power series in the root of the depth", law.function)


def _walls(scene):
    given = zip(SIDES, (scene.left, scene.right), strict=True)
    return tuple(lane(wall, scene, side, scene.dtype) for side, wall in given if wall is not None)


def _size(walls, amplitude):
    """The length scale of a scene, never 0: `smallest` where all walls are at 0 and there is no drive."""
    size = sum((extent(wall) for wall in walls), amplitude)
    return choose(size > 0, size, lax.full_like(size, smallest(size.dtype)))


def _gap(walls, like):
    if len(walls) < 2:
        return jnp.full_like(like, jnp.inf)
    left, right = walls
    return (right.position - left.position) - sum(abs(wall.swing) for wall in walls if wall.swing is not None)


def _remainder(frequency, period):
    """2 pi - frequency period, the product taken exactly (Dekker) and 2 pi beyond its double."""
    product = frequency * period
    error = product_error(frequency, period, product)
    turn = jnp.asarray(2.0 * jnp.pi, period.dtype)
    beyond = TURN_LOW if period.dtype == jnp.float64 else 2.0 * math.pi - float(np.float32(2.0 * math.pi))
    return (turn - product) - error + beyond


def product_error(a, b, product):
    """a b less the product rounded (Dekker)."""
    (high, low), (top, bottom) = _split(a), _split(b)
    return ((high * top - product) + high * bottom + low * top) + low * bottom


def _split(a):
    """a as the sum of two numbers of half its digits (Veltkamp)."""
    scaled = a * (2.0 ** ((jnp.finfo(a.dtype).nmant + 2) // 2) + 1.0)
    high = scaled - (scaled - a)
    return high, a - high


def is_valid(frame):
    """Whether the scene of each lane keeps the rules that `make_scene` checks: (valid, finite)."""
    given = [(term.force, term.cosine) for term in frame.terms]
    numbers = jax.tree.leaves((frame.force, frame.frequency, frame.damping, frame.walls, given))
    finite = jnp.isfinite(frame.force)
    for number in numbers:
        finite &= jnp.isfinite(number)
    valid = (frame.frequency > 0) & (frame.damping >= 0)
    for wall in frame.walls:
        if wall.law is not None:
            continue
        if wall.stiffness is None:
            valid &= (wall.restitution >= 0) & (wall.restitution <= 1)
        else:
            valid &= (wall.stiffness > 0) & (wall.damping >= 0)
    if len(frame.walls) == 2:
        left, right = frame.walls
        valid &= left.position < right.position
    return valid, finite


framed = jax.jit(frame)  # of what is traced time and again for few lanes: once a process for scenes of a kind
