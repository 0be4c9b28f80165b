"""A wall of a scene, and how it moves."""

from dataclasses import dataclass, field

import jax
from jaxtyping import ArrayLike, Real

from .push import Push


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Motion:
    """amplitude cos(harmonic omega t + phase), t being the drive's own: a wall's motion about its mean position, or a
    term of the drive.

    amplitude: length, any finite real number; phase: radians; harmonic: a whole number, static under transformations,
    from 1 on, of the drive from 0 on: 0 with phase 0 is a constant force.
    """

    amplitude: Real[ArrayLike, "..."]
    phase: Real[ArrayLike, "..."] = 0.0
    harmonic: int = field(default=1, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Wall:
    """A wall: its mean position, what it does to the mass, its motion (None stands still).

    law: a `Push`, in place of stiffness and damping; beside a `Force` alone.

    A rigid wall has a restitution (None takes the scene's). A soft one has a stiffness k2 > 0 in its place, and a
    damping gamma2 >= 0 (None takes the scene's): beyond it x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t), until
    x is back at x_b (paper, (39)). Beside a `Force`, which stays beyond it, its damping is its own and comes on top:
    x'' + 2 gamma2 x' + k2 (x - x_b) = force + A cos(omega t).
    """

    position: Real[ArrayLike, "..."]
    restitution: Real[ArrayLike, "..."] | None = None
    stiffness: Real[ArrayLike, "..."] | None = None
    damping: Real[ArrayLike, "..."] | None = None
    motion: Motion | None = None
    law: Push | None = None

    @property
    def soft(self) -> bool:
        """Whether the wall gives way."""
        return self.stiffness is not None or self.law is not None

    @property
    def own(self) -> tuple[str, ...]:
        """The names of the numbers that say what it does."""
        if self.law is not None:
            return tuple(f"law.{name}" for name in self.law.numbers)
        return ("stiffness", "damping") if self.soft else ("restitution",)

    @property
    def taken(self) -> tuple[str, ...]:
        """The names of what it takes from the scene."""
        if self.law is not None:
            return ()
        name = "damping" if self.soft else "restitution"
        return () if getattr(self, name) is not None else (name,)
