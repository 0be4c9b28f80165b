"""Plain records of a scene, for the references only."""

import math
from typing import NamedTuple


class Motion(NamedTuple):
    """Wall motion amplitude * cos(harmonic * theta + phase) about the wall's position, theta = omega t."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1


class Wall(NamedTuple):
    """A rigid wall: position, restitution R in (0, 1], and its motion or None."""

    position: float
    restitution: float
    motion: Motion | None = None


class Soft(NamedTuple):
    """A soft wall: position x_b, stiffness k >= 0 and damping g >= 0 of the contact, and its motion or None.

    While the mass is beyond it, x'' + 2 g x' + k (x - x_b) + x = A cos(theta): g takes the place of the scene's gamma.
    """

    position: float
    stiffness: float
    damping: float
    motion: Motion | None = None


class Term(NamedTuple):
    """A term of the drive beside A cos(theta): amplitude * cos(harmonic * theta + phase)."""

    amplitude: float
    harmonic: int
    phase: float


class Scene(NamedTuple):
    """x'' + 2 gamma x' + x = A cos(omega t) and further terms, between up to two walls, each a Wall or a Soft."""

    gamma: float
    omega: float
    amplitude: float
    left: Wall | Soft | None = None
    right: Wall | Soft | None = None
    drive: tuple[Term, ...] = ()

    def walls(self):
        """The walls there are, as (side, wall): side -1 left, +1 right."""
        return [(side, wall) for side, wall in ((-1, self.left), (1, self.right)) if wall is not None]


def denominator(gamma, omega):
    """D = (1 - omega^2)^2 + 4 gamma^2 omega^2; the forced amplitude is A / sqrt(D)."""
    return ((1 - omega) * (1 + omega)) ** 2 + (2 * gamma * omega) ** 2


def reach(wall):
    """Largest distance of a wall from 0."""
    return abs(wall.position) + (abs(wall.motion.amplitude) if wall.motion else 0.0)


def static_scale(scene):
    """Largest of the walls' distances, A and the forced amplitude A / sqrt(D), left out where D = 0; of all terms of
    the drive together."""
    terms, forced = [(scene.amplitude, 1), *((each.amplitude, each.harmonic) for each in scene.drive)], 0.0
    for amplitude, harmonic in terms:
        d = denominator(scene.gamma, harmonic * scene.omega)
        forced += abs(amplitude) / math.sqrt(d) if d > 0 else 0.0
    return max([forced, sum(abs(each) for each, _ in terms)] + [reach(wall) for _, wall in scene.walls()])
