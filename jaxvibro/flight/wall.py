"""A wall along a flight: where it is, how it moves, and the jet of the clearance that the mass keeps to it."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene.push import Push
from ..scene.scene import hardened
from . import drive
from .drive import wave


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Lane:
    """One wall, its numbers scalars or lanes: x_b = position + swing cos(harmonic omega t + phase).

    sign: -1 for the left wall, +1 for the right; swing: None where it stands still; cosine, sine: of its phase;
    restitution: of a rigid wall; stiffness k2, damping gamma2: of a soft one, which has them in its place, or a law.
    """

    position: Float[jax.Array, "..."]
    restitution: Float[jax.Array, "..."] | None
    swing: Float[jax.Array, "..."] | None
    cosine: Float[jax.Array, "..."] | None
    sine: Float[jax.Array, "..."] | None
    sign: int = field(metadata={"static": True})
    harmonic: int = field(default=1, metadata={"static": True})
    stiffness: Float[jax.Array, "..."] | None = None
    damping: Float[jax.Array, "..."] | None = None
    law: Push | None = None


def lane(wall, scene, sign, dtype):
    """The `Lane` of a scene's wall."""

    def number(value):
        return jnp.asarray(value, dtype)

    position, motion = number(wall.position), wall.motion
    if wall.law is not None:
        own = {"restitution": None, "law": jax.tree.map(number, wall.law)}
    elif wall.soft:
        stiffness = number(wall.stiffness)
        damping = number(scene.damping if wall.damping is None else wall.damping)
        if scene.harder is not None:
            stiffness, damping = hardened(stiffness, damping, number(scene.harder))
        own = {"restitution": None, "stiffness": stiffness, "damping": damping}
    else:
        own = {"restitution": number(scene.restitution if wall.restitution is None else wall.restitution)}
    moves = {"swing": None, "cosine": None, "sine": None}
    if motion is not None:
        phase = number(motion.phase)
        moves = {"swing": number(motion.amplitude), "cosine": jnp.cos(phase), "sine": jnp.sin(phase)}
        moves["harmonic"] = motion.harmonic
    return Lane(position, sign=sign, **own, **moves)


def extent(wall):
    """The largest distance of the wall from the origin, or a little more."""
    return abs(wall.position) if wall.swing is None else abs(wall.position) + abs(wall.swing)


def course(wall, frequency, cosine, sine, order):
    """The wall's position and its derivatives to an order, where the drive is at this cosine and sine.

    A derivative that is always zero is None.
    """
    if wall.swing is None:
        return [wall.position] + [None] * order
    c, s = wave(wall, cosine, sine)
    rate = frequency * float(wall.harmonic)
    found = [wall.swing * c, -(wall.swing * s) * rate]
    for k in range(2, order + 1):
        found.append(found[k - 2] * -(rate * rate))
    return [wall.position + found[0], *found[1:]]


def less(a, b):
    """a - b, b being possibly None for zero."""
    return a if b is None else a - b


def press(wall, force, frequency, damping, cosine, sine, order):
    """How hard a mass that rests on the wall is driven along x relative to it, x'' - x_b'', by force cos(omega t), and
    its derivatives.

    Times the wall's sign it is positive while the mass is pressed on.
    """
    path = course(wall, frequency, cosine, sine, order + 2)
    found = [force * cosine, -(force * sine) * frequency]
    for k in range(2, order + 1):
        found.append(found[k - 2] * -(frequency * frequency))
    found = found[: order + 1]
    for k in range(order + 1):
        drag = None if path[k + 1] is None else 2.0 * damping * path[k + 1]
        found[k] = less(less(less(found[k], path[k]), drag), path[k + 2])
    return found


def tail(wall, force, frequency, damping, order, terms=()):
    """A bound on a derivative of `press`, and of the wall's own position: (number, number); terms: of the drive, beside
    its first."""
    bound = abs(force) * frequency**order
    if terms:
        bound = bound + drive.bound(terms, frequency, order)
    if wall.swing is None:
        return bound, jnp.zeros_like(bound)
    rate = frequency * float(wall.harmonic)
    own = abs(wall.swing) * rate**order
    return bound + own * (1.0 + 2.0 * damping * rate + rate * rate), own


def chosen(side, walls, values):
    """The value that belongs to the wall on a side (-1, +1): values in the order of the walls; None stands for zero."""
    if len(walls) == 1 or all(value is None for value in values):
        return values[0]
    return choose(side < 0, *(0.0 if value is None else value for value in values))


def picked(side, walls, lists):
    """`chosen` for each place of some lists, one list a wall."""
    return [chosen(side, walls, values) for values in zip(*lists, strict=True)]


def course_on(frame, side, cosine, sine, order):
    """`course` of the wall on a side of each lane."""
    return picked(side, frame.walls, [course(wall, frame.frequency, cosine, sine, order) for wall in frame.walls])
