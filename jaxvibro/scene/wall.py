"""Define the walls of a scene and their motion."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
from jaxtyping import ArrayLike, Real

from .push import Push


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Motion:
    """Harmonic motion of a wall about the mean position of the wall, or a harmonic term of the drive.

    The motion is ``amplitude cos(harmonic omega t + phase)`` with the frequency omega and the time t of the drive.

    Parameters
    ----------
    amplitude : array_like
        Amplitude, in lengths of the scene. Any finite real number.
    phase : array_like, optional
        Phase, in rad.
    harmonic : int, optional
        Harmonic of the drive frequency, static under transformations. At least 1 for a wall and at least 0 for the
        drive; harmonic 0 with phase 0 is a constant force.

    Examples
    --------
    >>> moving = jv.Wall(1.0, motion=jv.Motion(amplitude=0.1, phase=0.5))
    >>> scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls=(-1.0, moving))
    >>> round(float(scene.parameter("right.motion.amplitude")), 6)
    0.1
    """

    amplitude: Real[ArrayLike, "..."]
    phase: Real[ArrayLike, "..."] = 0.0
    harmonic: int = field(default=1, metadata={"static": True})


class ContactKind(NamedTuple):
    """Kind of the contact with a wall.

    Attributes
    ----------
    name : str
        Name of the kind.
    is_soft : bool
        True if the mass moves inside the wall.
    parameters : tuple of str
        Names of the parameters of the wall, except for those of a contact law.
    inherited : tuple of str
        Parameters that the wall takes from the scene if it has none of its own.
    refused : tuple of str
        Fields that must be None.
    refusal : str
        Rule for these fields, for an error message.
    """

    name: str
    is_soft: bool
    parameters: tuple[str, ...]
    inherited: tuple[str, ...]
    refused: tuple[str, ...]
    refusal: str


RIGID_CONTACT = ContactKind(
    "rigid", False, ("restitution",), ("restitution",), ("damping",), "must not be given for a wall without stiffness"
)
LINEAR_CONTACT = ContactKind(
    "spring and damper",
    True,
    ("stiffness", "damping"),
    ("damping",),
    ("restitution",),
    "must not be given for a wall with stiffness",
)
LAW_CONTACT = ContactKind(
    "contact law",
    True,
    (),
    (),
    ("restitution", "stiffness", "damping"),
    "must not be given for a wall with a contact law",
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Wall:
    """Wall of a scene, rigid or soft.

    Parameters
    ----------
    position : array_like
        Mean position, in lengths of the scene.
    restitution : array_like, optional
        Coefficient of restitution R of a rigid wall. None selects the restitution of the scene.
    stiffness : array_like, optional
        Stiffness k2 > 0 of a soft wall, in units of the stiffness of the spring. It replaces the restitution.
    damping : array_like, optional
        Damping gamma2 >= 0 of a soft wall. None selects the damping of the scene.
    motion : Motion, optional
        Motion of the wall. None is a wall at rest.
    law : Push, optional
        Contact law of a soft wall in place of stiffness and damping. Needs a scene with a `Force`.

    Notes
    -----
    Inside a soft wall at x_b the mass obeys ``x'' + 2 gamma2 x' + k2 (x - x_b) + x = A cos(omega t)`` until x is back
    at x_b (paper, (39)). In a scene with a `Force`, this force also acts inside the wall. The damping of the wall must
    be given and is added: ``x'' + 2 gamma2 x' + k2 (x - x_b) = force + A cos(omega t)``.

    Examples
    --------
    >>> walls = jv.Wall(-1.0, restitution=0.6), jv.Wall(1.0, stiffness=400.0, damping=3.0)
    >>> scene = jv.make_scene(2.0, 2.1, 0.05, walls=walls)
    >>> scene.soft_sides, scene.right.own
    (('right',), ('stiffness', 'damping'))
    """

    position: Real[ArrayLike, "..."]
    restitution: Real[ArrayLike, "..."] | None = None
    stiffness: Real[ArrayLike, "..."] | None = None
    damping: Real[ArrayLike, "..."] | None = None
    motion: Motion | None = None
    law: Push | None = None

    @property
    def contact_kind(self) -> ContactKind:
        """Kind of the contact: rigid, linear (spring and damper), or a contact law."""
        if self.law is not None:
            return LAW_CONTACT
        return RIGID_CONTACT if self.stiffness is None else LINEAR_CONTACT

    @property
    def soft(self) -> bool:
        """True if the wall is soft."""
        return self.contact_kind.is_soft

    @property
    def own(self) -> tuple[str, ...]:
        """Names of the parameters of the contact: restitution, stiffness and damping, or those of the law."""
        law_parameters = getattr(self.law, "numbers", ())
        return (*self.contact_kind.parameters, *(f"law.{name}" for name in law_parameters))

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the parameters that the wall takes from the scene."""
        return tuple(name for name in self.contact_kind.inherited if getattr(self, name) is None)
