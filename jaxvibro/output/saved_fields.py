"""Check the content of saved curve files: fields in JSON and columns of numbers."""

import json
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from ..scene.check import ArgumentError, require_parameter, shorten
from ..scene.scene_table import SceneTable
from .checksums import parse_dataset

IMPACT_CODES = {1, 2, 3}  # codes of impacts and releases, multiplied by the side of the wall


def read_record(content: bytes, path, owner: str, parse: Callable[..., Any]) -> Any:
    """Return parse(Dataset) of a file's bytes.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : path_like
        Name of the file, for the error.
    owner : str
        Class whose `save` writes such files.
    parse : callable
        Function of the Dataset.

    Returns
    -------
    object
        Result of `parse`.

    Raises
    ------
    ArgumentError
        If the file cannot be parsed, whatever error `parse` raises.
    """
    data = parse_dataset(content, path)
    try:
        return parse(data)
    except (LookupError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ArgumentError("path", f"must be a file of {owner}.save ({shorten(reason)})", str(path)) from None


def decode_field(attrs, key, kind):
    """Return a JSON field converted to a type.

    Parameters
    ----------
    attrs : mapping
        Attributes of the Dataset.
    key : str
        Name of the field.
    kind : type
        Type that msgspec converts to.

    Returns
    -------
    object
        Value of the field.

    Raises
    ------
    msgspec.ValidationError
        If the field has another type.
    """
    return msgspec.convert(json.loads(attrs[key]), kind)


def require_valid(name, is_valid):
    """Raise ValueError, naming the field, if it is invalid.

    Parameters
    ----------
    name : str
        Name of the field.
    is_valid : bool
        True if it is valid.

    Raises
    ------
    ValueError
        If it is invalid.
    """
    if not is_valid:
        raise ValueError(f"its {name} is invalid")


def decode_scene(attrs, *names):
    """Return the scene in a file.

    Parameters
    ----------
    attrs : mapping
        Attributes of the Dataset.
    *names : str
        Parameters that the scene must have.

    Returns
    -------
    Scene
        Scene.

    Raises
    ------
    ArgumentError
        If the scene lacks one of the parameters.
    """
    scene = msgspec.toml.decode(attrs["scene"], type=SceneTable).make()
    for name in names:
        require_parameter(name, scene.names, name)
    return scene


def require_bounds(bounds):
    """Raise ValueError if (low, high) are not valid bounds.

    Parameters
    ----------
    bounds : sequence of float
        Lower and upper bound.

    Raises
    ------
    ValueError
        If the bounds are not finite and increasing.
    """
    require_valid("bounds", len(bounds) == 2 and np.isfinite(bounds).all() and bounds[0] < bounds[1])


def require_columns(data, dims, finite_columns):
    """Raise an error if the columns of a curve of orbits are missing or hold invalid numbers.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset.
    dims : mapping of str to tuple of str
        Dimensions of each column.
    finite_columns : sequence of str
        Columns without nan and infinity.

    Raises
    ------
    ValueError
        If a column is invalid.
    KeyError
        If a column is missing.
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
