"""Annotations of both packages held at run time: jaxtyping's shapes and dtypes, beartype's types.

A file's annotated functions and its records are checked as soon as the file has been imported. A function is checked in
its first calls in a process and then in some, what it returns alone where it refuses arguments itself ("Raises" in its
docstring), and not at all where it warns, as a warning names the caller's line. A record is checked where one of our
files makes one by its name, as often: what jax puts together from the leaves of a tree (lanes, placeholders) is not.
"""

import sys
from dataclasses import is_dataclass
from functools import wraps
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from inspect import isclass, isfunction, signature
from itertools import count
from typing import get_type_hints

from beartype import beartype
from beartype.door import is_bearable
from jaxtyping import jaxtyped

PACKAGES = ("jaxvibro", "continuation")
FIRST, EVERY = 100, 16  # calls that are all checked; of those after them one in so many
PLACEHOLDERS = (type(None), bool, int)  # of in_axes, static marks and the like, where a record has arrays


class Checked(MetaPathFinder):
    """Finds files as Python does, and checks those of the packages once they have been imported."""

    def find_spec(self, name, path, target=None):
        if name.split(".")[0] not in PACKAGES:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module
            spec.loader.exec_module = lambda module: (execute(module), check(module))[0]
        return spec


def check(module):
    """Have the module's own functions and records checked."""
    for name, one in list(vars(module).items()):
        if getattr(one, "__module__", None) != module.__name__:
            continue
        if is_record(one):
            check_record(one)
        elif isfunction(one) and one.__annotations__ and "warning" not in (one.__doc__ or ""):
            setattr(module, name, checked(one))


def checked(function):
    """The function, or property, held to its annotations."""
    if isinstance(function, property):
        return property(checked(function.fget), doc=function.__doc__)
    looked_at, calls = function, count()
    if "Raises" in (function.__doc__ or ""):
        plain = signature(function)

        @wraps(function)
        def looked_at(*args, **named):
            return function(*args, **named)

        free = [each.replace(annotation=each.empty) for each in plain.parameters.values()]
        looked_at.__signature__ = plain.replace(parameters=free)
    held = jaxtyped(looked_at, typechecker=beartype)

    @wraps(function)
    def found(*args, **named):
        return (held if is_checked(next(calls)) else function)(*args, **named)

    return found


def is_checked(call):
    """Whether the call of this number is."""
    return call < FIRST or call % EVERY == 0


def is_record(one):
    """Whether it is a class of named fields."""
    return isclass(one) and (is_dataclass(one) or hasattr(one, "_fields"))


def check_record(record):
    """Have a record's fields and methods checked."""
    make, hints, calls = ("__init__" if is_dataclass(record) else "__new__"), {}, count()
    original = getattr(record, make)

    @wraps(original)
    def made(first, /, *args, **named):
        found = original(first, *args, **named)
        maker = sys._getframe(1).f_globals.get("__name__", "") if is_checked(next(calls)) else ""
        if maker.split(".")[0] in PACKAGES and maker != "continuation.persistent_jit":
            _check_fields(record, first if found is None else found, hints)
        return found

    setattr(record, make, made)
    for name, one in list(vars(record).items()):
        annotated = one.fget if isinstance(one, property) else one
        if isfunction(annotated) and annotated.__annotations__ and not name.startswith("_"):
            setattr(record, name, checked(one))


def _check_fields(record, one, hints):
    hints.update(hints or get_type_hints(record, include_extras=True))
    with jaxtyped("context"):
        for name, hint in hints.items():
            value = getattr(one, name)
            if not isinstance(value, PLACEHOLDERS) and not is_bearable(value, hint):
                shape = f" of shape {value.shape}, {value.dtype}" if hasattr(value, "shape") else ""
                raise TypeError(f"{record.__module__}.{record.__name__}.{name}: {type(value)}{shape} is no {hint}")


def install():
    """Check what is imported from now on."""
    sys.meta_path.insert(0, Checked())
