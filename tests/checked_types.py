"""Annotations of both packages, checked at run time: shapes and dtypes by jaxtyping, types by beartype.

The annotated functions and the records of a file are checked as soon as it has been imported: in the first calls of a
process, then in some. Of a function that refuses arguments itself ("Raises" in its docstring) only the result is
checked. A function that warns is not checked, as a warning names the line of the caller. A record is checked where a
file of the packages constructs it by name, not where jax builds it from the leaves of a tree (batches, placeholders).
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
FIRST, EVERY = 100, 16  # number of first calls that are all checked; period of the checked calls after them
# files that build trees of results: descriptions with numbers for arrays, batches of compiled functions
TREE_BUILDERS = tuple(f"continuation.hostcall.{name}" for name in ("host_jit", "module_store", "tree_description"))
PLACEHOLDERS = (type(None), bool, int)  # of in_axes, static marks and the like, where a record has arrays


class Finder(MetaPathFinder):
    """Finds files as Python does, and checks those of the packages once they have been imported.

    prepare: changes what Python found before the file is imported.
    """

    def __init__(self, prepare):
        self.prepare = prepare

    def find_spec(self, name, path, target=None):
        spec = PathFinder.find_spec(name, path, target) if name.split(".")[0] in PACKAGES else None
        if spec is not None and spec.loader is not None:
            self.prepare(spec)
            execute = spec.loader.exec_module
            spec.loader.exec_module = lambda module: (execute(module), check_module(module))[0]
        return spec


def check_module(module):
    """Have the functions and records that a module defines checked."""
    for name, value in list(vars(module).items()):
        if getattr(value, "__module__", None) != module.__name__:
            continue
        if is_record(value):
            check_record(value)
        elif isfunction(value) and value.__annotations__ and "warning" not in (value.__doc__ or ""):
            setattr(module, name, checked(value))


def is_checked(call):
    """Return whether the call of a number is checked."""
    return call < FIRST or call % EVERY == 0


def checked(function):
    """Return a function, or a property, that is checked."""
    if isinstance(function, property):
        return property(checked(function.fget), doc=function.__doc__)
    annotated, calls = function, count()
    if "Raises" in (function.__doc__ or ""):

        @wraps(function)
        def annotated(*args, **named):
            return function(*args, **named)

        plain = signature(function)
        free = [parameter.replace(annotation=parameter.empty) for parameter in plain.parameters.values()]
        annotated.__signature__ = plain.replace(parameters=free)
    strict = jaxtyped(annotated, typechecker=beartype)

    @wraps(function)
    def call(*args, **named):
        return (strict if is_checked(next(calls)) else function)(*args, **named)

    return call


def is_record(value):
    """Return whether a value is a class of named fields."""
    return isclass(value) and (is_dataclass(value) or hasattr(value, "_fields"))


def check_record(record):
    """Have the fields and the methods of a record checked."""
    name, hints, calls = ("__init__" if is_dataclass(record) else "__new__"), {}, count()
    original = getattr(record, name)

    @wraps(original)
    def construct(first, /, *args, **named):
        result = original(first, *args, **named)
        caller = sys._getframe(1).f_globals.get("__name__", "") if is_checked(next(calls)) else ""
        if caller.split(".")[0] in PACKAGES and caller not in TREE_BUILDERS:
            hints.update(hints or get_type_hints(record, include_extras=True))
            check_fields(record, first if result is None else result, hints)
        return result

    setattr(record, name, construct)
    for name, member in list(vars(record).items()):
        annotated = member.fget if isinstance(member, property) else member
        if isfunction(annotated) and annotated.__annotations__ and not name.startswith("_"):
            setattr(record, name, checked(member))


@jaxtyped(typechecker=None)
def check_fields(record, value, hints):
    """Check the fields of a record; names of dimensions have one length in all of them."""
    for name, hint in hints.items():
        field = getattr(value, name)
        if not isinstance(field, PLACEHOLDERS) and not is_bearable(field, hint):
            shape = f" of shape {field.shape}, {field.dtype}" if hasattr(field, "shape") else ""
            raise TypeError(f"{record.__module__}.{record.__name__}.{name}: {type(field)}{shape} is no {hint}")


def install(prepare):
    """Check what is imported from now on; prepare: as of `Finder`."""
    sys.meta_path.insert(0, Finder(prepare))
