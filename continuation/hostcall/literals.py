"""Write arrays and the parameters of rules as Python text that evaluates to the same values."""

from enum import Enum
from typing import Any

import numpy as np
from jax import lax

from .gather_scatter import NoRuleError
from .rules import rule_arguments

_NAMED_TYPES = (lax.GatherDimensionNumbers, lax.ScatterDimensionNumbers, lax.GatherScatterMode, lax.RoundingMethod)
TYPES_BY_NAME = {named_type.__name__: named_type for named_type in _NAMED_TYPES}  # types that a text may contain


def literal_text(value: Any) -> str:
    """Return the Python text of a value. Raises NoRuleError if the value has no text."""
    value_type = type(value)
    is_named = TYPES_BY_NAME.get(value_type.__name__) is value_type
    if value is None or value_type in (bool, int, float, str):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufc" and value.dtype.isbuiltin:
        return f"np.ndarray({value.shape}, {literal_text(value.dtype)}, {value.tobytes()!r}).copy()[()]"
    if isinstance(value, np.dtype) and value.isbuiltin:
        return f"np.dtype({value.str!r})"
    if is_named and isinstance(value, Enum):
        return f"{value_type.__name__}.{value.name}"
    if value_type is tuple or (is_named and isinstance(value, tuple)):
        type_text = value_type.__name__ if is_named else ""
        entries_text = "".join(f"{literal_text(entry)}, " for entry in value)
        return f"{type_text}({entries_text})"
    raise NoRuleError(f"no text of {value_type.__name__}")


def rule_text(name: str, params: dict[str, Any]) -> str:
    """Return the Python text of a call of a primitive's rule with the parameters of an equation."""
    texts = [f"{key}={literal_text(value)}" for key, value in rule_arguments(params).items()]
    return f"RULES[{name!r}]({', '.join(texts)})"
