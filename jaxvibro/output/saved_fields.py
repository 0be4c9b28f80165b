"""What stands in a saved curve's file, held against what was written: fields in JSON, columns of numbers."""

import json
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from ..scene.check import ArgumentError, require_parameter, shorten
from ..scene.scene_table import SceneTable
from .checksums import parse_dataset

IMPACT_CODES = {1, 2, 3}  # of an impact, and of releases, times the wall's sign


def read_record(content: bytes, path, owner: str, parse: Callable[..., Any]) -> Any:
    """What read(Dataset) makes of a file's bytes; `owner` says whose `save` writes such files.

    Raises ArgumentError, whatever `parse` falls over.
    """
    data = parse_dataset(content, path)
    try:
        return parse(data)
    except (LookupError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ArgumentError("path", f"must be a file of {owner}.save ({shorten(reason)})", str(path)) from None


def decode_field(attrs, key, kind):
    """A field that is JSON, of a kind that msgspec tells. Raises what `msgspec` raises."""
    return msgspec.convert(json.loads(attrs[key]), kind)


def require_valid(name, is_valid):
    """Raises ValueError, naming the field, where it does not hold."""
    if not is_valid:
        raise ValueError(f"its {name} cannot be")


def decode_scene(attrs, *names):
    """The scene in a file, which has parameters of these names. Raises ArgumentError where it has not."""
    scene = msgspec.toml.decode(attrs["scene"], type=SceneTable).make()
    for name in names:
        require_parameter(name, scene.names, name)
    return scene


def require_bounds(bounds):
    """Raises ValueError where (low, high) are no bounds."""
    require_valid("bounds", len(bounds) == 2 and np.isfinite(bounds).all() and bounds[0] < bounds[1])


def require_columns(data, dims, finite_columns):
    """Raises an error where data are without the columns of a curve of orbits, or hold numbers that no orbit has.

    dims: {column: its dimensions}; finite_columns: the columns without nan and infinity.
    """
    for key, expected_dims in dims.items():
        require_valid(key, data[key].dims == expected_dims and data[key].dtype.kind in "fi")
    require_valid("sizes", data.sizes["point"] > 0 and data.sizes["multiplier"] == 2)
    sides = data["side"].values
    is_impact = sides != 0
    require_valid("side", np.isin(abs(sides), (0, *IMPACT_CODES)).all())
    for key in finite_columns:
        require_valid(key, np.isfinite(data[key].values).all())
    for key in ("time", "speed"):
        require_valid(key, np.isfinite(data[key].values[is_impact]).all())
