"""The rules for a scene: each broken one is a single line that names the key, the rule and the value."""

import difflib
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state

from continuation.argument_types import check_arguments, make_checker

HIGHEST_HARMONIC = 1000
MAX_MESSAGE_LENGTH = 300  # characters of a message
MAX_COUNT = 2**31 - 1  # of what is counted: more is a slip, and compiled loops count in 32 bits
MAX_ORBIT_PERIODS = 32  # of an orbit that is looked for; `iterate` keeps twice as many

Params = ParamSpec("Params")
Result = TypeVar("Result")


class ArgumentError(ValueError):
    """An argument breaks a rule. key: the argument, or the parameter, dotted; rule: what it must be; value: what was
    given; index: the first place in a batch where it is broken, None without a batch."""

    def __init__(self, key: str, rule: str, value: Any, index: tuple[int, ...] | None = None) -> None:
        super().__init__(key, rule, value, index)
        self.key, self.rule, self.value, self.index = key, rule, value, index

    def __str__(self) -> str:
        location = "" if self.index is None else f" at index {self.index}"
        suffix = f"; got {format_value(self.value)}{location}"
        return shorten(f"{shorten(self.key)}: {self.rule}", MAX_MESSAGE_LENGTH - len(suffix)) + suffix


class SceneError(ArgumentError):
    """A scene breaks a rule."""


check_types = check_arguments(
    ArgumentError
)  # decorates a public function: it refuses arguments that its annotations do not allow


def raise_scene_errors(function: Callable[Params, Result]) -> Callable[Params, Result]:
    """Decorates what makes a scene: an argument that breaks a rule is then the scene's."""

    @wraps(function)
    def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except ArgumentError as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError(*error.args) from None

    return wrapper


def shorten(text, max_length=80):
    """A text on one line of at most so many characters."""
    line = " ".join(str(text)[: 100 * max_length].split())
    return line if len(line) <= max_length else f"{line[: max_length - 3]}..."


# What papers and other programs call the parameters of a scene, and special points.
SYNONYMS = {"A": "amplitude", "F": "amplitude", "force": "amplitude", "omega": "frequency", "Omega": "frequency"}
SYNONYMS |= {"gamma": "damping", "zeta": "damping", "damping_ratio": "damping", "R": "restitution", "r": "restitution"}
SYNONYMS |= {"LP": "SN", "LPC": "SN", "TR": "NS", "BPC": "BP"}


GAP_NAMES = ("gap", "clearance")  # no parameter; a wall's position is one


def describe_choices(name, names):
    """The end of a rule that a name breaks as it is none of these: the nearest of them, and all."""
    suggestion = nearest_name(name, names)
    if name in GAP_NAMES:
        return f": vary left.position or right.position instead ({', '.join(names)})"
    return f"{', perhaps ' + suggestion if suggestion else ''} ({', '.join(names)})"


def nearest_name(name, names):
    """The name among others that a misspelt one, or one of another program, stands for; None where there is none."""
    if SYNONYMS.get(name) in names:
        return SYNONYMS[name]
    matches = difflib.get_close_matches(shorten(name), names, 1)
    return matches[0] if matches else None


def format_value(value):
    """A value on one short line."""
    is_array = hasattr(value, "dtype")
    if is_array and np.ndim(value):
        return f"an array of shape {np.shape(value)} and type {value.dtype}"
    try:
        line = " ".join((str(value) if is_array else repr(value)).split())
    except ValueError:
        return "a whole number too long to show"
    except RecursionError:
        return "a value too deep to show"
    return shorten(line)


def is_traced(*values):
    """True where any of the values is known only to a transformation (jit, vmap, grad)."""
    return any(isinstance(value, jax.core.Tracer) for value in values)


def is_transformed():
    """Whether this is called within a transformation (jit, vmap, grad), whatever it is called with."""
    trace_state = get_opaque_trace_state()
    with jax.core.eval_context():
        return trace_state != get_opaque_trace_state()


def host_only(alternative: str) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]:
    """Decorates a function that runs on the host: under a transformation it says so at once, and what does it there.

    Raises ArgumentError where an argument is traced, within jit, vmap and grad where none is, and for arguments that
    the annotations of the function do not allow.
    """

    def decorator(function: Callable[Params, Result]) -> Callable[Params, Result]:
        require_types = make_checker(function, ArgumentError)

        @wraps(function)
        def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
            tracers = _find_tracers(*args, *kwargs.values())
            if tracers or is_transformed():
                rule = (
                    "runs on the host and cannot be traced by jit, vmap or grad: call it outside; within, "
                    + alternative
                )
                raise ArgumentError(function.__name__, rule, tracers[0] if tracers else "a call within one")
            require_types(args, kwargs)
            return function(*args, **kwargs)

        return wrapper

    return decorator


def _find_tracers(*values):
    """The tracers within values; none of a list that holds itself, of which jax makes no tree."""
    flat_values = [
        list(item.items()) if isinstance(item, dict) else item for item in values
    ]  # a dict's keys need no order
    try:
        return [item for item in jax.tree.leaves(flat_values) if is_traced(item)]
    except (RecursionError, SystemError):
        return []


def require_parameter(name, names, value):
    """Refuse a name that is none of these parameters."""
    if not isinstance(name, str):
        raise ArgumentError("name", f"must be a parameter of this scene ({', '.join(names)})", name)
    if name not in names:
        raise ArgumentError(name, f"is not a parameter of this scene{describe_choices(name, names)}", value)


def require_choice(key, value, choices):
    """The value, refused where it is none of some names, with the nearest of them."""
    if isinstance(value, str) and value in choices:
        return value
    suggestion = nearest_name(value, choices) if isinstance(value, str) else None
    raise ArgumentError(
        key, f"must be one of {', '.join(choices)}{f', perhaps {suggestion}' if suggestion else ''}", value
    )


def name_tuple(key, names):
    """Names as a tuple; a text is one name, not its letters."""
    if isinstance(names, str):
        return (names,)
    try:
        return tuple(names)
    except TypeError:
        raise ArgumentError(key, "must be a name or a sequence of names", names) from None


def require_independent(*names):
    """Refuse parameters of which one, the hardness, changes another."""
    if "hardness" in names and any(name.endswith((".stiffness", ".damping")) for name in names):
        raise ArgumentError("names", "must not name what the hardness changes beside it", names)


def require_one_wall_kind(side, wall):
    """Refuse a wall that is neither rigid nor soft, and one that is soft in two ways."""
    for name in ("restitution", "stiffness", "damping") if wall.law is not None else ():
        if getattr(wall, name) is not None:
            raise ArgumentError(f"{side}.{name}", "a wall with a law of its own has none", getattr(wall, name))
    if wall.law is not None:
        return
    if wall.stiffness is not None and wall.restitution is not None:
        raise ArgumentError(f"{side}.restitution", "a wall with stiffness has none", wall.restitution)
    if wall.stiffness is None and wall.damping is not None:
        raise ArgumentError(f"{side}.damping", "a wall without stiffness has none", wall.damping)


def require_own_damping(side, wall, force):
    """Refuse a soft wall that would take the scene's damping beside a force, where there is none."""
    if force is not None and wall.stiffness is not None and wall.damping is None:
        raise ArgumentError(f"{side}.damping", "must be given beside a force, on top of which it comes", None)


def require_spring_or_force(force, damping):
    """Refuse a damping beside a force of the user's own, which is in place of it."""
    if force is not None and damping is not None:
        raise ArgumentError("damping", "is not given beside a force, which is in place of spring and damper", damping)
    if force is None and damping is None:
        raise ArgumentError("damping", "must be given, or a force in place of spring and damper", None)


def require_spring(scene, caller):
    """Refuse a force of the user's own where only the spring and the damper are known."""
    if scene.force is not None:
        raise ArgumentError("force", f"{caller} knows spring and damper alone", scene.force.function)


def require_one_harmonic(scene, caller):
    """Refuse further terms of the drive where only A cos(omega t) is known."""
    if scene.drive:
        harmonics = ", ".join(f"harmonic {term.harmonic}" for term in scene.drive)
        raise ArgumentError("drive", f"{caller} knows a drive of amplitude cos(frequency t) alone", harmonics)


def require_single(scene):
    """Refuse a batch of scenes."""
    if scene.shape:
        raise ArgumentError("scene", "must be a single scene, not a batch", f"shape {scene.shape}")


def wall_pair(walls):
    """The walls as a tuple of two entries, left and right: of a tuple, a list or an array of two positions."""
    is_array = hasattr(walls, "dtype") and np.shape(walls) == (2,)
    if not is_array and (not isinstance(walls, tuple | list) or len(walls) != 2):
        raise ArgumentError("walls", "must be a pair (left, right), each a position, None or a Wall", walls)
    return tuple(walls)


def float_type(dtype):
    """The scene's floating-point type: float64 where None was given, and then jax must have it on."""
    try:
        float_dtype = np.dtype(np.float64 if dtype is None else dtype)
    except (TypeError, ValueError, RecursionError):
        float_dtype = None
    if float_dtype not in (np.float32, np.float64):
        raise ArgumentError("dtype", "must be None, float32 or float64", dtype)
    if float_dtype == np.float64 and not jax.config.jax_enable_x64:
        advice = "call jax.config.update('jax_enable_x64', True) first, or ask for dtype=jnp.float32"
        raise ArgumentError("dtype", f"double precision is off in jax: {advice}", float_dtype.name)
    return float_dtype


def real_array(key, value, dtype):
    """The value as an array of real numbers: NumPy's, or a tracer's, of which only the type is checked."""
    if is_traced(value):
        if value.dtype.kind not in "fiu":
            raise ArgumentError(key, "must be a real number", f"type {value.dtype}")
        return jnp.asarray(value, dtype)
    array = _plain_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise ArgumentError(key, "must be a real number", value)
    if array.dtype == dtype:
        return array.copy()
    with np.errstate(over="ignore"):
        return array.astype(dtype)


def finite_array(key, value, dtype):
    """Like `real_array`, and known values must be finite."""
    array = real_array(key, value, dtype)
    if not is_traced(array):
        require(key, "must be finite", array, np.isfinite(array))
    return array


def finite_float(key, value):
    """The value as a float: one finite number."""
    array = finite_array(key, value, np.float64)
    if array.ndim:
        raise ArgumentError(key, "must be one number", value)
    return float(array)


def scene_quantity(key, value, dtype):
    """Like `finite_array`, for what a scene is made of: there a list is taken neither for a batch nor for the two
    walls'."""
    if isinstance(value, list | tuple):
        advice = "what each wall has of its own is written walls=(Wall(...), Wall(...)), a batch np.array([...])"
        raise ArgumentError(key, f"must be a number or an array, not a {type(value).__name__}: {advice}", value)
    return finite_array(key, value, dtype)


def _plain_array(value):
    if value is None or isinstance(value, str | bytes | bool):
        return None
    try:
        return np.asarray(value)
    except Exception:  # ragged and endless lists, and objects with conversions of their own
        return None


def harmonic_number(key, value, minimum=1):
    """The harmonic as an int: a whole number from the lowest on (a truth value is none)."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or not minimum <= value <= HIGHEST_HARMONIC:
        raise ArgumentError(key, f"must be a whole number from {minimum} to {HIGHEST_HARMONIC}", value)
    return int(value)


def require(key, rule, value, holds):
    """Refuse the first element for which the rule does not hold."""
    value, holds = np.broadcast_arrays(value, holds)
    if not holds.all():
        index = tuple(int(i) for i in np.argwhere(~holds)[0])
        raise ArgumentError(key, rule, value[index], index or None)


def require_broadcast(leaves):
    """Refuse the first array that does not broadcast with those before it."""
    if not any(leaf.shape for _, leaf in leaves):
        return
    shape = ()
    for key, leaf in leaves:
        try:
            shape = np.broadcast_shapes(shape, leaf.shape)
        except ValueError:
            raise ArgumentError(key, f"must broadcast with the shape {shape} of the others", leaf) from None


def whole_number(key, value, minimum):
    """The value as an int: a whole number from `minimum` on (a truth value is none). Counts end at `MAX_COUNT`, seeds
    do not."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < minimum:
        raise ArgumentError(key, f"must be a whole number from {minimum} on", value)
    if value > MAX_COUNT and key != "seed":
        raise ArgumentError(key, f"must be at most {MAX_COUNT}", value)
    return int(value)
