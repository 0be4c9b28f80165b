"""Compute the motion of a wall along a flight, and the contact force on a mass that sticks to it."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..scene.push import Push
from ..scene.scene import SIDES
from . import further_drive_terms
from .further_drive_terms import harmonic_derivatives, harmonic_phasor


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class WallCoefficients:
    """Coefficients of a wall: x_b = position + amplitude cos(harmonic omega t + phase).

    Numbers are scalars or lanes.

    Attributes
    ----------
    position : array
        Mean position.
    restitution : array or None
        Coefficient of restitution. None for a soft wall.
    amplitude : array or None
        Amplitude of the motion. None for a fixed wall.
    cosine : array or None
        Cosine of the phase.
    sine : array or None
        Sine of the phase.
    sign : int
        -1 for the left wall, 1 for the right wall.
    harmonic : int
        Multiple of the drive frequency.
    stiffness : array or None
        Stiffness k2 of a soft wall.
    damping : array or None
        Damping gamma2 of a soft wall.
    law : Push or None
        Force law of a soft wall, in place of stiffness and damping.
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


def wall_coefficients(scene, side, contact):
    """Return the `WallCoefficients` of a scene's wall, whose contact is a `protocols.Contact`."""

    def as_array(value):
        return jnp.asarray(value, scene.dtype)

    wall, sign = getattr(scene, side), 2 * SIDES.index(side) - 1
    position, motion = as_array(wall.position), wall.motion
    motion_fields = {"amplitude": None, "cosine": None, "sine": None}
    if motion is not None:
        phase = as_array(motion.phase)
        motion_fields = {"amplitude": as_array(motion.amplitude), "cosine": jnp.cos(phase), "sine": jnp.sin(phase)}
        motion_fields["harmonic"] = motion.harmonic
    return WallCoefficients(position, sign=sign, **contact.wall_fields(scene, side, as_array), **motion_fields)


def max_wall_distance(wall):
    """Return an upper bound on the distance of the wall from the origin."""
    return abs(wall.position) if wall.amplitude is None else abs(wall.position) + abs(wall.amplitude)


def wall_jet(wall, frequency, cosine, sine, order):
    """Compute the position of a wall and its derivatives.

    Parameters
    ----------
    wall : WallCoefficients
        Coefficients of the wall.
    frequency : array
        Drive frequency.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    order : int
        Order of the last derivative.

    Returns
    -------
    list of array or None
        Position and its derivatives. None for a derivative that is always zero.
    """
    if wall.amplitude is None:
        return [wall.position] + [None] * order
    wall_cosine, wall_sine = harmonic_phasor(wall, cosine, sine)
    wall_frequency = frequency * float(wall.harmonic)
    wall_derivs = harmonic_derivatives(wall.amplitude * wall_cosine, wall.amplitude * wall_sine, wall_frequency, order)
    return [wall.position + wall_derivs[0], *wall_derivs[1:]]


def subtract_optional(minuend, subtrahend):
    """Return a - b, where None stands for zero.

    Parameters
    ----------
    minuend : array or None
        Minuend.
    subtrahend : array or None
        Subtrahend.

    Returns
    -------
    array or None
        Difference. None if both are None.
    """
    if subtrahend is None:
        return minuend
    return -subtrahend if minuend is None else minuend - subtrahend


def contact_force(wall, amplitude, frequency, damping, cosine, sine, order):
    """Return the force x'' - x_b'' on a sticking mass relative to the wall, and its derivatives.

    The drive is amplitude cos(omega t). The force times the sign of the wall is positive while the mass is pressed on
    the wall.
    """
    drive_derivs = harmonic_derivatives(amplitude * cosine, amplitude * sine, frequency, order)
    return subtract_wall_motion(drive_derivs, wall, frequency, damping, cosine, sine)


def subtract_wall_motion(force_derivs, wall, frequency, damping, cosine, sine):
    """Subtract x_b + 2 gamma x_b' + x_b'' and its derivatives from a force and its derivatives.

    x_b is the position of the wall. None in `force_derivs` and in the result stands for zero.
    """
    wall_derivs = wall_jet(wall, frequency, cosine, sine, len(force_derivs) + 1)
    relative_force_derivs = []
    for k, force_deriv in enumerate(force_derivs):
        drag_term = None if wall_derivs[k + 1] is None else 2.0 * damping * wall_derivs[k + 1]
        force_deriv = subtract_optional(subtract_optional(force_deriv, wall_derivs[k]), drag_term)
        relative_force_derivs.append(subtract_optional(force_deriv, wall_derivs[k + 2]))
    return relative_force_derivs


def wall_derivative_bounds(wall, amplitude, frequency, damping, order, drive_terms=()):
    """Return bounds on the derivatives of given order of `contact_force` and of the position of the wall.

    `drive_terms` are the further terms of the drive.
    """
    force_deriv_bound = abs(amplitude) * frequency**order
    if drive_terms:
        force_deriv_bound = force_deriv_bound + further_drive_terms.terms_derivative_bound(
            drive_terms, frequency, order
        )
    if wall.amplitude is None:
        return force_deriv_bound, jnp.zeros_like(force_deriv_bound)
    wall_frequency = frequency * float(wall.harmonic)
    position_deriv_bound = abs(wall.amplitude) * wall_frequency**order
    return force_deriv_bound + position_deriv_bound * (
        1.0 + 2.0 * damping * wall_frequency + wall_frequency * wall_frequency
    ), position_deriv_bound


def select_by_side(side, walls, values_by_wall):
    """Select the value of the wall on a side.

    Parameters
    ----------
    side : array
        Side of the wall, -1 or 1.
    walls : sequence of WallCoefficients
        Walls, left first.
    values_by_wall : sequence of array or None
        Value of each wall. None stands for zero.

    Returns
    -------
    array or None
        Value of the wall on the side of each lane. None if all values are None.
    """
    if len(walls) == 1 or all(wall_value is None for wall_value in values_by_wall):
        return values_by_wall[0]
    return choose(side < 0, *(0.0 if wall_value is None else wall_value for wall_value in values_by_wall))


def select_lists_by_side(side, walls, lists_by_wall):
    """Select the list of the wall on a side, entry by entry.

    Parameters
    ----------
    side : array
        Side of the wall, -1 or 1.
    walls : sequence of WallCoefficients
        Walls, left first.
    lists_by_wall : sequence of list
        List of each wall.

    Returns
    -------
    list of array or None
        Entries selected by `select_by_side`.
    """
    return [select_by_side(side, walls, values_by_wall) for values_by_wall in zip(*lists_by_wall, strict=True)]


def wall_jet_on_side(coeffs, side, cosine, sine, order):
    """Compute the position of the wall on a side and its derivatives.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    order : int
        Order of the last derivative.

    Returns
    -------
    list of array or None
        Position and its derivatives. None for a derivative that is always zero.
    """
    return select_lists_by_side(
        side, coeffs.walls, [wall_jet(wall, coeffs.frequency, cosine, sine, order) for wall in coeffs.walls]
    )
