"""The scene: an oscillator, its drive and its walls, a frozen pytree of nondimensional numbers (paper, section 1)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real
from numpy.typing import DTypeLike

from continuation.array_type import Array

from . import check
from .dissipation import areas_never_grow
from .force import Force
from .force_rules import check_force, check_force_values, flow_text
from .push import Push
from .push_rules import check_push
from .scales import Scales
from .scene_rules import check_scene
from .wall import Motion, Wall

SIDES = ("left", "right")
MAX_DRIVE_TERMS = 32  # of the drive, beside its first: each is compiled for


@dataclass(frozen=True, eq=False)
class Scene:
    """x'' + 2 damping x' + x = amplitude cos(frequency t) between the walls, y+ - v = -restitution (y- - v) at a rigid
    one; beyond a soft one as `Wall` says. With a force of its own x'' = force + amplitude cos(frequency t).

    Every real number is an array; together they broadcast to the batch of scenes. A wall that is None is not there.
    drive: further terms beside amplitude cos(frequency t), `Motion`s. force: a `Force`; damping is then None. harder:
    by how many decades the soft walls are stiffer than they say, at the same R_eff; None but along a branch. scales:
    the `Scales` of one that `scene_from_physical` made, None of others; what JAX's transformations give back has none.
    Make one with `make_scene`, which checks it.
    """

    amplitude: Real[Array, "..."]
    frequency: Real[Array, "..."]
    damping: Real[Array, "..."] | None
    restitution: Real[Array, "..."]
    left: Wall | None
    right: Wall | None
    harder: Real[Array, "..."] | None = None
    force: Force | None = None
    drive: tuple[Motion, ...] = ()
    scales: Scales | None = None

    @property
    def dtype(self) -> np.dtype:
        """The floating-point type of the scene's numbers."""
        return jnp.result_type(self.amplitude)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the batch: of all the scene's numbers, broadcast together."""
        shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(self)]
        return jnp.broadcast_shapes(*shapes) if any(shapes) else ()

    @property
    def flow(self) -> str:
        """How the mass flies between the walls, and why, in a sentence: "exact: ..." under spring and damper, else by
        steps, Taylor's or those of a solver."""
        if self.force is None:
            return "exact: the flow of spring, damper and drive is known in closed form"
        return flow_text(self.force, self.dtype)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the scene's parameters, those of a wall dotted: "right.motion.phase".

        Where there is a soft wall beside the spring, "hardness" is one: the decimal logarithm of its stiffness, of the
        left one's where there are two. Naming it multiplies the stiffness of all soft walls by one number, and changes
        the damping of each so that its R_eff stays (`effective_restitution`).
        """
        names = ["amplitude", "frequency", "restitution"]
        if self.force is None:
            names.insert(2, "damping")
        else:
            names += [f"force.{name}" for name in self.force.numbers]
        names += [f"drive.{k}.{name}" for k in range(len(self.drive)) for name in ("amplitude", "phase")]
        for side, wall in self.walls.items():
            names += [f"{side}.{name}" for name in ("position", *wall.own)]
            names += [f"{side}.motion.{name}" for name in ("amplitude", "phase") if wall.motion is not None]
        return (*names, "hardness") if self.hardens else tuple(names)

    @property
    def shares_restitution(self) -> bool:
        """Whether there is a rigid wall without a restitution of its own, which has the scene's."""
        return any(not wall.soft and wall.restitution is None for wall in self.walls.values())

    @property
    def walls(self) -> dict[str, Wall]:
        """{side: `Wall`} of the walls that there are, left first."""
        return {side: getattr(self, side) for side in SIDES if getattr(self, side) is not None}

    @property
    def soft_sides(self) -> tuple[str, ...]:
        """The sides of its soft walls, left first."""
        return tuple(side for side, wall in self.walls.items() if wall.soft)

    @property
    def hardens(self) -> bool:
        """Whether it has a hardness: R_eff of its soft walls is that beside the spring."""
        return bool(self.soft_sides) and self.force is None

    def parameter(self, name: str) -> Float[Array, "..."] | np.floating | float | int:
        """The value of a parameter, an array; a wall without a restitution, or damping, of its own gives the scene's.

        Raises ArgumentError where the scene has no parameter of this name.
        """
        check.require_parameter(name, self.names, name)
        if name == "hardness":
            stiffness = getattr(self, self.soft_sides[0]).stiffness
            return (jnp if check.is_traced(stiffness) else np).log10(stiffness)
        value: Any = reduce(_child_node, name.split(".", 1) if name.startswith("force.") else name.split("."), self)
        return getattr(self, name.split(".")[-1]) if value is None else value

    @property
    def numbers(self) -> dict[str, float]:
        """{name: number} of the parameters of a single scene."""
        return {name: float(self.parameter(name)) for name in self.names}

    def bounce(self, side: str) -> Float[Array, "..."] | np.floating | float | int:
        """R of a wall, with which the velocity against it comes back; -1 of a soft one, which lets it pass."""
        wall = getattr(self, side)
        return -jnp.ones_like(wall.position) if wall.soft else self.parameter(f"{side}.restitution")

    @property
    def dissipative(self) -> bool | None:
        """True where it is proved that areas in the state space never grow, in flight or at an impact, of no scene of
        the batch; None where it is not proved, and where numbers are traced. It is never False.

        Then no multipliers' product is above 1, and there are no Neimark-Sacker points. Areas that stay as they are,
        without damping and with R = 1, count as such that do not grow. Of spring and damper it is always so; of a force
        d force / d v is bounded by interval arithmetic, at all t and v and all x between the walls (docs/force.md).
        """
        return areas_never_grow(self)

    @check.raise_scene_errors
    def replace(self, **changes: Real[ArrayLike, "..."]) -> "Scene":
        """The same scene with other values: `scene.replace(**{"amplitude": 3.0, "right.restitution": 0.5})`.

        Naming a wall's restitution, or damping, gives that wall its own; so does naming the hardness, which is changed
        before the others. Raises SceneError, as the new scene is checked like any other.
        """
        return _make_checked(vars(replace_unchecked(self, changes)), self.dtype)


_LEAF_NAMES = [entry.name for entry in fields(Scene) if entry.name != "scales"]
jax.tree_util.register_dataclass(Scene, _LEAF_NAMES, [], ("scales",))  # so no scales make another program

Walls = Sequence[Wall | Real[ArrayLike, "..."] | None] | Real[Array, " walls"]  # left and right


@check.raise_scene_errors
def make_scene(
    amplitude: Real[ArrayLike, "..."],
    frequency: Real[ArrayLike, "..."],
    damping: Real[ArrayLike, "..."] | None = None,
    restitution: Real[ArrayLike, "..."] | None = None,
    walls: Walls | None = None,
    dtype: DTypeLike | None = None,
    force: Force | None = None,
    drive: Sequence[Motion | tuple[Real[ArrayLike, "..."], int, Real[ArrayLike, "..."]]] = (),
) -> Scene:
    """A checked scene.

    amplitude A, frequency omega > 0, damping gamma >= 0 (1 is critical), restitution 0 <= R <= 1: numbers or arrays
    that broadcast together as a batch; a list is refused; R may be left out where each rigid wall has its own. walls:
    (left, right), each a position, None (no wall there) or a `Wall`, which may have a restitution of its own; or an
    array of two positions. force: a `Force` in place of the spring and the damper, None for these; beside one there is
    no damping. drive: terms that are added to A cos(omega t), each (amplitude, harmonic, phase) or a `Motion`;
    (amplitude, 0, 0.0) is a constant force. Units: lengths in the unit of the walls, time in 1/w0, w0 the undamped
    natural frequency (paper, section 1). dtype: None is float64 and needs jax's jax_enable_x64; jnp.float32 asks for
    single precision.

    Raises SceneError, which names the argument, the rule and the first offending value. Under tracing only types and
    shapes are checked.
    """
    wall_fields: dict[str, Any] = dict(zip(SIDES, check.wall_pair(walls), strict=True))
    for side, wall in wall_fields.items():
        if isinstance(wall, Motion):
            raise check.SceneError(side, "must be a position, None or a Wall", wall)
    number_fields = {"amplitude": amplitude, "frequency": frequency, "damping": damping}
    number_fields["restitution"] = resolve_restitution(restitution, wall_fields.values())
    return _make_checked({**number_fields, **wall_fields, "harder": None, "force": force, "drive": drive}, dtype)


def resolve_restitution(restitution, walls):
    """The scene's R as given, or 1 where it is left out and no wall would have it. Raises SceneError."""
    if restitution is not None:
        return restitution
    has_value = (
        wall is None or (isinstance(wall, Wall) and (wall.soft or wall.restitution is not None)) for wall in walls
    )
    if not all(has_value):
        raise check.SceneError("restitution", "must be given, or one of its own for each rigid wall", None)
    return 1.0


def replace_unchecked(scene, changes):
    """The scene with other values put in by name, not yet checked beyond the names."""
    for name, value in sorted(changes.items(), key=lambda change: change[0] != "hardness"):
        check.require_parameter(name, scene.names, value)
        scene = _replace_hardness(scene, value) if name == "hardness" else _set_leaf(scene, name.split("."), value)
    return scene


def _replace_hardness(scene, value):
    if not check.is_traced(value):
        value = check.scene_quantity("hardness", value, np.float64)
    log_factor, walls = value - scene.parameter("hardness"), {}
    for side in scene.soft_sides:
        wall = getattr(scene, side)
        stiffness, damping = harden_wall(wall.stiffness, scene.parameter(f"{side}.damping"), log_factor)
        walls[side] = replace(wall, stiffness=stiffness, damping=damping)
    return replace(scene, **walls)


def harden_wall(stiffness, damping, log_factor):
    """(k2, gamma2) of a wall 10^harder times as stiff that has the same z, and with it the same R_eff."""
    xp = jnp if check.is_traced(stiffness, damping, log_factor) else np
    with np.errstate(over="ignore", under="ignore"):  # a wall's own rules refuse what comes of it
        new_stiffness = stiffness * 10.0**log_factor
        return new_stiffness, damping * xp.sqrt((1.0 + new_stiffness) / (1.0 + stiffness))


def _child_node(node, name):
    if isinstance(node, tuple):
        return node[int(name)]
    return node.numbers[name] if isinstance(node, Force | Push) else getattr(node, name)


def _set_leaf(node, path, value):
    head, *subpath = path
    if isinstance(node, tuple):
        return tuple(_set_leaf(child, subpath, value) if k == int(head) else child for k, child in enumerate(node))
    if isinstance(node, Force | Push):
        return replace(node, numbers={**node.numbers, ".".join(path): value})
    return replace(node, **{head: _set_leaf(getattr(node, head), subpath, value) if subpath else value})


def _make_checked(field_values, dtype):
    return map_numbers(jnp.asarray, _check_sound(_scene_from_fields(field_values, check.float_type(dtype))))


def map_numbers(function, scene):
    """The scene with a function of each of its numbers, its scales as they were."""
    return replace(jax.tree.map(function, scene), scales=scene.scales)


def validate_scene(scene, dtype):
    """The scene once it breaks no rule, its numbers NumPy arrays of this type (tracers where they are traced)."""
    return _check_sound(_scene_from_fields(vars(scene), dtype))


def _check_sound(scene):
    """The scene itself, once it breaks no rule."""
    check_scene(scene)
    if scene.force is not None:
        check_force_values(scene)
    return scene


def _scene_from_fields(field_values, dtype):
    """The scene of {field: value}, every number an array of this type, refused where it is no finite real number."""

    def to_array(key, value):
        return check.scene_quantity(key, value, dtype)

    def make_motion(key, min_harmonic, amplitude, harmonic, phase):
        return Motion(
            to_array(f"{key}.amplitude", amplitude),
            to_array(f"{key}.phase", phase),
            check.harmonic_number(f"{key}.harmonic", harmonic, min_harmonic),
        )

    def make_wall_motion(side, motion):
        if motion is not None and not isinstance(motion, Motion):
            raise check.SceneError(f"{side}.motion", "must be a Motion or None", motion)
        return motion and make_motion(f"{side}.motion", 1, motion.amplitude, motion.harmonic, motion.phase)

    def make_wall(side, wall):
        if wall is None:
            return None
        if not isinstance(wall, Wall):
            return Wall(to_array(f"{side}.position", wall))
        check.require_one_wall_kind(side, wall)
        check.require_own_damping(side, wall, field_values["force"])
        numbers = {name: getattr(wall, name) for name in ("restitution", "stiffness", "damping")}
        numbers = {name: to_array(f"{side}.{name}", value) for name, value in numbers.items() if value is not None}
        law = None if wall.law is None else check_push(side, wall, to_array, dtype, field_values["force"])
        return Wall(
            to_array(f"{side}.position", wall.position), **numbers, motion=make_wall_motion(side, wall.motion), law=law
        )

    force = field_values["force"]
    check.require_spring_or_force(force, field_values["damping"])
    number_names = ("amplitude", "frequency", "restitution") + (("damping",) if force is None else ())
    number_fields = {"damping": None} | {key: to_array(key, field_values[key]) for key in number_names}
    if field_values["harder"] is not None:
        number_fields["harder"] = to_array("harder", field_values["harder"])
    if force is not None:
        number_fields["force"] = check_force(force, to_array, dtype)
    number_fields["drive"] = tuple(
        make_motion(f"drive.{k}", 0, *term) for k, term in enumerate(drive_terms(field_values["drive"]))
    )
    wall_fields = {side: make_wall(side, field_values[side]) for side in SIDES}
    return Scene(**number_fields, **wall_fields, scales=field_values.get("scales"))


def drive_terms(drive):
    """(amplitude, harmonic, phase) of the further terms of a drive, not yet checked."""
    if not isinstance(drive, tuple | list):
        raise check.SceneError("drive", "must be a list of terms, each (amplitude, harmonic, phase) or a Motion", drive)
    if len(drive) > MAX_DRIVE_TERMS:
        raise check.SceneError("drive", f"must have at most {MAX_DRIVE_TERMS} terms", len(drive))
    for k, term in enumerate(drive):
        if isinstance(term, Motion):
            yield term.amplitude, term.harmonic, term.phase
        elif isinstance(term, tuple | list) and len(term) == 3:
            yield term
        else:
            raise check.SceneError(f"drive.{k}", "must be (amplitude, harmonic, phase) or a Motion", term)


def wall_positions(scene, phase):
    """Where the walls of a known scene are at a phase of the drive, NumPy's: (left, right), infinite where there is
    none."""
    positions = [-np.inf, np.inf]
    for k, side in enumerate(SIDES):
        if (wall := getattr(scene, side)) is not None:
            motion = wall.motion
            offset = (
                0.0 if motion is None else motion.amplitude * np.cos(motion.harmonic * np.asarray(phase) + motion.phase)
            )
            positions[k] = np.asarray(wall.position) + offset
    return tuple(positions)


def rigid_wall_positions(scene, phase):
    """As `wall_positions`, of rigid walls alone: past a soft one a mass is within it."""
    positions = wall_positions(scene, phase)
    entries = zip(SIDES, positions, (-np.inf, np.inf), strict=True)
    return tuple(no_wall if side in scene.soft_sides else position for side, position, no_wall in entries)
