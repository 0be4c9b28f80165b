"""[scene]: the table that describes a scene, in a scene file and in all that is saved."""

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
    """A table in which every key has its meaning and no other key may stand."""


class MotionTable(Table, frozen=True):
    """[scene.left.motion], or one of [[scene.drive]]: a `Motion`."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1

    def motion(self):
        """The `Motion` described, not yet checked."""
        return Motion(self.amplitude, self.phase, self.harmonic)


class PushTable(Table, frozen=True):
    """[scene.left.law]: a `Push` with one of our names, and its numbers."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)


class WallTable(Table, frozen=True):
    """[scene.left]: a `Wall`; a rigid one without restitution has the scene's, a soft one without damping too."""

    position: float
    restitution: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motion: MotionTable | None = None
    law: PushTable | None = None

    def wall(self):
        """The `Wall` described, not yet checked."""
        motion = self.motion and self.motion.motion()
        law = self.law and Push(self.law.name, self.law.numbers)
        return Wall(self.position, self.restitution, self.stiffness, self.damping, motion, law)


class ForceTable(Table, frozen=True):
    """[scene.force]: a `Force` with one of our names, and its numbers."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)
    tolerance: float = DEFAULT_TOLERANCE
    solver: str | None = None

    def force(self):
        """The `Force` described, not yet checked."""
        return Force(self.name, self.numbers, self.tolerance, self.solver)


class ScalesTable(Table, frozen=True):
    """[scene.scales]: `Scales`, mass in kg, stiffness in N/m, length in m."""

    mass: float
    stiffness: float
    length: float


class SceneTable(Table, frozen=True, kw_only=True):
    """[scene]: the arguments of `make_scene`; a wall without a table is not there. scales: what its numbers are
    measured in, where that is to be told."""

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
        """The scene described, made by `make_scene`: ArgumentError where it breaks a rule."""
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
    """The `SceneTable` that describes one scene. Raises ArgumentError for a batch, and for a force without a name."""
    if scene.shape:
        raise check.ArgumentError("scene", "only a single scene can be written, not a batch", f"shape {scene.shape}")

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
    """One scene as the TOML of its table. Raises ArgumentError as `make_scene_table`."""
    return msgspec.toml.encode(make_scene_table(scene)).decode()


def scene_toml_or_empty(scene):
    """The same, "" of a scene that has a force without a name."""
    is_named = registered_name(scene.force.function) if scene.force else True
    laws = (wall.law for wall in scene.walls.values() if wall.law)
    return scene_toml(scene) if is_named and all(registered_push_name(law.function) for law in laws) else ""


def _push_table(law):
    if law is None:
        return None
    name = registered_push_name(law.function)
    if name is None:
        rule = f"must be one of ours ({', '.join(NAMED_PUSHES)}) to be written"
        raise check.ArgumentError("law.function", rule, law.function)
    return PushTable(name, {key: float(value) for key, value in law.numbers.items()})


def _force_table(force):
    if force is None:
        return None
    name = registered_name(force.function)
    if name is None:
        rule = f"must be one of ours ({', '.join(NAMED_FORCES)}) to be written"
        raise check.ArgumentError("force.function", rule, force.function)
    solver = force.solver and solver_name(force.solver)
    if force.solver is not None and solver is None:
        rule = "must be one that diffrax makes by its name alone to be written"
        raise check.ArgumentError("force.solver", rule, force.solver)
    numbers = {key: float(value) for key, value in force.numbers.items()}
    return ForceTable(name, numbers, force.tolerance, solver)
