"""What stands in a saved curve's file, held against what was written: fields in JSON, columns of numbers."""

import json
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from ..scene.check import ArgumentError, require_known, short
from ..scene.scene_table import SceneTable
from .checksums import dataset_of

CODES = {1, 2, 3}  # of an impact, and of releases, times the wall's sign


def record_of(content: bytes, path, what: str, read: Callable[..., Any]) -> Any:
    """What read(Dataset) makes of a file's bytes; `what` says whose `save` writes such files.

    Raises ArgumentError, whatever `read` falls over.
    """
    data = dataset_of(content, path)
    try:
        return read(data)
    except (LookupError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ArgumentError("path", f"must be a file of {what}.save ({short(reason)})", str(path)) from None


def field(attrs, key, kind):
    """A field that is JSON, of a kind that msgspec tells. Raises what `msgspec` raises."""
    return msgspec.convert(json.loads(attrs[key]), kind)


def require_fit(name, holds):
    """Raises ValueError, naming the field, where it does not hold."""
    if not holds:
        raise ValueError(f"its {name} cannot be")


def scene_in(attrs, *names):
    """The scene in a file, which has parameters of these names. Raises ArgumentError where it has not."""
    scene = msgspec.toml.decode(attrs["scene"], type=SceneTable).make()
    for name in names:
        require_known(name, scene.names, name)
    return scene


def require_bounds(bounds):
    """Raises ValueError where (low, high) are no bounds."""
    require_fit("bounds", len(bounds) == 2 and np.isfinite(bounds).all() and bounds[0] < bounds[1])


def require_columns(data, dims, finite):
    """Raises an error where data are without the columns of a curve of orbits, or hold numbers that no orbit has.

    dims: {column: its dimensions}; finite: the columns without nan and infinity.
    """
    for key, wanted in dims.items():
        require_fit(key, data[key].dims == wanted and data[key].dtype.kind in "fi")
    require_fit("sizes", data.sizes["point"] > 0 and data.sizes["multiplier"] == 2)
    sides = data["side"].values
    hit = sides != 0
    require_fit("side", np.isin(abs(sides), (0, *CODES)).all())
    for key in finite:
        require_fit(key, np.isfinite(data[key].values).all())
    for key in ("time", "speed"):
        require_fit(key, np.isfinite(data[key].values[hit]).all())
