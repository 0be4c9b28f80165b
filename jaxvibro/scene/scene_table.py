"""Define the table [scene] that describes a scene, in a scene file and in all saved data."""

from dataclasses import replace

import msgspec
from msgspec import Struct, field

from . import check
from .force import DEFAULT_TOLERANCE, Force
from .force_rules import solver_name
from .named_forces import NAMED_FORCES, registered_name
from .push import NAMED_PUSHES, Push, registered_push_name
from .scales import Scales
from .scene import make_scene
from .wall import Motion, Wall

NUMBER_KEYS = ("amplitude", "frequency", "damping", "restitution")


class Table(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Table without unknown keys."""


class MotionTable(Table, frozen=True):
    """Table [scene.left.motion], or one of [[scene.drive]]: a `Motion`."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1

    def motion(self):
        """Return the `Motion`, not yet checked."""
        return Motion(self.amplitude, self.phase, self.harmonic)


class PushTable(Table, frozen=True):
    """Table [scene.left.law]: a predefined `Push` by name, and its parameters."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)


class WallTable(Table, frozen=True):
    """Table [scene.left]: a `Wall`, which takes a missing restitution or damping from the scene."""

    position: float
    restitution: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motion: MotionTable | None = None
    law: PushTable | None = None

    def wall(self):
        """Return the `Wall`, not yet checked."""
        motion = self.motion and self.motion.motion()
        law = self.law and Push(self.law.name, self.law.numbers)
        return Wall(self.position, self.restitution, self.stiffness, self.damping, motion, law)


class ForceTable(Table, frozen=True):
    """Table [scene.force]: a predefined `Force` by name, and its parameters."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)
    tolerance: float = DEFAULT_TOLERANCE
    solver: str | None = None

    def force(self):
        """Return the `Force`, not yet checked."""
        return Force(self.name, self.numbers, self.tolerance, self.solver)


class ScalesTable(Table, frozen=True):
    """Table [scene.scales]: `Scales` with mass in kg, stiffness in N/m and length in m."""

    mass: float
    stiffness: float
    length: float


class SceneTable(Table, frozen=True, kw_only=True):
    """Table [scene]: the arguments of `make_scene` and the optional `Scales`; a side without a table has no wall."""

    amplitude: float
    frequency: float
    damping: float | None = None
    restitution: float | None = None
    left: WallTable | None = None
    right: WallTable | None = None
    force: ForceTable | None = None
    drive: list[MotionTable] = field(default_factory=list)
    scales: ScalesTable | None = None

    def make(self, dtype=None):
        """Make the scene of the table.

        Parameters
        ----------
        dtype : dtype, optional
            Floating-point type, as in `make_scene`.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        ArgumentError
            If it breaks a rule.
        """
        walls = tuple(table and table.wall() for table in (self.left, self.right))
        force = self.force and self.force.force()
        drive = [term.motion() for term in self.drive]
        scene = make_scene(self.amplitude, self.frequency, self.damping, self.restitution, walls, dtype, force, drive)
        return replace(scene, scales=self.scales and _make_scales(self.scales))


def _make_scales(table):
    try:
        return Scales(table.mass, table.stiffness, table.length)
    except check.ArgumentError as error:
        raise check.SceneError(f"scales.{error.key}", error.rule, error.value) from None


def make_scene_table(scene):
    """Return the table of a single scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    SceneTable
        Its table.

    Raises
    ------
    ArgumentError
        If the scene is a batch, or its force or a contact law is not predefined.
    """
    if scene.shape:
        raise check.ArgumentError("scene", "must be a single scene to be saved, not a batch", f"shape {scene.shape}")

    def motion_table(motion):
        return MotionTable(float(motion.amplitude), float(motion.phase), motion.harmonic)

    def wall_table(wall):
        if wall is None:
            return None
        motion = wall.motion and motion_table(wall.motion)
        numbers = {name: getattr(wall, name) for name in ("restitution", "stiffness", "damping")}
        numbers = {name: float(value) for name, value in numbers.items() if value is not None}
        return WallTable(position=float(wall.position), **numbers, motion=motion, law=_push_table(wall.law))

    numbers = {key: float(scene.parameter(key)) for key in NUMBER_KEYS if key in scene.names}
    wall_tables = {"left": wall_table(scene.left), "right": wall_table(scene.right)}
    scales = scene.scales and ScalesTable(**scene.scales.numbers)
    drive = [motion_table(term) for term in scene.drive]
    return SceneTable(**numbers, **wall_tables, force=_force_table(scene.force), drive=drive, scales=scales)


def scene_toml(scene):
    """Return the TOML text of the table of a single scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    str
        The text.

    Raises
    ------
    ArgumentError
        If the scene is a batch, or its force or a contact law is not predefined.
    """
    return msgspec.toml.encode(make_scene_table(scene)).decode()


def scene_toml_or_empty(scene):
    """Return the TOML text of the table of a single scene, or "" if its force or a contact law is not predefined.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    str
        The text.
    """
    is_named = registered_name(scene.force.function) if scene.force else True
    laws = (wall.law for wall in scene.walls.values() if wall.law)
    return scene_toml(scene) if is_named and all(registered_push_name(law.function) for law in laws) else ""


def _push_table(law):
    if law is None:
        return None
    name = registered_push_name(law.function)
    if name is None:
        rule = f"must be predefined ({', '.join(NAMED_PUSHES)}) to be saved"
        raise check.ArgumentError("law.function", rule, law.function)
    return PushTable(name, {key: float(value) for key, value in law.numbers.items()})


def _force_table(force):
    if force is None:
        return None
    name = registered_name(force.function)
    if name is None:
        rule = f"must be predefined ({', '.join(NAMED_FORCES)}) to be saved"
        raise check.ArgumentError("force.function", rule, force.function)
    solver = force.solver and solver_name(force.solver)
    if force.solver is not None and solver is None:
        rule = "must be a solver that diffrax makes from its name alone to be saved"
        raise check.ArgumentError("force.solver", rule, force.solver)
    numbers = {key: float(value) for key, value in force.numbers.items()}
    return ForceTable(name, numbers, force.tolerance, solver)
