"""Define the table [scene] that describes a scene, in a scene file and in all saved data."""

from dataclasses import replace

import msgspec
from msgspec import Struct, field

from . import check
from .force import DEFAULT_TOLERANCE, Force
from .predefined_forces import NAMED_FORCES
from .push import PREDEFINED_CONTACT_LAWS, Push
from .scales import Scales
from .scene import Motion, Wall, make_scene
from .user_function_checks import diffrax_solver_name

NUMBER_KEYS = ("amplitude", "frequency", "damping", "restitution")


class StrictTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Base of the tables of a scene file; unknown keys are refused."""


class MotionTable(StrictTable, frozen=True):
    """Table [scene.left.motion] or [scene.right.motion], or one of the tables [[scene.drive]]; it defines a
    `Motion`."""

    amplitude: float
    phase: float = 0.0
    harmonic: int = 1

    def motion(self):
        """Return the `Motion`, not yet checked."""
        return Motion(self.amplitude, self.phase, self.harmonic)


class WallLawTable(StrictTable, frozen=True):
    """Table [scene.left.law]: a predefined `Push` by name, and its parameters."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)


class WallTable(StrictTable, frozen=True):
    """Table [scene.left]: a `Wall`, which takes a missing restitution or damping from the scene."""

    position: float
    restitution: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motion: MotionTable | None = None
    law: WallLawTable | None = None

    def wall(self):
        """Return the `Wall`, not yet checked."""
        motion = self.motion and self.motion.motion()
        law = self.law and Push(self.law.name, self.law.numbers)
        return Wall(self.position, self.restitution, self.stiffness, self.damping, motion, law)


class ForceTable(StrictTable, frozen=True):
    """Table [scene.force]: a predefined `Force` by name, and its parameters."""

    name: str
    numbers: dict[str, float] = field(default_factory=dict)
    tolerance: float = DEFAULT_TOLERANCE
    solver: str | None = None

    def force(self):
        """Return the `Force`, not yet checked."""
        return Force(self.name, self.numbers, self.tolerance, self.solver)


class ScalesTable(StrictTable, frozen=True):
    """Table [scene.scales]: `Scales` with mass in kg, stiffness in N/m and length in m."""

    mass: float
    stiffness: float
    length: float


class SceneTable(StrictTable, frozen=True, kw_only=True):
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

    @property
    def arguments(self):
        """Arguments of `make_scene`, except for the type, not yet checked."""
        return {
            **{name: getattr(self, name) for name in NUMBER_KEYS},
            "walls": tuple(wall_table and wall_table.wall() for wall_table in (self.left, self.right)),
            "force": self.force and self.force.force(),
            "drive": [drive_table.motion() for drive_table in self.drive],
        }

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
            If an entry of the table is not valid for a scene, or `dtype` is not supported.
        """
        return replace(make_scene(**self.arguments, dtype=dtype), scales=self.scales and _make_scales(self.scales))


def _make_scales(scales_table):
    try:
        return Scales(scales_table.mass, scales_table.stiffness, scales_table.length)
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
        If the scene is a batch, its force or a contact law is not predefined, or the solver of its force is not one
        that diffrax makes from its name alone.
    """
    if scene.shape:
        raise check.ArgumentError("scene", "must be a single scene to be saved, not a batch", f"shape {scene.shape}")

    def make_motion_table(motion):
        return MotionTable(float(motion.amplitude), float(motion.phase), motion.harmonic)

    def make_wall_table(wall):
        if wall is None:
            return None
        motion = wall.motion and make_motion_table(wall.motion)
        contact_numbers = {name: getattr(wall, name) for name in ("restitution", "stiffness", "damping")}
        contact_numbers = {name: float(value) for name, value in contact_numbers.items() if value is not None}
        law = wall.law and WallLawTable(*_name_and_numbers("law", wall.law, PREDEFINED_CONTACT_LAWS))
        return WallTable(position=float(wall.position), **contact_numbers, motion=motion, law=law)

    scene_numbers = {key: float(scene.parameter(key)) for key in NUMBER_KEYS if key in scene.names}
    wall_tables = {"left": make_wall_table(scene.left), "right": make_wall_table(scene.right)}
    scales = scene.scales and ScalesTable(**scene.scales.numbers)
    drive = [make_motion_table(drive_term) for drive_term in scene.drive]
    force = scene.force and ForceTable(
        *_name_and_numbers("force", scene.force, NAMED_FORCES),
        scene.force.tolerance,
        scene.force.solver and diffrax_solver_name(scene.force.solver),
    )
    return SceneTable(**scene_numbers, **wall_tables, force=force, drive=drive, scales=scales)


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
        If the scene is a batch, its force or a contact law is not predefined, or the solver of its force is not one
        that diffrax makes from its name alone.
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

    Raises
    ------
    ArgumentError
        If the scene is a batch, or the solver of its force is not one that diffrax makes from its name alone.
    """
    user_functions = (scene.force, *(wall.law for wall in scene.walls.values()))
    functions = [user_function.function for user_function in user_functions if user_function is not None]
    predefined_functions = (*NAMED_FORCES.values(), *PREDEFINED_CONTACT_LAWS.values())
    return scene_toml(scene) if all(function in predefined_functions for function in functions) else ""


def _name_and_numbers(key, user_function, predefined_functions):
    """Return name and parameters of a predefined `Force` or `Push`; raise ArgumentError for any other function."""
    function = user_function.function
    if function not in predefined_functions.values():
        rule = f"must be predefined ({', '.join(predefined_functions)}) to be saved"
        raise check.ArgumentError(f"{key}.function", rule, function)
    return function.__name__, {name: float(value) for name, value in user_function.numbers.items()}
