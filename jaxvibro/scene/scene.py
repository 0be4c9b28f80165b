"""Define the scene: an oscillator, its drive and its walls, a pytree of nondimensional numbers (paper, section 1)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real
from numpy.typing import DTypeLike

from continuation.array_type import Array

from . import check
from .flow_kinds import SOLVER, SPRING, TAYLOR, SpringFlow, TaylorFlow
from .force import Force
from .force_operations import areas_never_grow
from .push import Push
from .scales import Scales
from .scene_checks import check_scene
from .user_function_checks import check_contact_law, check_force


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


SIDES = ("left", "right")
MAX_DRIVE_TERMS = 32  # terms of the drive beside its first; each number of terms compiles


@dataclass(frozen=True, eq=False)
class Scene:
    """Oscillator with its drive and its walls.

    Make a scene with `make_scene`, which checks it.

    Attributes
    ----------
    amplitude : Array
        Amplitude A of the drive, in lengths of the scene.
    frequency : Array
        Frequency omega of the drive, in units of the undamped natural frequency w0.
    damping : Array or None
        Damping ratio gamma, 1 being critical. None if the scene has a `Force`.
    restitution : Array
        Coefficient of restitution R of the rigid walls without their own.
    left, right : Wall or None
        The walls. None means that the scene has no wall on this side.
    harder : Array or None
        Decimal logarithm of a factor by which the stiffness of each soft wall is multiplied, at the same effective
        restitution. None except along a branch.
    force : Force or None
        User-defined force in place of the spring and the damper. None selects the spring and the damper.
    drive : tuple of Motion
        Further terms of the drive beside ``amplitude cos(frequency t)``.
    scales : Scales or None
        Scales of a scene that `scene_from_physical` made. None for other scenes and for results of JAX transformations.

    See Also
    --------
    make_scene : Make a scene from nondimensional numbers.
    scene_from_physical : Make a scene from SI quantities.

    Notes
    -----
    Between the walls the mass obeys ``x'' + 2 damping x' + x = amplitude cos(frequency t)``. With a `Force` it obeys
    ``x'' = force + amplitude cos(frequency t)``. At a rigid wall the velocity changes from y- to y+ with
    ``y+ - v = -restitution (y- - v)``, v being the velocity of the wall. `Wall` states the equation inside a soft wall.

    All real numbers are arrays. They broadcast to the shape of the batch of scenes.

    Examples
    --------
    >>> scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    >>> float(scene.amplitude), scene.shape
    (2.0, ())
    >>> stronger = scene.replace(amplitude=3.0)
    >>> float(stronger.amplitude)
    3.0
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
        """Floating-point type of the scene's numbers."""
        return jnp.result_type(self.amplitude)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch: the shapes of all numbers, broadcast together."""
        leaf_shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(self)]
        return jnp.broadcast_shapes(*leaf_shapes) if any(leaf_shapes) else ()

    @property
    def flow(self) -> str:
        """Method that computes the flight between the walls, with the reason, in one sentence.

        The text is "exact: ..." for spring and damper. For a `Force` it states Taylor steps or the solver.
        """
        return self.flow_kind.description(self)

    @property
    def flow_kind(self) -> SpringFlow | TaylorFlow:
        """Kind of the flow between the walls: spring and damper, or a force by Taylor steps or by a solver."""
        if self.force is None:
            return SPRING
        return TAYLOR if self.force.solver is None else SOLVER

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scene's parameters; names of a wall are dotted, as in ``"right.motion.phase"``.

        A scene with a soft wall beside the spring has the parameter ``"hardness"``, the decimal logarithm of the
        stiffness of the soft wall (of the left one if both are soft). A change of the hardness multiplies the stiffness
        of all soft walls by one factor and adjusts the damping of each wall, so that its `effective_restitution` does
        not change.
        """
        names = ["amplitude", "frequency", *self.flow_kind.parameters, "restitution"]
        names += [f"force.{name}" for name in getattr(self.force, "numbers", ())]
        names += [
            f"drive.{term_index}.{name}" for term_index in range(len(self.drive)) for name in ("amplitude", "phase")
        ]
        for side, wall in self.walls.items():
            names += [f"{side}.{name}" for name in ("position", *wall.own)]
            names += [f"{side}.motion.{name}" for name in ("amplitude", "phase") if wall.motion is not None]
        return (*names, "hardness") if self.hardens else tuple(names)

    @property
    def shares_restitution(self) -> bool:
        """True if a rigid wall has no restitution of its own and takes the scene's."""
        return any(not wall.soft and wall.restitution is None for wall in self.walls.values())

    @property
    def walls(self) -> dict[str, Wall]:
        """Walls of the scene by side, the left one first: ``{side: Wall}``."""
        return {side: getattr(self, side) for side in SIDES if getattr(self, side) is not None}

    @property
    def soft_sides(self) -> tuple[str, ...]:
        """Sides of the soft walls, left first."""
        return tuple(side for side, wall in self.walls.items() if wall.soft)

    @property
    def hardens(self) -> bool:
        """True if the scene has a hardness: it has a soft wall beside the spring."""
        return bool(self.soft_sides) and self.flow_kind.is_linear

    def parameter(self, name: str) -> Float[Array, "..."] | np.floating | float | int:
        """Return the value of a parameter.

        A wall without its own restitution or damping takes the scene's.

        Parameters
        ----------
        name : str
            Name of the parameter, one of `names`.

        Returns
        -------
        Array
            The value.

        Raises
        ------
        ArgumentError
            If the scene has no parameter of this name.
        """
        check.require_parameter(name, self.names, name)
        if name == "hardness":
            stiffness = getattr(self, self.soft_sides[0]).stiffness
            return (jnp if check.is_traced(stiffness) else np).log10(stiffness)
        value: Any = reduce(_child_node, _key_path(name), self)
        return getattr(self, name.split(".")[-1]) if value is None else value

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters of a single scene as plain numbers: ``{name: number}``."""
        return {name: float(self.parameter(name)) for name in self.names}

    def bounce(self, side: str) -> Float[Array, "..."] | np.floating | float | int:
        """Return the coefficient of restitution R of a wall, or -1 for a soft wall.

        A soft wall does not reverse the velocity.

        Parameters
        ----------
        side : {"left", "right"}
            Side of the wall.

        Returns
        -------
        Array
            Coefficient of restitution relative to the wall.
        """
        wall = getattr(self, side)
        return self.parameter(f"{side}.restitution") if "restitution" in wall.own else -jnp.ones_like(wall.position)

    @property
    def dissipative(self) -> bool | None:
        """True if phase-space areas provably never grow, for every scene of the batch; else None.

        The areas grow neither in flight nor at an impact. The value is None if there is no proof, and if numbers are
        traced. It is never False. If it is True, the product of the multipliers is at most 1 in magnitude and there
        are no Neimark-Sacker points. Areas that stay constant, without damping and with R = 1, satisfy the condition.

        Notes
        -----
        Scenes with spring and damper are always dissipative. For a `Force` interval arithmetic bounds d force / d v for
        all t and v and for all x between the walls (docs/force.md).
        """
        return areas_never_grow(self)

    @check.convert_to_scene_errors
    def replace(self, **changes: Real[ArrayLike, "..."]) -> "Scene":
        """Return a copy of the scene with other parameter values.

        A value for the restitution or the damping of a wall gives the wall its own. The hardness changes before the
        other parameters.

        Parameters
        ----------
        **changes : array_like
            New values by name, for example ``scene.replace(**{"amplitude": 3.0, "right.restitution": 0.5})``.

        Returns
        -------
        Scene
            The new scene, checked like any other.

        Raises
        ------
        SceneError
            If a name is not a parameter of the scene, or a value breaks its rule.
        """
        scene = replace_unchecked(self, changes)
        return map_scene_numbers(jnp.asarray, validate_scene(scene, check.check_float_type(self.dtype)))


_LEAF_NAMES = [entry.name for entry in fields(Scene) if entry.name != "scales"]
jax.tree_util.register_dataclass(Scene, _LEAF_NAMES, [], ("scales",))  # scales are no leaf: they cause no recompilation

Walls = Sequence[Wall | Real[ArrayLike, "..."] | None] | Real[Array, " walls"]  # left and right


@check.convert_to_scene_errors
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
    """Make a checked scene from nondimensional numbers.

    Parameters
    ----------
    amplitude : array_like
        Amplitude A of the drive, in lengths of the scene.
    frequency : array_like
        Frequency omega > 0 of the drive, in units of the undamped natural frequency w0.
    damping : array_like, optional
        Damping ratio gamma >= 0, 1 being critical. Must be left out if `force` is given.
    restitution : array_like, optional
        Coefficient of restitution R from 0 to 1. May be left out if each rigid wall has its own.
    walls : tuple of (array_like, Wall or None), optional
        Left and right wall, each a position, None (no wall) or a `Wall`, or an array of two positions. Must be given.
    dtype : dtype, optional
        Either float64 (default, needs ``jax_enable_x64``) or float32.
    force : Force, optional
        User-defined force in place of the spring and the damper.
    drive : sequence of Motion or tuple, optional
        Further terms of the drive, each a `Motion` or ``(amplitude, harmonic, phase)``. The term ``(amplitude, 0,
        0.0)`` is a constant force. At most 32 terms.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    SceneError
        If an argument breaks its rule. The message names the argument, the rule and the first offending value. Under
        tracing only types and shapes are checked.

    See Also
    --------
    scene_from_physical : Make a scene from SI quantities.

    Notes
    -----
    Lengths are in the unit of the wall positions. Time is in 1/w0, w0 being the undamped natural frequency (paper,
    section 1). Numbers or arrays broadcast together to a batch of scenes. A list in place of a number or an
    array is refused.

    Examples
    --------
    >>> scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls=(-1.0, 1.0))
    >>> scene.names[:4]
    ('amplitude', 'frequency', 'damping', 'restitution')
    >>> one_wall = jv.make_scene(np.linspace(1.0, 2.0, 5), 2.1, 0.05, 0.7, walls=(None, 1.0))
    >>> one_wall.shape, list(one_wall.walls)
    ((5,), ['right'])
    """
    scene = check_scene_arguments(
        amplitude, frequency, damping, restitution, walls, check.check_float_type(dtype), force, drive
    )
    return map_scene_numbers(jnp.asarray, scene)


def check_scene_arguments(amplitude, frequency, damping, restitution, walls, dtype, force, drive):
    """Return the checked scene of the arguments of `make_scene` as NumPy arrays of one type (tracers stay tracers).

    Raises ArgumentError if an argument breaks its rule.
    """
    wall_by_side = dict(zip(SIDES, check.check_walls_are_pair(walls), strict=True))
    for side, wall in wall_by_side.items():
        if isinstance(wall, Motion):
            raise check.SceneError(side, "must be a position, None or a Wall", wall)
    numerical_fields = {"amplitude": amplitude, "frequency": frequency, "damping": damping}
    numerical_fields["restitution"] = restitution_or_default(restitution, wall_by_side.values())
    field_values = {**numerical_fields, **wall_by_side, "harder": None, "force": force, "drive": drive}
    return check_scene(_scene_from_fields(field_values, dtype))


def restitution_or_default(restitution, walls):
    """Return `restitution`, or 1 if it is None and each rigid wall has its own restitution.

    Raises SceneError if it is None and a rigid wall has no restitution of its own.
    """
    if restitution is not None:
        return restitution
    needs_no_default = (
        wall is None or (isinstance(wall, Wall) and (wall.soft or wall.restitution is not None)) for wall in walls
    )
    if not all(needs_no_default):
        raise check.SceneError("restitution", "must be given, unless each rigid wall has its own", None)
    return 1.0


def replace_unchecked(scene, new_values):
    """Return a copy of the scene with other parameter values, without a check of the values.

    Parameters
    ----------
    scene : Scene
        The scene.
    new_values : dict of str to array_like
        New values by name. The hardness changes first.

    Returns
    -------
    Scene
        The new scene.

    Raises
    ------
    ArgumentError
        If a name is not a parameter of the scene.
    """
    for name, value in sorted(new_values.items(), key=lambda change: change[0] != "hardness"):
        check.require_parameter(name, scene.names, value)
        scene = _set_hardness(scene, value) if name == "hardness" else _set_leaf(scene, _key_path(name), value)
    return scene


def _set_hardness(scene, value):
    """Return the scene with all soft walls scaled to a hardness."""
    if not check.is_traced(value):
        value = check.check_number_or_array("hardness", value, np.float64)
    log10_factor, hardened_walls = value - scene.parameter("hardness"), {}
    for side in scene.soft_sides:
        wall = getattr(scene, side)
        stiffness, damping = harden_wall(wall.stiffness, scene.parameter(f"{side}.damping"), log10_factor)
        hardened_walls[side] = replace(wall, stiffness=stiffness, damping=damping)
    return replace(scene, **hardened_walls)


def harden_wall(stiffness, damping, log10_factor):
    """Return stiffness and damping of a soft wall after a change of its hardness.

    The damping ratio ``z = gamma2 / sqrt(1 + k2)`` of the wall, and therefore its effective restitution, do not change.

    Parameters
    ----------
    stiffness : array_like
        Stiffness k2 of the wall.
    damping : array_like
        Damping gamma2 of the wall.
    log10_factor : array_like
        Decimal logarithm of the factor of the stiffness.

    Returns
    -------
    stiffness : Array
        New stiffness.
    damping : Array
        New damping.
    """
    array_module = jnp if check.is_traced(stiffness, damping, log10_factor) else np
    with np.errstate(over="ignore", under="ignore"):  # the rules for a wall refuse the result
        new_stiffness = stiffness * 10.0**log10_factor
        return new_stiffness, damping * array_module.sqrt((1.0 + new_stiffness) / (1.0 + stiffness))


def _key_path(name):
    """Return the path of a parameter in the scene's tree; parameters of a force or a contact law are in a dict."""
    return name.replace("force.", "force.numbers.").replace(".law.", ".law.numbers.").split(".")


def _child_node(node, key):
    """Return the child of a given key of a node of the scene's tree."""
    if isinstance(node, tuple):
        return node[int(key)]
    return node[key] if isinstance(node, dict) else getattr(node, key)


def _set_leaf(node, key_path, value):
    """Return a copy of a node of the scene's tree in which the leaf at `key_path` has a new value."""
    first_key, *remaining_keys = key_path
    if isinstance(node, tuple):
        return tuple(
            _set_leaf(child, remaining_keys, value) if child_index == int(first_key) else child
            for child_index, child in enumerate(node)
        )
    if isinstance(node, dict):
        return {**node, first_key: value}
    return replace(
        node, **{first_key: _set_leaf(getattr(node, first_key), remaining_keys, value) if remaining_keys else value}
    )


def map_scene_numbers(function, scene):
    """Apply a function to all numbers of a scene and keep its scales.

    Parameters
    ----------
    function : callable
        Function of one array.
    scene : Scene
        The scene.

    Returns
    -------
    Scene
        The new scene.
    """
    return replace(jax.tree.map(function, scene), scales=scene.scales)


def validate_scene(scene, dtype):
    """Check a scene and return it with NumPy arrays of one type (tracers stay tracers).

    Parameters
    ----------
    scene : Scene
        Scene with unchecked numbers.
    dtype : dtype
        Floating-point type.

    Returns
    -------
    Scene
        The checked scene.

    Raises
    ------
    ArgumentError
        If the scene breaks a rule.
    """
    return check_scene(_scene_from_fields(vars(scene), dtype))


def _scene_from_fields(field_values, dtype):
    """Return the scene of ``{field: value}`` with checked arrays of one type."""

    def to_checked_array(key, value):
        return check.check_number_or_array(key, value, dtype)

    def make_motion(key, min_harmonic, amplitude, harmonic, phase):
        return Motion(
            to_checked_array(f"{key}.amplitude", amplitude),
            to_checked_array(f"{key}.phase", phase),
            check.check_harmonic(f"{key}.harmonic", harmonic, min_harmonic),
        )

    def make_wall_motion(key, motion):
        if not isinstance(motion, Motion):
            raise check.SceneError(key, "must be a Motion or None", motion)
        return make_motion(key, 1, motion.amplitude, motion.harmonic, motion.phase)

    def make_law(key, contact_law):
        return check_contact_law(key, contact_law, to_checked_array, dtype, field_values["force"])

    def make_force(key, force):
        return check_force(key, force, to_checked_array, dtype)

    converters = {"motion": make_wall_motion, "law": make_law, "force": make_force}

    def check_given(values, names, prefix=""):
        return {
            name: converters.get(name, to_checked_array)(f"{prefix}{name}", values[name])
            for name in names
            if values[name] is not None
        }

    def make_wall(side, wall):
        if wall is None:
            return None
        if not isinstance(wall, Wall):
            return Wall(to_checked_array(f"{side}.position", wall))
        check.require_rigid_or_soft(side, wall, field_values["damping"])
        position = to_checked_array(f"{side}.position", wall.position)
        optional_fields = check_given(vars(wall), ("restitution", "stiffness", "damping", "law", "motion"), f"{side}.")
        return Wall(position, **optional_fields)

    check.require_spring_or_force(field_values["force"], field_values["damping"])
    checked_fields = {
        key: to_checked_array(key, field_values[key]) for key in ("amplitude", "frequency", "restitution")
    }
    checked_fields |= {"damping": None} | check_given(field_values, ("damping", "harder", "force"))
    checked_fields["drive"] = tuple(
        make_motion(f"drive.{term_index}", 0, *drive_term)
        for term_index, drive_term in enumerate(drive_term_tuples(field_values["drive"]))
    )
    wall_by_side = {side: make_wall(side, field_values[side]) for side in SIDES}
    return Scene(**checked_fields, **wall_by_side, scales=field_values.get("scales"))


def drive_term_tuples(drive):
    """Iterate over the further terms of a drive, not yet checked.

    Parameters
    ----------
    drive : sequence of Motion or tuple
        Terms of the drive, as in `make_scene`.

    Yields
    ------
    tuple
        Amplitude, harmonic and phase of a term.

    Raises
    ------
    SceneError
        If `drive` is not a list of terms, or has more than 32.
    """
    if not isinstance(drive, tuple | list):
        raise check.SceneError("drive", "must be a list of terms, each (amplitude, harmonic, phase) or a Motion", drive)
    if len(drive) > MAX_DRIVE_TERMS:
        raise check.SceneError("drive", f"must have at most {MAX_DRIVE_TERMS} terms", len(drive))
    for term_index, drive_term in enumerate(drive):
        if isinstance(drive_term, Motion):
            yield drive_term.amplitude, drive_term.harmonic, drive_term.phase
        elif isinstance(drive_term, tuple | list) and len(drive_term) == 3:
            yield drive_term
        else:
            raise check.SceneError(
                f"drive.{term_index}", "must be (amplitude, harmonic, phase) or a Motion", drive_term
            )


def wall_positions(scene, phase):
    """Return the positions of the walls of a known scene at a phase of the drive.

    Parameters
    ----------
    scene : Scene
        Scene without traced numbers.
    phase : array_like
        Phase of the drive, in rad.

    Returns
    -------
    left : ndarray
        Position of the left wall, -inf without a left wall.
    right : ndarray
        Position of the right wall, inf without a right wall.
    """
    positions = {"left": -np.inf, "right": np.inf}
    for side, wall in scene.walls.items():
        motion_offset = (
            0.0
            if wall.motion is None
            else wall.motion.amplitude * np.cos(wall.motion.harmonic * np.asarray(phase) + wall.motion.phase)
        )
        positions[side] = np.asarray(wall.position) + motion_offset
    return tuple(positions.values())


def rigid_wall_positions(scene, phase):
    """Return the positions of the rigid walls of a known scene at a phase of the drive.

    Soft walls count as absent, because a mass may be inside them.

    Parameters
    ----------
    scene : Scene
        Scene without traced numbers.
    phase : array_like
        Phase of the drive, in rad.

    Returns
    -------
    left : ndarray
        Position of the left wall, -inf if it is soft or absent.
    right : ndarray
        Position of the right wall, inf if it is soft or absent.
    """
    positions = wall_positions(scene, phase)
    side_entries = zip(SIDES, positions, (-np.inf, np.inf), strict=True)
    return tuple(
        absent_position if side in scene.soft_sides else position for side, position, absent_position in side_entries
    )
