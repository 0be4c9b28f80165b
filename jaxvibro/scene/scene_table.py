"""[scene]: the table that describes a scene, in a scene file and in all that is saved."""

from msgspec import Struct

from . import check
from .scene import Motion, Wall, make_scene


class Table(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A table in which every key has its meaning and no other key may stand."""


class MotionTable(Table, frozen=True):
    """[scene.left.motion]: a `Motion`."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1


class WallTable(Table, frozen=True):
    """[scene.left]: a `Wall`; a rigid one without restitution has the scene's, a soft one without damping too."""

    position: float
    restitution: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motion: MotionTable | None = None

    def wall(self):
        """The `Wall` described, not yet checked."""
        motion = self.motion and Motion(self.motion.amplitude, self.motion.phase, self.motion.harmonic)
        return Wall(self.position, self.restitution, self.stiffness, self.damping, motion)


class SceneTable(Table, frozen=True):
    """[scene]: the arguments of `make_scene`; a wall without a table is not there."""

    amplitude: float
    frequency: float
    damping: float
    restitution: float
    left: WallTable | None = None
    right: WallTable | None = None

    def make(self, dtype=None):
        """The scene described, made by `make_scene`: ArgumentError where it breaks a rule."""
        walls = tuple(table and table.wall() for table in (self.left, self.right))
        return make_scene(self.amplitude, self.frequency, self.damping, self.restitution, walls, dtype)


def table_of(scene):
    """The `SceneTable` that describes one scene. Raises ArgumentError for a batch."""
    if scene.shape:
        raise check.ArgumentError("scene", "only a single scene can be written, not a batch", f"shape {scene.shape}")

    def table(wall):
        if wall is None:
            return None
        move = wall.motion
        moving = move and MotionTable(amplitude=float(move.amplitude), phase=float(move.phase), harmonic=move.harmonic)
        own = {name: getattr(wall, name) for name in ("restitution", "stiffness", "damping")}
        own = {name: float(value) for name, value in own.items() if value is not None}
        return WallTable(position=float(wall.position), **own, motion=moving)

    plain = {key: float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution")}
    return SceneTable(**plain, left=table(scene.left), right=table(scene.right))
