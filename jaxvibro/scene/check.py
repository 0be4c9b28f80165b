"""Check arguments and scenes; each error is one line that names the key, the rule and the value."""

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
        location = "" if self.index is None else f" at index {self.index}"
        suffix = f"; got {format_value(self.value)}{location}"
        return shorten(f"{shorten(self.key)}: {self.rule}", MAX_MESSAGE_LENGTH - len(suffix)) + suffix


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


def raise_scene_errors(function: Callable[Params, Result]) -> Callable[Params, Result]:
    """Decorate a function that makes a scene, so that its argument errors are `SceneError`.

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


def shorten(text, max_length=80):
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
    line = " ".join(str(text)[: 100 * max_length].split())
    return line if len(line) <= max_length else f"{line[: max_length - 3]}..."


# Names of parameters and special points in papers and other programs.
SYNONYMS = {"A": "amplitude", "F": "amplitude", "force": "amplitude", "omega": "frequency", "Omega": "frequency"}
SYNONYMS |= {"gamma": "damping", "zeta": "damping", "damping_ratio": "damping", "R": "restitution", "r": "restitution"}
SYNONYMS |= {"LP": "SN", "LPC": "SN", "TR": "NS", "BPC": "BP"}


GAP_NAMES = ("gap", "clearance")  # not parameters; the positions of the walls are


def describe_choices(name, names):
    """Return the end of the rule for an unknown name: the nearest valid name, and all valid names.

    Parameters
    ----------
    name : str
        The unknown name.
    names : sequence of str
        The valid names.

    Returns
    -------
    str
        End of the rule.
    """
    suggestion = nearest_name(name, names)
    if name in GAP_NAMES:
        return f": vary left.position or right.position instead ({', '.join(names)})"
    return f"{', perhaps ' + suggestion if suggestion else ''} ({', '.join(names)})"


def nearest_name(name, names):
    """Return the valid name that a misspelt name, or a name of another program, stands for.

    Parameters
    ----------
    name : str
        The unknown name.
    names : sequence of str
        The valid names.

    Returns
    -------
    str or None
        The nearest name, None without one.
    """
    if SYNONYMS.get(name) in names:
        return SYNONYMS[name]
    matches = difflib.get_close_matches(shorten(name), names, 1)
    return matches[0] if matches else None


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
        line = " ".join((str(value) if is_array else repr(value)).split())
    except ValueError:
        return "a whole number too long to show"
    except RecursionError:
        return "a value too deep to show"
    return shorten(line)


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


def is_transformed():
    """Return True within a transformation (jit, vmap, grad), for any arguments."""
    trace_state = get_opaque_trace_state()
    with jax.core.eval_context():
        return trace_state != get_opaque_trace_state()


def host_only(alternative: str) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]:
    """Decorate a function that runs on the host, so that a call under a transformation fails at once.

    Parameters
    ----------
    alternative : str
        Alternative under a transformation, for the message.

    Returns
    -------
    callable
        The decorator. The decorated function raises `ArgumentError` if an argument is traced, if it is called within
        jit, vmap or grad, and if an argument does not match its annotation.
    """

    def decorator(function: Callable[Params, Result]) -> Callable[Params, Result]:
        require_types = make_checker(function, ArgumentError)

        @wraps(function)
        def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
            tracers = _find_tracers(*args, *kwargs.values())
            if tracers or is_transformed():
                rule = (
                    "runs on the host and cannot be traced by jit, vmap or grad: call it outside; inside, "
                    + alternative
                )
                raise ArgumentError(
                    function.__name__, rule, tracers[0] if tracers else "a call within a transformation"
                )
            require_types(args, kwargs)
            return function(*args, **kwargs)

        return wrapper

    return decorator


def _find_tracers(*values):
    """Return the tracers within values; none for a list that contains itself."""
    # Items of a dict in a list need no order of its keys.
    flat_values = [list(item.items()) if isinstance(item, dict) else item for item in values]
    try:
        return [item for item in jax.tree.leaves(flat_values) if is_traced(item)]
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
        Value for the message.

    Raises
    ------
    ArgumentError
        If it is not.
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
        If it is not; the message suggests the nearest valid value.
    """
    if isinstance(value, str) and value in choices:
        return value
    suggestion = nearest_name(value, choices) if isinstance(value, str) else None
    raise ArgumentError(
        key, f"must be one of {', '.join(choices)}{f', perhaps {suggestion}' if suggestion else ''}", value
    )


def name_tuple(key, names):
    """Return names as a tuple; a string is one name.

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
        If `names` is neither.
    """
    if isinstance(names, str):
        return (names,)
    try:
        return tuple(names)
    except TypeError:
        raise ArgumentError(key, "must be a name or a sequence of names", names) from None


def require_independent(*names):
    """Check that no parameter changes another one, as the hardness changes stiffness and damping of soft walls.

    Parameters
    ----------
    *names : str
        Names of the parameters.

    Raises
    ------
    ArgumentError
        If the hardness is beside a parameter that it changes.
    """
    if "hardness" in names and any(name.endswith((".stiffness", ".damping")) for name in names):
        raise ArgumentError(
            "names", "must not contain the hardness together with a stiffness or damping that it changes", names
        )


def require_one_wall_kind(side, wall):
    """Check that a wall is either rigid or soft, and soft by either stiffness or a law."""
    for name in ("restitution", "stiffness", "damping") if wall.law is not None else ():
        if getattr(wall, name) is not None:
            raise ArgumentError(
                f"{side}.{name}", "must not be given for a wall with a contact law", getattr(wall, name)
            )
    if wall.law is not None:
        return
    if wall.stiffness is not None and wall.restitution is not None:
        raise ArgumentError(f"{side}.restitution", "must not be given for a wall with stiffness", wall.restitution)
    if wall.stiffness is None and wall.damping is not None:
        raise ArgumentError(f"{side}.damping", "must not be given for a wall without stiffness", wall.damping)


def require_own_damping(side, wall, force):
    """Check that a soft wall beside a force has its own damping, since the scene has none."""
    if force is not None and wall.stiffness is not None and wall.damping is None:
        raise ArgumentError(f"{side}.damping", "must be given for a soft wall in a scene with a force", None)


def require_spring_or_force(force, damping):
    """Check that either a damping or a user-defined force is given."""
    if force is not None and damping is not None:
        raise ArgumentError("damping", "must not be given with a force, which replaces spring and damper", damping)
    if force is None and damping is None:
        raise ArgumentError("damping", "must be given, unless a force replaces spring and damper", None)


def require_spring(scene, caller):
    """Check that a scene has the spring and the damper, for functions that need them.

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
    if scene.force is not None:
        raise ArgumentError("force", f"must be None for {caller}, which needs spring and damper", scene.force.function)


def require_one_harmonic(scene, caller):
    """Check that the drive has one harmonic, for functions that need ``amplitude cos(frequency t)``.

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
        harmonics = ", ".join(f"harmonic {term.harmonic}" for term in scene.drive)
        raise ArgumentError(
            "drive", f"must be empty for {caller}, which needs a drive amplitude cos(frequency t)", harmonics
        )


def require_single(scene):
    """Check that a scene is single.

    Parameters
    ----------
    scene : Scene
        The scene.

    Raises
    ------
    ArgumentError
        If it is a batch.
    """
    if scene.shape:
        raise ArgumentError("scene", "must be a single scene, not a batch", f"shape {scene.shape}")


def wall_pair(walls):
    """Return the walls as a tuple (left, right), from a tuple, a list or an array of two positions."""
    is_array = hasattr(walls, "dtype") and np.shape(walls) == (2,)
    if not is_array and (not isinstance(walls, tuple | list) or len(walls) != 2):
        raise ArgumentError("walls", "must be a pair (left, right), each a position, None or a Wall", walls)
    return tuple(walls)


def float_type(dtype):
    """Return the floating-point type of a scene.

    Parameters
    ----------
    dtype : dtype or None
        float32, float64 or None, which is float64.

    Returns
    -------
    dtype
        The type.

    Raises
    ------
    ArgumentError
        If it is another type, or float64 and JAX has it off.
    """
    try:
        float_dtype = np.dtype(np.float64 if dtype is None else dtype)
    except (TypeError, ValueError, RecursionError):
        float_dtype = None
    if float_dtype not in (np.float32, np.float64):
        raise ArgumentError("dtype", "must be None, float32 or float64", dtype)
    if float_dtype == np.float64 and not jax.config.jax_enable_x64:
        advice = "call jax.config.update('jax_enable_x64', True) first, or use dtype=jnp.float32"
        raise ArgumentError("dtype", f"double precision is off in JAX: {advice}", float_dtype.name)
    return float_dtype


def real_array(key, value, dtype):
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
    array = _plain_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise ArgumentError(key, "must be a real number", value)
    if array.dtype == dtype:
        return array.copy()
    with np.errstate(over="ignore"):
        return array.astype(dtype)


def finite_array(key, value, dtype):
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
    array = real_array(key, value, dtype)
    if not is_traced(array):
        require(key, "must be finite", array, np.isfinite(array))
    return array


def finite_float(key, value):
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
    array = finite_array(key, value, np.float64)
    if array.ndim:
        raise ArgumentError(key, "must be one number", value)
    return float(array)


def scene_quantity(key, value, dtype):
    """Convert a quantity of a scene to a finite array; refuse a list, which is neither a batch nor a pair of walls."""
    if isinstance(value, list | tuple):
        advice = "write walls=(Wall(...), Wall(...)) for values of each wall, np.array([...]) for a batch"
        raise ArgumentError(key, f"must be a number or an array, not a {type(value).__name__}: {advice}", value)
    return finite_array(key, value, dtype)


def _plain_array(value):
    """Return a NumPy array of a value, or None if it is none."""
    if value is None or isinstance(value, str | bytes | bool):
        return None
    try:
        return np.asarray(value)
    except Exception:  # ragged and endless lists, and objects with their own conversions
        return None


def harmonic_number(key, value, minimum=1):
    """Return a harmonic as an int after a check of its range (a bool is refused)."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or not minimum <= value <= HIGHEST_HARMONIC:
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
        index = tuple(int(i) for i in np.argwhere(~holds)[0])
        raise ArgumentError(key, rule, value[index], index or None)


def require_broadcast(leaves):
    """Check that arrays broadcast together.

    Parameters
    ----------
    leaves : sequence of (str, array)
        Keys and arrays.

    Raises
    ------
    ArgumentError
        If an array does not broadcast with those before it.
    """
    if not any(leaf.shape for _, leaf in leaves):
        return
    shape = ()
    for key, leaf in leaves:
        try:
            shape = np.broadcast_shapes(shape, leaf.shape)
        except ValueError:
            raise ArgumentError(key, f"must broadcast with the shape {shape} of the others", leaf) from None


def whole_number(key, value, minimum):
    """Return an integer argument as an int (a bool is refused).

    Parameters
    ----------
    key : str
        Argument, for the message. The key "seed" has no upper limit.
    value : int
        The value.
    minimum : int
        Smallest valid value.

    Returns
    -------
    int
        The value.

    Raises
    ------
    ArgumentError
        If the value is not an integer from `minimum` to `MAX_COUNT`.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < minimum:
        raise ArgumentError(key, f"must be a whole number from {minimum} on", value)
    if value > MAX_COUNT and key != "seed":
        raise ArgumentError(key, f"must be at most {MAX_COUNT}", value)
    return int(value)
