"""Check arguments and scenes; each error is one line that names the key, the rule and the value."""

import difflib
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state

from continuation.argument_checks import check_arguments, make_checker

HIGHEST_HARMONIC = 1000
MAX_MESSAGE_LENGTH = 300  # characters
MAX_COUNT = 2**31 - 1  # largest count: compiled loops count in 32 bits
MAX_ORBIT_PERIODS = 32  # drive periods of the longest orbit in a search; `iterate` keeps twice as many

Params = ParamSpec("Params")
Result = TypeVar("Result")


class ArgumentError(ValueError):
    """Error for an argument that breaks a rule.

    Attributes
    ----------
    key : str
        Argument or parameter, dotted.
    rule : str
        Rule that the value must satisfy.
    value : object
        The value.
    index : tuple of int or None
        First index in a batch at which the rule is broken. None without a batch.

    Examples
    --------
    >>> try:
    ...     jv.follow(orbit, "amplitde", bounds=(0.0, 6.0))
    ... except jv.ArgumentError as error:
    ...     print(error.key)
    amplitde
    """

    def __init__(self, key: str, rule: str, value: Any, index: tuple[int, ...] | None = None) -> None:
        super().__init__(key, rule, value, index)
        self.key, self.rule, self.value, self.index = key, rule, value, index

    def __str__(self) -> str:
        location_text = "" if self.index is None else f" at index {self.index}"
        value_and_location = f"; got {format_value(self.value)}{location_text}"
        return (
            shorten_text(f"{shorten_text(self.key)}: {self.rule}", MAX_MESSAGE_LENGTH - len(value_and_location))
            + value_and_location
        )


class SceneError(ArgumentError):
    """Error for a scene, or a scene file, that breaks a rule.

    Attributes
    ----------
    key : str
        Parameter or key of the file, dotted.
    rule : str
        Rule that the value must satisfy.
    value : object
        The value.
    index : tuple of int or None
        First index in a batch at which the rule is broken. None without a batch.

    Examples
    --------
    >>> try:
    ...     scene.replace(restitution=1.2)
    ... except jv.SceneError as error:
    ...     print(error)
    restitution: must lie between 0 and 1; got 1.2
    """


# Decorates a public function: it refuses arguments that its annotations do not allow.
check_types = check_arguments(ArgumentError)


def convert_to_scene_errors(function: Callable[Params, Result]) -> Callable[Params, Result]:
    """Decorate a function that makes a scene, so that it raises `SceneError` in place of `ArgumentError`.

    Parameters
    ----------
    function : callable
        The function.

    Returns
    -------
    callable
        The decorated function.
    """

    @wraps(function)
    def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except ArgumentError as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError(*error.args) from None

    return wrapper


def set_fields(record, **values):
    """Set fields of a frozen dataclass, for its `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def shorten_text(text, max_length=80):
    """Put a text on one line of limited length.

    Parameters
    ----------
    text : object
        Text, or an object that converts to text.
    max_length : int, optional
        Largest number of characters.

    Returns
    -------
    str
        The line, which ends with "..." if it is cut.
    """
    single_line = " ".join(str(text)[: 100 * max_length].split())
    return single_line if len(single_line) <= max_length else f"{single_line[: max_length - 3]}..."


# Names of parameters and special points in papers and other programs.
SYNONYMS = {"A": "amplitude", "F": "amplitude", "force": "amplitude", "omega": "frequency", "Omega": "frequency"}
SYNONYMS |= {"gamma": "damping", "zeta": "damping", "damping_ratio": "damping", "R": "restitution", "r": "restitution"}
SYNONYMS |= {"LP": "SN", "LPC": "SN", "TR": "NS", "BPC": "BP"}


GAP_NAMES = ("gap", "clearance")  # not parameters; the positions of the walls are


def describe_choices(unknown_name, valid_names):
    """Return the end of an error message for an unknown name: the nearest valid name, and all valid names.

    Parameters
    ----------
    unknown_name : str
        The unknown name.
    valid_names : sequence of str
        The valid names.

    Returns
    -------
    str
        End of the message.
    """
    nearest_valid_name = nearest_name(unknown_name, valid_names)
    if unknown_name in GAP_NAMES:
        return f": vary left.position or right.position instead ({', '.join(valid_names)})"
    return f"{', perhaps ' + nearest_valid_name if nearest_valid_name else ''} ({', '.join(valid_names)})"


def nearest_name(unknown_name, valid_names):
    """Return the valid name that a misspelt name, or a name of another program, stands for.

    Parameters
    ----------
    unknown_name : str
        The unknown name.
    valid_names : sequence of str
        The valid names.

    Returns
    -------
    str or None
        The nearest name. None if no valid name is near.
    """
    if SYNONYMS.get(unknown_name) in valid_names:
        return SYNONYMS[unknown_name]
    close_matches = difflib.get_close_matches(shorten_text(unknown_name), valid_names, 1)
    return close_matches[0] if close_matches else None


def format_value(value):
    """Format a value on one short line.

    Parameters
    ----------
    value : object
        The value.

    Returns
    -------
    str
        At most 80 characters; shape and type for an array.
    """
    is_array = hasattr(value, "dtype")
    if is_array and np.ndim(value):
        return f"an array of shape {np.shape(value)} and type {value.dtype}"
    try:
        single_line = " ".join((str(value) if is_array else repr(value)).split())
    except ValueError:
        return "a whole number too long to show"
    except RecursionError:
        return "a value too deep to show"
    return shorten_text(single_line)


def is_traced(*values):
    """Return True if a transformation (jit, vmap, grad) traces any of the values.

    Parameters
    ----------
    *values : object
        The values.

    Returns
    -------
    bool
        True for at least one tracer.
    """
    return any(isinstance(value, jax.core.Tracer) for value in values)


def is_in_transformation():
    """Return True if the caller runs within a transformation (jit, vmap, grad), even without traced arguments."""
    outer_trace_state = get_opaque_trace_state()
    with jax.core.eval_context():
        return outer_trace_state != get_opaque_trace_state()


def host_only(alternative_advice: str) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]:
    """Decorate a function that runs on the host, so that a call under a transformation fails at once.

    Parameters
    ----------
    alternative_advice : str
        Alternative under a transformation, for the message.

    Returns
    -------
    callable
        The decorator. The decorated function raises `ArgumentError` if an argument is traced, if the call is within
        jit, vmap or grad, or if an argument does not match its annotation.
    """

    def decorator(function: Callable[Params, Result]) -> Callable[Params, Result]:
        check_argument_types = make_checker(function, ArgumentError)

        @wraps(function)
        def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
            tracers = _find_tracers(*args, *kwargs.values())
            if tracers or is_in_transformation():
                host_rule = (
                    "runs on the host and cannot be traced by jit, vmap or grad: call it outside; inside, "
                    + alternative_advice
                )
                raise ArgumentError(
                    function.__name__, host_rule, tracers[0] if tracers else "a call within a transformation"
                )
            check_argument_types(args, kwargs)
            return function(*args, **kwargs)

        return wrapper

    return decorator


def _find_tracers(*values):
    """Return the tracers within values, or an empty list if a value contains itself."""
    # Items of a dict in a list need no order of its keys.
    values_without_dicts = [list(item.items()) if isinstance(item, dict) else item for item in values]
    try:
        return [item for item in jax.tree.leaves(values_without_dicts) if is_traced(item)]
    except (RecursionError, SystemError):
        return []


def require_parameter(name, names, value):
    """Check that a name is a parameter of the scene.

    Parameters
    ----------
    name : str
        The name.
    names : sequence of str
        Names of the scene's parameters.
    value : object
        Value that the message shows.

    Raises
    ------
    ArgumentError
        If the name is not a parameter.
    """
    if not isinstance(name, str):
        raise ArgumentError("name", f"must be a parameter of this scene ({', '.join(names)})", name)
    if name not in names:
        raise ArgumentError(name, f"is not a parameter of this scene{describe_choices(name, names)}", value)


def require_choice(key, value, choices):
    """Check that a value is one of some names.

    Parameters
    ----------
    key : str
        Argument, for the message.
    value : str
        The value.
    choices : sequence of str
        Valid values.

    Returns
    -------
    str
        The value.

    Raises
    ------
    ArgumentError
        If the value is not one of the choices. The message suggests the nearest choice.
    """
    if isinstance(value, str) and value in choices:
        return value
    nearest_choice = nearest_name(value, choices) if isinstance(value, str) else None
    raise ArgumentError(
        key, f"must be one of {', '.join(choices)}{f', perhaps {nearest_choice}' if nearest_choice else ''}", value
    )


def make_name_tuple(key, names):
    """Return a name, or a sequence of names, as a tuple of names.

    Parameters
    ----------
    key : str
        Argument, for the message.
    names : str or sequence of str
        One name or several.

    Returns
    -------
    tuple of str
        The names.

    Raises
    ------
    ArgumentError
        If `names` is neither a string nor a sequence.
    """
    if isinstance(names, str):
        return (names,)
    try:
        return tuple(names)
    except TypeError:
        raise ArgumentError(key, "must be a name or a sequence of names", names) from None


def require_independent(*names):
    """Check that no parameter determines another: the hardness determines stiffness and damping of soft walls.

    Parameters
    ----------
    *names : str
        Names of the parameters.

    Raises
    ------
    ArgumentError
        If the names contain the hardness together with a stiffness or a damping of a wall.
    """
    if "hardness" in names and any(name.endswith((".stiffness", ".damping")) for name in names):
        raise ArgumentError(
            "names", "must not contain the hardness together with a stiffness or damping that it changes", names
        )


def require_rigid_or_soft(side, wall, scene_damping):
    """Check that a wall is rigid, or soft with either a stiffness or a contact law.

    A wall with a stiffness must have its own damping if the scene has none, because of a force.
    """
    for name in wall.contact_kind.refused:
        if getattr(wall, name) is not None:
            raise ArgumentError(f"{side}.{name}", wall.contact_kind.refusal, getattr(wall, name))
    if "damping" in wall.taken and scene_damping is None:
        raise ArgumentError(f"{side}.damping", "must be given for a soft wall in a scene with a force", None)


def require_spring_or_force(force, damping):
    """Check that either a damping or a user-defined force is given."""
    if (force is None) != (damping is None):
        return
    if damping is not None:
        raise ArgumentError("damping", "must not be given with a force, which replaces spring and damper", damping)
    raise ArgumentError("damping", "must be given, unless a force replaces spring and damper", None)


def require_spring(scene, caller):
    """Check that a scene has a linear spring and a damper, not a user-defined force.

    Parameters
    ----------
    scene : Scene
        The scene.
    caller : str
        Function, for the message.

    Raises
    ------
    ArgumentError
        If the scene has a user-defined force.
    """
    if not scene.flow_kind.is_linear:
        raise ArgumentError("force", f"must be None for {caller}, which needs spring and damper", scene.force.function)


def require_harmonic_drive(scene, caller):
    """Check that the drive is ``amplitude cos(frequency t)``, without further terms.

    Parameters
    ----------
    scene : Scene
        The scene.
    caller : str
        Function, for the message.

    Raises
    ------
    ArgumentError
        If the drive has further terms.
    """
    if scene.drive:
        harmonic_texts = ", ".join(f"harmonic {drive_term.harmonic}" for drive_term in scene.drive)
        raise ArgumentError(
            "drive", f"must be empty for {caller}, which needs a drive amplitude cos(frequency t)", harmonic_texts
        )


def require_single_scene(scene):
    """Check that a scene is single.

    Parameters
    ----------
    scene : Scene
        The scene.

    Raises
    ------
    ArgumentError
        If the scene is a batch.
    """
    if scene.shape:
        raise ArgumentError("scene", "must be a single scene, not a batch", f"shape {scene.shape}")


def check_walls_are_pair(walls):
    """Check that the walls are a pair (left, right) and return them as a tuple."""
    is_array = hasattr(walls, "dtype") and np.shape(walls) == (2,)
    if not is_array and (not isinstance(walls, tuple | list) or len(walls) != 2):
        raise ArgumentError("walls", "must be a pair (left, right), each a position, None or a Wall", walls)
    return tuple(walls)


def check_float_type(dtype):
    """Return the floating-point type of a scene.

    Parameters
    ----------
    dtype : dtype or None
        float32, float64 or None, which stands for float64.

    Returns
    -------
    dtype
        The type.

    Raises
    ------
    ArgumentError
        If `dtype` is none of these, or if it is float64 and double precision is disabled in JAX.
    """
    try:
        float_dtype = np.dtype(np.float64 if dtype is None else dtype)
    except (TypeError, ValueError, RecursionError):
        float_dtype = None
    if float_dtype not in (np.float32, np.float64):
        raise ArgumentError("dtype", "must be None, float32 or float64", dtype)
    if float_dtype == np.float64 and not jax.config.jax_enable_x64:
        advice_text = "call jax.config.update('jax_enable_x64', True) first, or use dtype=jnp.float32"
        raise ArgumentError("dtype", f"double precision is off in JAX: {advice_text}", float_dtype.name)
    return float_dtype


def check_real_array(key, value, dtype):
    """Convert a value to an array of real numbers.

    Parameters
    ----------
    key : str
        Argument, for the message.
    value : array_like
        The value.
    dtype : dtype
        Type of the array.

    Returns
    -------
    ndarray or tracer
        New array; for a tracer only its type is checked.

    Raises
    ------
    ArgumentError
        If the value is not real.
    """
    if is_traced(value):
        if value.dtype.kind not in "fiu":
            raise ArgumentError(key, "must be a real number", f"type {value.dtype}")
        return jnp.asarray(value, dtype)
    array = _to_numpy_or_none(value)
    if array is None or array.dtype.kind not in "fiu":
        raise ArgumentError(key, "must be a real number", value)
    if array.dtype == dtype:
        return array.copy()
    with np.errstate(over="ignore"):
        return array.astype(dtype)


def check_finite_array(key, value, dtype):
    """Convert a value to an array of finite real numbers.

    Parameters
    ----------
    key : str
        Argument, for the message.
    value : array_like
        The value.
    dtype : dtype
        Type of the array.

    Returns
    -------
    ndarray or tracer
        New array; the numbers of a tracer are not checked.

    Raises
    ------
    ArgumentError
        If the value is not real or not finite.
    """
    array = check_real_array(key, value, dtype)
    if not is_traced(array):
        require(key, "must be finite", array, np.isfinite(array))
    return array


def check_finite_float(key, value):
    """Convert a value to one finite float.

    Parameters
    ----------
    key : str
        Argument, for the message.
    value : array_like
        The value.

    Returns
    -------
    float
        The number.

    Raises
    ------
    ArgumentError
        If the value is not one finite number.
    """
    finite_value = check_finite_array(key, value, np.float64)
    if finite_value.ndim:
        raise ArgumentError(key, "must be one number", value)
    return float(finite_value)


def check_number_or_array(key, value, dtype):
    """Convert a number or an array of a scene to a finite array; refuse a list or a tuple."""
    if isinstance(value, list | tuple):
        advice = "write walls=(Wall(...), Wall(...)) for values of each wall, np.array([...]) for a batch"
        raise ArgumentError(key, f"must be a number or an array, not a {type(value).__name__}: {advice}", value)
    return check_finite_array(key, value, dtype)


def _to_numpy_or_none(value):
    """Convert a value to a NumPy array; return None if that is impossible."""
    if value is None or isinstance(value, str | bytes | bool):
        return None
    try:
        return np.asarray(value)
    except Exception:  # ragged and endless lists, and objects with their own conversions
        return None


def check_harmonic(key, value, minimum=1):
    """Check the type and the range of a harmonic and return it as an int (a bool is refused)."""
    is_integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_integer or not minimum <= value <= HIGHEST_HARMONIC:
        raise ArgumentError(key, f"must be a whole number from {minimum} to {HIGHEST_HARMONIC}", value)
    return int(value)


def require(key, rule, value, holds):
    """Check a rule for each element of an array.

    Parameters
    ----------
    key : str
        Argument, for the message.
    rule : str
        Rule, for the message.
    value : array_like
        The value.
    holds : array_like of bool
        True for each element that satisfies the rule. Broadcasts with `value`.

    Raises
    ------
    ArgumentError
        If the rule is broken; the message names the first offending element.
    """
    value, holds = np.broadcast_arrays(value, holds)
    if not holds.all():
        first_index = tuple(int(axis_index) for axis_index in np.argwhere(~holds)[0])
        raise ArgumentError(key, rule, value[first_index], first_index or None)


def require_broadcast(named_arrays):
    """Check that arrays broadcast together.

    Parameters
    ----------
    named_arrays : sequence of (str, array)
        Keys and arrays.

    Raises
    ------
    ArgumentError
        If an array does not broadcast with those before it.
    """
    if not any(array.shape for _, array in named_arrays):
        return
    common_shape = ()
    for key, array in named_arrays:
        try:
            common_shape = np.broadcast_shapes(common_shape, array.shape)
        except ValueError:
            raise ArgumentError(key, f"must broadcast with the shape {common_shape} of the others", array) from None


def check_whole_number(key, value, minimum, maximum=MAX_COUNT):
    """Check an integer argument and return it as an int (a bool is refused).

    Parameters
    ----------
    key : str
        Argument, for the message. The key "seed" has no upper limit.
    value : int
        The value.
    minimum : int
        Smallest valid value.
    maximum : int, optional
        Largest valid value.

    Returns
    -------
    int
        The value.

    Raises
    ------
    ArgumentError
        If the value is not an integer from `minimum` to `maximum`.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < minimum:
        raise ArgumentError(key, f"must be a whole number from {minimum} on", value)
    if value > maximum and key != "seed":
        raise ArgumentError(key, f"must be at most {maximum}", value)
    return int(value)
