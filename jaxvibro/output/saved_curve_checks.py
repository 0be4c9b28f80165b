"""Read and check the content of saved curve files: JSON fields and columns of numbers."""

import json
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from ..scene.check import ArgumentError, require_parameter, shorten_text
from ..scene.scene_table import SceneTable
from .checksums import parse_dataset

IMPACT_CODES = {1, 2, 3}  # codes of impacts and releases, multiplied by the side of the wall


def parse_saved_curve(content: bytes, path, class_name: str, parse: Callable[..., Any]) -> Any:
    """Parse the content of a saved curve file.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : path_like
        Name of the file, for the error message.
    class_name : str
        Name of the class whose `save` method writes such files.
    parse : callable
        Function of the Dataset in the file.

    Returns
    -------
    object
        Result of `parse`.

    Raises
    ------
    ArgumentError
        If the file is not a NetCDF file, or `parse` raises an error.
    """
    data = parse_dataset(content, path)
    try:
        return parse(data)
    except (LookupError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        error_text = f"{type(error).__name__}: {error}"
        raise ArgumentError(
            "path", f"must be a file of {class_name}.save ({shorten_text(error_text)})", str(path)
        ) from None


def decode_field(dataset_attrs, field_name, field_type):
    """Decode a JSON field and convert it to a type.

    Parameters
    ----------
    dataset_attrs : mapping
        Attributes of the Dataset.
    field_name : str
        Name of the field.
    field_type : type
        Type of the result.

    Returns
    -------
    object
        Value of the field.

    Raises
    ------
    msgspec.ValidationError
        If the field cannot be converted to this type.
    """
    return msgspec.convert(json.loads(dataset_attrs[field_name]), field_type)


def require_valid_field(field_name, is_valid):
    """Raise a ValueError that names a field if the field is invalid.

    Parameters
    ----------
    field_name : str
        Name of the field.
    is_valid : bool
        True if the field is valid.

    Raises
    ------
    ValueError
        If `is_valid` is False.
    """
    if not is_valid:
        raise ValueError(f"its {field_name} is invalid")


def decode_scene(dataset_attrs, *parameter_names):
    """Decode the scene of a file and check that the scene has given parameters.

    Parameters
    ----------
    dataset_attrs : mapping
        Attributes of the Dataset.
    *parameter_names : str
        Parameters that the scene must have.

    Returns
    -------
    Scene
        Scene in the attribute ``scene``.

    Raises
    ------
    ArgumentError
        If the scene does not have one of the parameters.
    """
    scene = msgspec.toml.decode(dataset_attrs["scene"], type=SceneTable).make()
    for parameter_name in parameter_names:
        require_parameter(parameter_name, scene.names, parameter_name)
    return scene


def decode_plane_curve(dataset_attrs):
    """Decode the fields that the files of curves in two parameters share.

    Parameters
    ----------
    dataset_attrs : mapping
        Attributes of the Dataset.

    Returns
    -------
    names : tuple of str
        The two parameters.
    bounds : dict of str to tuple of float
        Bounds of each parameter.
    scene : Scene
        Scene of the curve.
    reasons : tuple of str
        Reasons for the two ends.

    Raises
    ------
    ValueError
        If a field is invalid.
    """
    bounds = decode_field(dataset_attrs, "bounds", dict[str, tuple[float, float]])
    require_valid_field("parameters", len(bounds) == 2)
    for parameter_bounds in bounds.values():
        require_valid_bounds(parameter_bounds)
    scene = decode_scene(dataset_attrs, *bounds)
    return tuple(bounds), bounds, scene, decode_field(dataset_attrs, "reasons", tuple[str, str])


def require_valid_bounds(bounds):
    """Raise ValueError if a sequence is not (lower, upper) with finite, increasing bounds.

    Parameters
    ----------
    bounds : sequence of float
        Lower and upper bound.

    Raises
    ------
    ValueError
        If `bounds` does not have two finite, increasing numbers.
    """
    require_valid_field("bounds", len(bounds) == 2 and np.isfinite(bounds).all() and bounds[0] < bounds[1])


def require_valid_columns(data, dims_by_column, finite_columns):
    """Raise an error if columns of a saved curve of orbits are missing or invalid.

    Parameters
    ----------
    data : xarray.Dataset
        Content of the file.
    dims_by_column : mapping of str to tuple of str
        Dimensions of each column.
    finite_columns : sequence of str
        Columns that may contain neither nan nor infinity.

    Raises
    ------
    ValueError
        If a column is invalid.
    KeyError
        If a column is missing.
    """
    for column_name, column_dims in dims_by_column.items():
        require_valid_field(column_name, data[column_name].dims == column_dims and data[column_name].dtype.kind in "fi")
    require_valid_field("sizes", data.sizes["point"] > 0 and data.sizes["multiplier"] == 2)
    impact_codes = data["side"].values
    is_event = impact_codes != 0
    require_valid_field("side", np.isin(abs(impact_codes), (0, *IMPACT_CODES)).all())
    for column_name in finite_columns:
        require_valid_field(column_name, np.isfinite(data[column_name].values).all())
    for column_name in ("time", "speed"):
        require_valid_field(column_name, np.isfinite(data[column_name].values[is_event]).all())
