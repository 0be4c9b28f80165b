"""Describe arguments and results of functions by JSON, so that another process finds the same class or function."""

import dataclasses
import json
import sys
from functools import partial, reduce
from typing import Any

from jax.core import ShapedArray, Tracer

NUMBER = "number"  # stands for a number of a result
own_packages = {__name__.split(".")[0]}  # packages whose functions and classes may occur


class NotPersistentError(Exception):
    """Error for a value that cannot be identified in another process by a qualified name."""


def tree_text(value: Any) -> str:
    """Return the description of a value as JSON. Raises NotPersistentError for foreign classes and functions."""
    return json.dumps(_describe(value))


def tree_of_text(text: str | bytes) -> Any:
    """Return the value of a description, with 0 in place of each `NUMBER`."""
    return _build(json.loads(text))


def _describe(value):
    """Describe a value by dictionaries, lists and texts.

    Tracers are described by their types, functions and classes by their qualified names, and other data by their
    values.
    """
    if value is NUMBER:
        return NUMBER
    if isinstance(value, Tracer | ShapedArray):
        return {"number": [str(value.dtype), list(value.shape), bool(value.weak_type)]}
    if value is None or type(value) in (bool, int, float, str):
        return {"is": value}
    if type(value) in (tuple, list):
        return {type(value).__name__: [_describe(item) for item in value]}
    if type(value) is dict:
        return {"dict": [_describe(item) for item in value.items()]}
    if isinstance(value, partial):
        return {"partial": [_describe(item) for item in (value.func, value.args, value.keywords)]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
        return {"class": qualified_name(type(value)), "parts": [_describe(part) for part in parts]}
    if isinstance(value, tuple):
        return {"class": qualified_name(type(value)), "parts": [_describe(part) for part in value]}
    return {"function": qualified_name(value)}


def _build(description):
    if description == NUMBER:
        return 0
    if "class" in description:
        return _object_by_name(description["class"])(*map(_build, description["parts"]))
    ((kind, parts),) = description.items()
    return parts if kind == "is" else {"tuple": tuple, "list": list, "dict": dict}[kind](map(_build, parts))


def qualified_name(value: Any) -> str:
    """Return module:name of a function or class. Raises NotPersistentError for others than those of `own_packages`."""
    name = f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', '')}"
    resolved = _object_by_name(name)
    if value not in (resolved, getattr(resolved, "__wrapped__", None)):
        raise NotPersistentError(name)
    return name


def _object_by_name(name):
    """Return the function or class that a qualified name, module:name, denotes."""
    module_name, object_path = name.split(":")
    if module_name.split(".")[0] not in own_packages:
        raise NotPersistentError(name)
    return reduce(getattr, object_path.split("."), sys.modules[module_name])
