"""[scene]: the table that describes a scene, in a scene file and in all that is saved."""

from dataclasses import replace

import msgspec
from msgspec import Struct, field

from . import check
from .force import TOLERANCE, Force
from .force_rules import solver_name
from .named_forces import NAMED, name_of
from .push import NAMED_PUSHES, Push, name_of_push
from .scales import Scales
from .scene import make_scene
from .wall import Motion, Wall

PLAIN = ("amplitude", "frequency", "damping", "restitution")


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
    tolerance: float = TOLERANCE
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
        drive = [each.motion() for each in self.drive]
        scene = make_scene(self.amplitude, self.frequency, self.damping, self.restitution, walls, dtype, force, drive)
        return replace(scene, scales=self.scales and _scales(self.scales))


def _scales(table):
    try:
        return Scales(table.mass, table.stiffness, table.length)
    except check.ArgumentError as error:
        raise check.SceneError(f"scales.{error.key}", error.rule, error.value) from None


def table_of(scene):
    """The `SceneTable` that describes one scene. Raises ArgumentError for a batch, and for a force without a name."""
    if scene.shape:
        raise check.ArgumentError("scene", "only a single scene can be written, not a batch", f"shape {scene.shape}")

    def wave(motion):
        return MotionTable(float(motion.amplitude), float(motion.phase), motion.harmonic)

    def table(wall):
        if wall is None:
            return None
        moving = wall.motion and wave(wall.motion)
        own = {name: getattr(wall, name) for name in ("restitution", "stiffness", "damping")}
        own = {name: float(value) for name, value in own.items() if value is not None}
        return WallTable(position=float(wall.position), **own, motion=moving, law=_push_table(wall.law))

    plain = {key: float(scene.parameter(key)) for key in PLAIN if key in scene.names}
    sides = {"left": table(scene.left), "right": table(scene.right)}
    scales = scene.scales and ScalesTable(**scene.scales.numbers)
    drive = [wave(term) for term in scene.drive]
    return SceneTable(**plain, **sides, force=_force_table(scene.force), drive=drive, scales=scales)


def scene_text(scene):
    """One scene as the TOML of its table. Raises ArgumentError as `table_of`."""
    return msgspec.toml.encode(table_of(scene)).decode()


def scene_text_or_none(scene):
    """The same, "" of a scene that has a force without a name."""
    named = name_of(scene.force.function) if scene.force else True
    laws = (wall.law for wall in scene.walls.values() if wall.law)
    return scene_text(scene) if named and all(name_of_push(law.function) for law in laws) else ""


def _push_table(law):
    if law is None:
        return None
    name = name_of_push(law.function)
    if name is None:
        rule = f"must be one of ours ({', '.join(NAMED_PUSHES)}) to be written"
        raise check.ArgumentError("law.function", rule, law.function)
    return PushTable(name, {key: float(value) for key, value in law.numbers.items()})


def _force_table(force):
    if force is None:
        return None
    name = name_of(force.function)
    if name is None:
        rule = f"must be one of ours ({', '.join(NAMED)}) to be written"
        raise check.ArgumentError("force.function", rule, force.function)
    solver = force.solver and solver_name(force.solver)
    if force.solver is not None and solver is None:
        rule = "must be one that diffrax makes by its name alone to be written"
        raise check.ArgumentError("force.solver", rule, force.solver)
    numbers = {key: float(value) for key, value in force.numbers.items()}
    return ForceTable(name, numbers, force.tolerance, solver)
