"""Check the arguments of a call against the annotations of the function, before the function runs.

`check_arguments` decorates a function to raise an error that names the argument, the rule and the value. Only types are
checked. The function itself checks ranges and names.
"""

import collections.abc
import inspect
import os
import types
import typing
from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import numpy as np
from jaxtyping import AbstractArray

Params = ParamSpec("Params")
Result = TypeVar("Result")
ErrorFactory = Callable[[str, str, Any], Exception]

LARGEST_FLOAT = float(np.finfo(float).max)
NUMBER_DTYPE_KINDS = "fiu"  # kinds of NumPy types
UNION_TYPES = (typing.Union, types.UnionType)


class ArgumentType(NamedTuple):
    """Type of an argument.

    Parameters
    ----------
    accepts : callable
        Returns True for values of this type.
    description : str
        Noun phrase for messages.
    find_invalid : callable, optional
        Returns (index as text, description of the rule, entry) of the first invalid entry of a value, or None.
    """

    accepts: Callable[[Any], bool]
    description: str
    find_invalid: Callable[[Any], tuple[str, str, Any] | None] = lambda _: None


def is_number(value: Any) -> bool:
    """Return True for a real number.

    Real numbers are Python and NumPy numbers, and real arrays and tracers without axes. Python integers must lie within
    the range of floats.
    """
    if isinstance(value, bool | np.bool_):
        return False
    if isinstance(value, int):
        return abs(value) <= LARGEST_FLOAT
    if isinstance(value, float | np.floating | np.integer):
        return True
    return isinstance(value, np.ndarray | jax.Array) and value.ndim == 0 and value.dtype.kind in NUMBER_DTYPE_KINDS


def is_integer(value: Any) -> bool:
    """Return True for an integer that is not a bool."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_path(value: Any) -> bool:
    """Return True for a valid file path."""
    try:
        path_text = os.fspath(value)
    except TypeError:
        return False
    return isinstance(path_text, str) and "\0" not in path_text and path_text != ""


def is_array(value: Any, n_axes: int | None = None) -> bool:
    """Return True for a real array with `n_axes` axes.

    Lists and tuples must convert to a real array. A real number counts as an array without axes. None allows any number
    of axes.
    """
    if isinstance(value, list | tuple):
        try:
            value = np.asarray(value)
        except Exception:  # ragged or endless lists, and objects with their own conversions
            return False
    if isinstance(value, np.ndarray | jax.Array):
        return value.dtype.kind in NUMBER_DTYPE_KINDS and n_axes in (None, value.ndim)
    return n_axes in (None, 0) and is_number(value)


def is_sequence(value: Any) -> bool:
    """Return True for a collection with a length: a list, tuple, set or array, but not a string or a mapping."""
    if isinstance(value, str | bytes | collections.abc.Mapping):
        return False
    if isinstance(value, np.ndarray | jax.Array):
        return value.ndim > 0
    return isinstance(value, collections.abc.Collection)


ANYTHING = ArgumentType(lambda _: True, "anything")
PLAIN_TYPES = {
    type(None): ArgumentType(lambda value: value is None, "None"),
    bool: ArgumentType(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    int: ArgumentType(is_integer, "a whole number"),
    float: ArgumentType(is_number, "a real number"),
    str: ArgumentType(lambda value: isinstance(value, str), "a string"),
}
PATH = ArgumentType(is_path, "a path")
SEQUENCE_TYPES = (collections.abc.Sequence, collections.abc.Collection, list)


def argument_type(hint: Any) -> ArgumentType:
    """Return the `ArgumentType` of an annotation; `ANYTHING` for unsupported annotations."""
    if hint in PLAIN_TYPES:
        return PLAIN_TYPES[hint]
    generic_origin, hint_args = typing.get_origin(hint), typing.get_args(hint)
    if generic_origin in UNION_TYPES:
        return _union_type(hint_args)
    if generic_origin in SEQUENCE_TYPES:
        return _sequence_type(argument_type(hint_args[0]))
    if generic_origin is collections.abc.Mapping:
        return _mapping_type(*map(argument_type, hint_args))
    if generic_origin is tuple:
        return _tuple_type(hint_args)
    if generic_origin is collections.abc.Callable:
        return ArgumentType(callable, "a function")
    if generic_origin is collections.abc.Iterable:
        return _iterable_type(argument_type(hint_args[0]))
    if not inspect.isclass(hint) or hint in (Any, object):
        return ANYTHING
    if issubclass(hint, AbstractArray):
        return _array_type(hint)
    if issubclass(hint, np.ndarray | jax.Array):
        return ArgumentType(lambda value: is_array(value) and not is_number(value), "an array of numbers")
    indefinite_article = "an" if hint.__name__[0] in "AEIOU" else "a"
    return ArgumentType(_make_instance_test(hint), f"{indefinite_article} {hint.__name__}")


def _make_instance_test(hint):
    """Make a function that returns True for instances of a class, or for objects with all members of a protocol."""
    if not getattr(hint, "_is_protocol", False):
        return lambda value: isinstance(value, hint)
    public_members = {name: member_value for name, member_value in vars(hint).items() if not name.startswith("_")}
    member_names = [
        name
        for name, member_value in public_members.items()
        if inspect.isfunction(member_value) or isinstance(member_value, property)
    ]

    def has_members(value):
        return not isinstance(value, type) and all(inspect.getattr_static(value, name, None) for name in member_names)

    return has_members


def _union_type(hints):
    if any(typing.get_origin(hint) is os.PathLike for hint in hints):
        non_path_hints = [hint for hint in hints if hint is not str and typing.get_origin(hint) is not os.PathLike]
        arg_types = [PATH, *map(argument_type, non_path_hints)]
    else:
        arg_types = [argument_type(hint) for hint in hints if hint is not np.number]
    arg_types.sort(key=lambda arg_type: arg_type.description == "None")
    if ANYTHING in arg_types:
        return ANYTHING
    descriptions = dict.fromkeys(arg_type.description for arg_type in arg_types)
    if "a real number or an array" in descriptions:
        descriptions = {
            description: None for description in descriptions if description not in ("a real number", "a whole number")
        }
    elif "a real number" in descriptions:
        descriptions.pop("a whole number", None)

    def find_invalid(value):
        return next(filter(None, (arg_type.find_invalid(value) for arg_type in arg_types)), None)

    return ArgumentType(
        lambda value: any(arg_type.accepts(value) for arg_type in arg_types), " or ".join(descriptions), find_invalid
    )


def _sequence_type(entry_type):
    if entry_type.description == "a real number":
        return ArgumentType(lambda value: is_array(value, 1), "a sequence of real numbers")

    def accepts(value):
        return is_sequence(value) and all(map(entry_type.accepts, value))

    def find_invalid(value):
        if not isinstance(value, list | tuple):
            return None
        return next(
            (
                (f"[{index}]", entry_type.description, entry)
                for index, entry in enumerate(value)
                if not entry_type.accepts(entry)
            ),
            None,
        )

    return ArgumentType(accepts, f"a list of {_pluralise(entry_type.description)}", find_invalid)


def _iterable_type(entry_type):
    """Return the `ArgumentType` of iterables; the elements of iterators are not checked."""
    sequence_type = _sequence_type(entry_type)
    return ArgumentType(
        lambda value: isinstance(value, collections.abc.Iterator) or sequence_type.accepts(value),
        sequence_type.description,
        sequence_type.find_invalid,
    )


def _mapping_type(key_type, value_type):
    def accepts(mapping):
        if not isinstance(mapping, collections.abc.Mapping):
            return False
        return all(key_type.accepts(entry) for entry in mapping) and all(
            value_type.accepts(entry) for entry in mapping.values()
        )

    def find_invalid(mapping):
        if not isinstance(mapping, collections.abc.Mapping) or not all(key_type.accepts(entry) for entry in mapping):
            return None
        return next(
            (
                (f".{name}", value_type.description, entry)
                for name, entry in mapping.items()
                if not value_type.accepts(entry)
            ),
            None,
        )

    key_text = "functions" if key_type is ANYTHING else _pluralise(key_type.description)
    return ArgumentType(accepts, f"a mapping from {key_text} to {_pluralise(value_type.description)}", find_invalid)


def _tuple_type(hints):
    if hints == ((),) or not hints:
        return ArgumentType(lambda value: is_sequence(value) and not len(value), "an empty tuple")
    if hints[-1] is Ellipsis:
        return _sequence_type(argument_type(hints[0]))
    arg_types = [argument_type(hint) for hint in hints]

    def accepts(value):
        if isinstance(value, set | frozenset) or not is_sequence(value) or len(value) != len(arg_types):
            return False
        return all(arg_type.accepts(entry) for arg_type, entry in zip(arg_types, value, strict=True))

    if len({arg_type.description for arg_type in arg_types}) == 1:
        return ArgumentType(
            accepts, f"{'a pair' if len(arg_types) == 2 else len(arg_types)} of {_pluralise(arg_types[0].description)}"
        )
    return ArgumentType(accepts, f"({', '.join(arg_type.description for arg_type in arg_types)})")


def _array_type(hint):
    dims_text = hint.dim_str.strip()
    n_axes = 0 if not dims_text else 1 if dims_text.isidentifier() else None
    description = {0: "a real number", 1: "a sequence of real numbers"}.get(n_axes, "a real number or an array")
    if not any(str(dtype).startswith(("float", "int", "uint")) for dtype in hint.dtypes):
        return ANYTHING
    return ArgumentType(lambda value: is_array(value, n_axes), description)


def _pluralise(description):
    """Return a description in the plural: "strings or lists of numbers" for "a string or a list of numbers"."""
    plural_alternatives = []
    for alternative in description.split(" or "):
        noun, _, complement = alternative.removeprefix("an ").removeprefix("a ").partition(" of ")
        noun = noun if noun.endswith(("s", "None")) else f"{noun}es" if noun.endswith("ch") else f"{noun}s"
        plural_alternatives.append(f"{noun} of {complement}" if complement else noun)
    return " or ".join(plural_alternatives)


def argument_types_of(function: Callable[..., Any]) -> dict[str, ArgumentType]:
    """Return {parameter: `ArgumentType`} of a function, without parameters that accept anything."""
    hints = typing.get_type_hints(function, include_extras=True)
    arg_types = {name: argument_type(hint) for name, hint in hints.items() if name != "return"}
    return {name: arg_type for name, arg_type in arg_types.items() if arg_type is not ANYTHING}


def make_checker(
    function: Callable[..., Any],
    make_error: ErrorFactory,
    selects_parameter: Callable[[inspect.Parameter], bool] = lambda _: True,
    **overrides: ArgumentType,
) -> Callable[[tuple[Any, ...], dict[str, Any]], None]:
    """Make a function that checks the arguments of an annotated function.

    Parameters
    ----------
    function : callable
        Annotated function.
    make_error : callable
        Makes the error from the argument's name, the rule and the value.
    selects_parameter : callable, optional
        Returns True for the parameters to check.
    **overrides : ArgumentType
        Types by name of the parameter, which replace those of the annotations.

    Returns
    -------
    callable
        Function of (args, kwargs) that raises for the first invalid argument.
    """
    parameters = inspect.signature(function).parameters
    all_parameter_names, arg_types = tuple(parameters), None

    def check(args, kwargs):
        nonlocal arg_types
        if arg_types is None:  # evaluated at the first call, because annotations may contain forward references
            all_types = argument_types_of(function) | {
                name: arg_type for name, arg_type in overrides.items() if name in parameters
            }
            arg_types = {name: arg_type for name, arg_type in all_types.items() if selects_parameter(parameters[name])}
        for name, value in (*zip(all_parameter_names, args, strict=False), *kwargs.items()):
            arg_type = arg_types.get(name)
            if arg_type is not None and not arg_type.accepts(value):
                entry_suffix, description, invalid_value = arg_type.find_invalid(value) or (
                    "",
                    arg_type.description,
                    value,
                )
                raise make_error(name + entry_suffix, f"must be {description}", invalid_value)

    return check


def check_arguments(
    make_error: ErrorFactory,
    selects_parameter: Callable[[inspect.Parameter], bool] = lambda _: True,
    **overrides: ArgumentType,
) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]:
    """Make a decorator that checks the arguments of a function.

    Parameters
    ----------
    make_error : callable
        Makes the error from the argument's name, the rule and the value.
    selects_parameter : callable, optional
        Returns True for the parameters to check.
    **overrides : ArgumentType
        Types by name of the parameter, which replace those of the annotations.

    Returns
    -------
    callable
        The decorator.
    """

    def decorate(function: Callable[Params, Result]) -> Callable[Params, Result]:
        check = make_checker(function, make_error, selects_parameter, **overrides)

        @wraps(function)
        def wrapper(*args: Params.args, **kwargs: Params.kwargs) -> Result:
            check(args, kwargs)
            return function(*args, **kwargs)

        return wrapper

    return decorate
