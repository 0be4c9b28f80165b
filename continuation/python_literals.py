"""What a rule's parameters and an array are in Python's text, so that a program can be read again."""

from enum import Enum
from functools import lru_cache
from inspect import Parameter, signature
from typing import Any

import numpy as np
from jax import lax

from .numpy_indexing import Unknown
from .numpy_rules import rules

_TYPES = (lax.GatherDimensionNumbers, lax.ScatterDimensionNumbers, lax.GatherScatterMode, lax.RoundingMethod)
NAMED = {each.__name__: each for each in _TYPES}  # types that a text may name


def literal(value: Any) -> str:
    """Python's text of a value. Raises Unknown where it has none."""
    if value is None or type(value) in (bool, int, float, str):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biuf" and value.dtype.isbuiltin:
        return f"np.array({value.ravel().tolist()}, {literal(value.dtype)}).reshape({value.shape})[()]"
    if isinstance(value, np.dtype) and value.isbuiltin:
        return f"np.dtype({value.str!r})"
    kind = type(value)
    if NAMED.get(kind.__name__) is kind and isinstance(value, Enum):
        return f"{kind.__name__}.{value.name}"
    if NAMED.get(kind.__name__) is kind and isinstance(value, tuple):
        return f"{kind.__name__}{literal(tuple(value))}"
    if kind is tuple:
        return f"({''.join(f'{literal(each)}, ' for each in value)})"
    raise Unknown(value)


def rule_text(name: str, params: dict[str, Any]) -> str:
    """The text of a primitive's rule with the parameters that it takes."""
    taken = [f"{key}={literal(params[key])}" for key in _taken(name) if key in params]
    return f"rules[{name!r}]({', '.join(taken)})"


@lru_cache
def _taken(name):
    return [key for key, each in signature(rules[name]).parameters.items() if each.kind is not Parameter.VAR_KEYWORD]
