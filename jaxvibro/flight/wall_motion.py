"""A wall along a flight: where it is, how it moves, and the jet of the clearance that the mass keeps to it."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene.push import Push
from ..scene.scene import harden_wall
from . import drive
from .drive import harmonic_phasor


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class WallCoefficients:
    """One wall, its numbers scalars or lanes: x_b = position + swing cos(harmonic omega t + phase).

    sign: -1 for the left wall, +1 for the right; amplitude: None where it stands still; cosine, sine: of its phase;
    restitution: of a rigid wall; stiffness k2, damping gamma2: of a soft one, which has them in its place, or a law.
    """

    position: Float[jax.Array, "..."]
    restitution: Float[jax.Array, "..."] | None
    amplitude: Float[jax.Array, "..."] | None
    cosine: Float[jax.Array, "..."] | None
    sine: Float[jax.Array, "..."] | None
    sign: int = field(metadata={"static": True})
    harmonic: int = field(default=1, metadata={"static": True})
    stiffness: Float[jax.Array, "..."] | None = None
    damping: Float[jax.Array, "..."] | None = None
    law: Push | None = None


def wall_coefficients(wall, scene, sign, dtype):
    """The `WallCoefficients` of a scene's wall."""

    def as_array(value):
        return jnp.asarray(value, dtype)

    position, motion = as_array(wall.position), wall.motion
    if wall.law is not None:
        contact_fields = {"restitution": None, "law": jax.tree.map(as_array, wall.law)}
    elif wall.soft:
        stiffness = as_array(wall.stiffness)
        damping = as_array(scene.damping if wall.damping is None else wall.damping)
        if scene.harder is not None:
            stiffness, damping = harden_wall(stiffness, damping, as_array(scene.harder))
        contact_fields = {"restitution": None, "stiffness": stiffness, "damping": damping}
    else:
        contact_fields = {"restitution": as_array(scene.restitution if wall.restitution is None else wall.restitution)}
    motion_fields = {"amplitude": None, "cosine": None, "sine": None}
    if motion is not None:
        phase = as_array(motion.phase)
        motion_fields = {"amplitude": as_array(motion.amplitude), "cosine": jnp.cos(phase), "sine": jnp.sin(phase)}
        motion_fields["harmonic"] = motion.harmonic
    return WallCoefficients(position, sign=sign, **contact_fields, **motion_fields)


def wall_extent(wall):
    """The largest distance of the wall from the origin, or a little more."""
    return abs(wall.position) if wall.amplitude is None else abs(wall.position) + abs(wall.amplitude)


def wall_jet(wall, frequency, cosine, sine, order):
    """The wall's position and its derivatives to an order, where the drive is at this cosine and sine.

    A derivative that is always zero is None.
    """
    if wall.amplitude is None:
        return [wall.position] + [None] * order
    wall_cosine, wall_sine = harmonic_phasor(wall, cosine, sine)
    wall_rate = frequency * float(wall.harmonic)
    derivs = [wall.amplitude * wall_cosine, -(wall.amplitude * wall_sine) * wall_rate]
    for k in range(2, order + 1):
        derivs.append(derivs[k - 2] * -(wall_rate * wall_rate))
    return [wall.position + derivs[0], *derivs[1:]]


def subtract(a, b):
    """a - b, b being possibly None for zero."""
    return a if b is None else a - b


def contact_force(wall, amplitude, frequency, damping, cosine, sine, order):
    """How hard a mass that rests on the wall is driven along x relative to it, x'' - x_b'', by force cos(omega t), and
    its derivatives.

    Times the wall's sign it is positive while the mass is pressed on.
    """
    wall_derivs = wall_jet(wall, frequency, cosine, sine, order + 2)
    force_derivs = [amplitude * cosine, -(amplitude * sine) * frequency]
    for k in range(2, order + 1):
        force_derivs.append(force_derivs[k - 2] * -(frequency * frequency))
    force_derivs = force_derivs[: order + 1]
    for k in range(order + 1):
        drag_term = None if wall_derivs[k + 1] is None else 2.0 * damping * wall_derivs[k + 1]
        force_derivs[k] = subtract(subtract(subtract(force_derivs[k], wall_derivs[k]), drag_term), wall_derivs[k + 2])
    return force_derivs


def remainder_bounds(wall, amplitude, frequency, damping, order, drive_terms=()):
    """A bound on a derivative of `contact_force`, and of the wall's own position: (number, number); drive_terms: of the
    drive, beside its first."""
    force_bound = abs(amplitude) * frequency**order
    if drive_terms:
        force_bound = force_bound + drive.derivative_bound(drive_terms, frequency, order)
    if wall.amplitude is None:
        return force_bound, jnp.zeros_like(force_bound)
    wall_rate = frequency * float(wall.harmonic)
    wall_bound = abs(wall.amplitude) * wall_rate**order
    return force_bound + wall_bound * (1.0 + 2.0 * damping * wall_rate + wall_rate * wall_rate), wall_bound


def select_by_side(side, walls, values):
    """The value that belongs to the wall on a side (-1, +1): values in the order of the walls; None stands for zero."""
    if len(walls) == 1 or all(value is None for value in values):
        return values[0]
    return choose(side < 0, *(0.0 if value is None else value for value in values))


def select_lists_by_side(side, walls, value_lists):
    """`select_by_side` for each place of some lists, one list a wall."""
    return [select_by_side(side, walls, values) for values in zip(*value_lists, strict=True)]


def wall_jet_on_side(coeffs, side, cosine, sine, order):
    """`wall_jet` of the wall on a side of each lane."""
    return select_lists_by_side(
        side, coeffs.walls, [wall_jet(wall, coeffs.frequency, cosine, sine, order) for wall in coeffs.walls]
    )
