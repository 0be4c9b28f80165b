"""Write arrays and the parameters of rules as Python text that evaluates to the same values."""

from enum import Enum
from functools import lru_cache
from inspect import Parameter, signature
from typing import Any

import numpy as np
from jax import lax

from .numpy_gather_scatter import NoRuleError
from .numpy_primitives import rules

_NAMED_TYPES = (lax.GatherDimensionNumbers, lax.ScatterDimensionNumbers, lax.GatherScatterMode, lax.RoundingMethod)
TYPES_BY_NAME = {named_type.__name__: named_type for named_type in _NAMED_TYPES}  # types that a text may contain


def literal_text(value: Any) -> str:
    """Return the Python text of a value. Raises NoRuleError if the value has no text."""
    if value is None or type(value) in (bool, int, float, str):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biuf" and value.dtype.isbuiltin:
        return f"np.array({value.ravel().tolist()}, {literal_text(value.dtype)}).reshape({value.shape})[()]"
    if isinstance(value, np.dtype) and value.isbuiltin:
        return f"np.dtype({value.str!r})"
    value_type = type(value)
    if TYPES_BY_NAME.get(value_type.__name__) is value_type and isinstance(value, Enum):
        return f"{value_type.__name__}.{value.name}"
    if TYPES_BY_NAME.get(value_type.__name__) is value_type and isinstance(value, tuple):
        return f"{value_type.__name__}{literal_text(tuple(value))}"
    if value_type is tuple:
        return f"({''.join(f'{literal_text(entry)}, ' for entry in value)})"
    raise NoRuleError(value)


def rule_text(name: str, params: dict[str, Any]) -> str:
    """Return the Python text of a call of a primitive's rule with the parameters of an equation."""
    argument_texts = [f"{key}={literal_text(params[key])}" for key in _rule_parameters(name) if key in params]
    return f"rules[{name!r}]({', '.join(argument_texts)})"


@lru_cache
def _rule_parameters(name):
    return [
        key
        for key, parameter in signature(rules[name]).parameters.items()
        if parameter.kind is not Parameter.VAR_KEYWORD
    ]
