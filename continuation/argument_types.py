"""Check the arguments of a call against the annotations of the function, before any work.

Annotations say what a function takes; `checked` makes a function keep to them, with an error that names the argument,
the rule and the value. A value that passes has the right type only: the function itself checks ranges and names.
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

Given = ParamSpec("Given")
Found = TypeVar("Found")
Refuse = Callable[[str, str, Any], Exception]

LARGEST = float(np.finfo(float).max)
NUMBERS, WHOLE = "fiu", "iu"  # kinds of NumPy's types
UNIONS = (typing.Union, types.UnionType)


class Kind(NamedTuple):
    """A kind of value.

    holds: whether a value is of this kind; words: what it is called in a message; part: the first entry of a value that
    is not of its kind, as (its place, words, the entry), or None.
    """

    holds: Callable[[Any], bool]
    words: str
    part: Callable[[Any], tuple[str, str, Any] | None] = lambda _: None


def is_number(value: Any) -> bool:
    """Return True for one real number: a Python number that a float can hold, or an array or tracer without axes."""
    if isinstance(value, bool | np.bool_):
        return False
    if isinstance(value, int):
        return abs(value) <= LARGEST
    if isinstance(value, float | np.floating | np.integer):
        return True
    return isinstance(value, np.ndarray | jax.Array) and value.ndim == 0 and value.dtype.kind in NUMBERS


def is_whole(value: Any) -> bool:
    """Return True for an integer that is not a bool."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_path(value: Any) -> bool:
    """Return True for a valid file path."""
    try:
        text = os.fspath(value)
    except TypeError:
        return False
    return isinstance(text, str) and "\0" not in text and text != ""


def is_array(value: Any, axes: int | None = None) -> bool:
    """Return True for a real array, or a list that converts to one, with the given number of axes (None: any)."""
    if isinstance(value, list | tuple):
        try:
            value = np.asarray(value)
        except Exception:  # ragged and endless lists, and objects with conversions of their own
            return False
    if isinstance(value, np.ndarray | jax.Array):
        return value.dtype.kind in NUMBERS and axes in (None, value.ndim)
    return axes in (None, 0) and is_number(value)


def is_sequence(value: Any) -> bool:
    """Return True for a collection with a length: a list, tuple, set or array, but not a string or a mapping."""
    if isinstance(value, str | bytes | collections.abc.Mapping):
        return False
    if isinstance(value, np.ndarray | jax.Array):
        return value.ndim > 0
    return isinstance(value, collections.abc.Collection)


ANYTHING = Kind(lambda _: True, "anything")
PLAIN = {
    type(None): Kind(lambda value: value is None, "None"),
    bool: Kind(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    int: Kind(is_whole, "a whole number"),
    float: Kind(is_number, "a real number"),
    str: Kind(lambda value: isinstance(value, str), "a string"),
}
PATH = Kind(is_path, "a path")
SEQUENCES = (collections.abc.Sequence, collections.abc.Collection, list)


def kind_of(hint: Any) -> Kind:
    """The `Kind` that an annotation describes; `ANYTHING` for annotations of other forms."""
    if hint in PLAIN:
        return PLAIN[hint]
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in UNIONS:
        return _any_of(parts)
    if origin in SEQUENCES:
        return _sequence_of(kind_of(parts[0]))
    if origin is collections.abc.Mapping:
        return _mapping_of(*map(kind_of, parts))
    if origin is tuple:
        return _tuple_of(parts)
    if origin is collections.abc.Callable:
        return Kind(callable, "a function")
    if origin is collections.abc.Iterable:
        return _iterable_of(kind_of(parts[0]))
    if not inspect.isclass(hint) or hint in (Any, object):
        return ANYTHING
    if issubclass(hint, AbstractArray):
        return _array_of(hint)
    if issubclass(hint, np.ndarray | jax.Array):
        return Kind(lambda value: is_array(value) and not is_number(value), "an array of numbers")
    article = "an" if hint.__name__[0] in "AEIOU" else "a"
    return Kind(_instances_of(hint), f"{article} {hint.__name__}")


def _instances_of(hint):
    """Make a function that returns True for instances of a class, or for objects with all members of a protocol."""
    if not getattr(hint, "_is_protocol", False):
        return lambda value: isinstance(value, hint)
    public = {name: part for name, part in vars(hint).items() if not name.startswith("_")}
    members = [name for name, part in public.items() if inspect.isfunction(part) or isinstance(part, property)]

    def has_members(value):
        return not isinstance(value, type) and all(inspect.getattr_static(value, name, None) for name in members)

    return has_members


def _any_of(hints):
    if any(typing.get_origin(hint) is os.PathLike for hint in hints):
        others = [hint for hint in hints if hint is not str and typing.get_origin(hint) is not os.PathLike]
        kinds = [PATH, *map(kind_of, others)]
    else:
        kinds = [kind_of(hint) for hint in hints if hint is not np.number]
    kinds.sort(key=lambda kind: kind.words == "None")
    if ANYTHING in kinds:
        return ANYTHING
    words = dict.fromkeys(kind.words for kind in kinds)
    if "a real number or an array" in words:
        words = {word: None for word in words if word not in ("a real number", "a whole number")}
    elif "a real number" in words:
        words.pop("a whole number", None)

    def part(value):
        return next(filter(None, (kind.part(value) for kind in kinds)), None)

    return Kind(lambda value: any(kind.holds(value) for kind in kinds), " or ".join(words), part)


def _sequence_of(kind):
    if kind.words == "a real number":
        return Kind(lambda value: is_array(value, 1), "a row of real numbers")

    def holds(value):
        return is_sequence(value) and all(map(kind.holds, value))

    def part(value):
        if not isinstance(value, list | tuple):
            return None
        return next(((f"[{k}]", kind.words, each) for k, each in enumerate(value) if not kind.holds(each)), None)

    return Kind(holds, f"a list of {_plural(kind.words)}", part)


def _iterable_of(kind):
    """Describe iterables like `_sequence_of`; the elements of iterators are not checked."""
    some = _sequence_of(kind)
    return Kind(lambda value: isinstance(value, collections.abc.Iterator) or some.holds(value), some.words, some.part)


def _mapping_of(key, value):
    def holds(given):
        if not isinstance(given, collections.abc.Mapping):
            return False
        return all(key.holds(each) for each in given) and all(value.holds(each) for each in given.values())

    def part(given):
        if not isinstance(given, collections.abc.Mapping) or not all(key.holds(each) for each in given):
            return None
        return next(((f".{name}", value.words, each) for name, each in given.items() if not value.holds(each)), None)

    named = "functions" if key is ANYTHING else _plural(key.words)
    return Kind(holds, f"a mapping from {named} to {_plural(value.words)}", part)


def _tuple_of(hints):
    if hints == ((),) or not hints:
        return Kind(lambda value: is_sequence(value) and not len(value), "an empty tuple")
    if hints[-1] is Ellipsis:
        return _sequence_of(kind_of(hints[0]))
    kinds = [kind_of(hint) for hint in hints]

    def holds(value):
        if isinstance(value, set | frozenset) or not is_sequence(value) or len(value) != len(kinds):
            return False
        return all(kind.holds(each) for kind, each in zip(kinds, value, strict=True))

    if len({kind.words for kind in kinds}) == 1:
        return Kind(holds, f"{'a pair' if len(kinds) == 2 else len(kinds)} of {_plural(kinds[0].words)}")
    return Kind(holds, f"({', '.join(kind.words for kind in kinds)})")


def _array_of(hint):
    text = hint.dim_str.strip()
    axes = 0 if not text else 1 if text.isidentifier() else None
    words = {0: "a real number", 1: "a row of real numbers"}.get(axes, "a real number or an array")
    if not any(str(dtype).startswith(("float", "int", "uint")) for dtype in hint.dtypes):
        return ANYTHING
    return Kind(lambda value: is_array(value, axes), words)


def _plural(words):
    """Kinds in the plural: "strings or lists of numbers" of "a string or a list of numbers"."""
    found = []
    for each in words.split(" or "):
        noun, _, rest = each.removeprefix("an ").removeprefix("a ").partition(" of ")
        noun = noun if noun.endswith(("s", "None")) else f"{noun}es" if noun.endswith("ch") else f"{noun}s"
        found.append(f"{noun} of {rest}" if rest else noun)
    return " or ".join(found)


def kinds_of(function: Callable[..., Any]) -> dict[str, Kind]:
    """{parameter: its `Kind`} of a function, those that take anything left out."""
    hints = typing.get_type_hints(function, include_extras=True)
    found = {name: kind_of(hint) for name, hint in hints.items() if name != "return"}
    return {name: kind for name, kind in found.items() if kind is not ANYTHING}


def checker(
    function: Callable[..., Any],
    refuse: Refuse,
    of: Callable[[inspect.Parameter], bool] = lambda _: True,
    **more: Kind,
) -> Callable[[tuple[Any, ...], dict[str, Any]], None]:
    """Make the check of a function's arguments: a function of (args, named) that raises for the first one refused.

    Parameters
    ----------
    function : callable
        Annotated function.
    refuse : callable
        Makes the error to raise from the argument's name, the rule and the value.
    of : callable, optional
        Selects the parameters to check.
    **more : Kind
        Kinds of some parameters in place of those that their annotations describe.
    """
    parameters = inspect.signature(function).parameters
    positions, kinds = tuple(parameters), None

    def check(args, named):
        nonlocal kinds
        if kinds is None:  # at the first call, as annotations may name what is defined further below
            every = kinds_of(function) | {name: kind for name, kind in more.items() if name in parameters}
            kinds = {name: kind for name, kind in every.items() if of(parameters[name])}
        for name, value in (*zip(positions, args, strict=False), *named.items()):
            kind = kinds.get(name)
            if kind is not None and not kind.holds(value):
                place, words, found = kind.part(value) or ("", kind.words, value)
                raise refuse(name + place, f"must be {words}", found)

    return check


def checked(
    refuse: Refuse, of: Callable[[inspect.Parameter], bool] = lambda _: True, **more: Kind
) -> Callable[[Callable[Given, Found]], Callable[Given, Found]]:
    """Decorate a function to refuse arguments that its annotations do not allow; the arguments are as of `checker`."""

    def decorated(function: Callable[Given, Found]) -> Callable[Given, Found]:
        check = checker(function, refuse, of, **more)

        @wraps(function)
        def called(*args: Given.args, **named: Given.kwargs) -> Found:
            check(args, named)
            return function(*args, **named)

        return called

    return decorated
