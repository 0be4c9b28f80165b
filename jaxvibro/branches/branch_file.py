"""Read the file of a branch and check every field against the format that `save` writes."""

from os import PathLike

import numpy as np

from ..output.checksums import parse_checked_file
from ..output.saved_curve_checks import (
    IMPACT_CODES,
    decode_field,
    decode_plane_curve,
    decode_scene,
    parse_saved_curve,
    require_valid_bounds,
    require_valid_columns,
    require_valid_field,
)
from ..output.units import scales_attributes
from ..problem.curve_ends import End, parse_end
from ..problem.orbit_curve import dataset_row
from ..problem.orbit_point import make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from .branch import STEP_SETTINGS, Branch, Segment, make_special, multipliers_of_row, point_of_row
from .held_branch import HELD_UNITS, HeldBranch
from .normal_form import parse_normal_form

POINT_COLUMNS = ("stable", "least_speed", "least_clearance", "residual", "value_slope", "segment")
DIMENSIONS: dict[str, tuple[str, ...]] = dict.fromkeys(POINT_COLUMNS, ("point",))
DIMENSIONS |= dict.fromkeys(("time", "speed", "side", "time_slope", "speed_slope"), ("point", "impact"))
DIMENSIONS |= dict.fromkeys(("x", "v"), ("point", "period"))
DIMENSIONS |= dict.fromkeys(("multiplier_real", "multiplier_imag"), ("point", "multiplier"))
FINITE_COLUMNS = ("x", "v", "residual", "value_slope")
Itinerary = tuple[str, ...]
NeighbourFields = tuple[float, list[float], list[float], list[float], int, float, float, float]  # an `OrbitPoint`
NormalFormFields = tuple[
    float, int, float, list[float], list[tuple[int, float, float, float]], str, str
]  # a `NormalForm`
SpecialFields = tuple[
    str, int, float, list[NeighbourFields], list[bool]
]  # a special point: kind, place, residual, joins, aside


@check.host_only("use what was loaded before")
def load_branch(path: str | PathLike[str]) -> Branch:
    """Read a branch from a file that `Branch.save` wrote.

    Monitors and stops are not stored. A file of an older version, without a checksum, is read with a warning.

    Parameters
    ----------
    path : str or path-like
        File name.

    Returns
    -------
    Branch
        The branch.

    Raises
    ------
    ArgumentError
        If the file is damaged or does not hold a branch.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "branch.nc"
    >>> branch.save(path)
    >>> len(jv.load_branch(path)) == len(branch)
    True
    """
    return parse_checked_file(path, parse_branch)


@check.host_only("use what was loaded before")
def load_held_branch(path: str | PathLike[str]) -> HeldBranch:
    """Read a held branch from a file that `HeldBranch.save` wrote.

    Parameters
    ----------
    path : str or path-like
        File name.

    Returns
    -------
    HeldBranch
        The held branch.

    Raises
    ------
    ArgumentError
        If the file is damaged or does not hold a held branch.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> bounds = {"amplitude": (1.5, 2.5), "frequency": (2.05, 2.15)}
    >>> held = jv.follow(orbit, ("amplitude", "frequency"), bounds, hold={"least_speed": 1.9})
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "held.nc"
    >>> held.save(path)
    >>> len(jv.load_held_branch(path)) == len(held)
    True
    """
    return parse_checked_file(
        path, lambda content, path: parse_saved_curve(content, path, "HeldBranch", _build_held_branch)
    )


def parse_branch(file_bytes, path):
    """Parse the bytes of a branch's file. Raises ArgumentError."""
    return parse_saved_curve(file_bytes, path, "Branch", _build_branch)


def _build_branch(data):
    """Build the `Branch` of a file's data. Raises various errors if fields are invalid."""
    attrs = data.attrs
    name, bounds = str(attrs["parameter"]), tuple(float(value) for value in attrs["bounds"])
    require_valid_bounds(bounds)
    scene = decode_scene(attrs, name)
    _check_columns(data, name)
    last_row, template = data.sizes["point"] - 1, make_orbit_problem(scene, name, periods=1)
    segments = tuple(
        Segment(*segment_fields)
        for segment_fields in decode_field(attrs, "segments", list[tuple[int, int, str, Itinerary]])
    )
    segment_last_rows = [-1, *(segment.last for segment in segments)]
    is_contiguous = all(
        segment.first == previous_last + 1 for segment, previous_last in zip(segments, segment_last_rows, strict=False)
    )
    require_valid_field("segments", segment_last_rows[-1] == last_row and is_contiguous)
    special_points, special_fields = [], decode_field(attrs, "special", list[SpecialFields])
    optional_entries = (
        decode_field(attrs, "normal_forms", list[NormalFormFields | None])
        if "normal_forms" in attrs
        else [None] * len(special_fields)
    )
    for (kind, row_index, residual, all_neighbour_fields, is_not_followed), form_fields in zip(
        special_fields, optional_entries, strict=True
    ):
        require_valid_field("special", kind and 0 <= row_index <= last_row)
        optional_fields = (
            [_parse_neighbour(template, neighbour_fields) for neighbour_fields in all_neighbour_fields],
            is_not_followed,
            parse_normal_form(form_fields),
        )
        row = dataset_row(data, row_index)
        point_fields = row_index, point_of_row(template, name, row), multipliers_of_row(row), kind, residual
        special_points.append(make_special(scene, name, bounds, *point_fields, *optional_fields))
    reasons, settings = (
        decode_field(attrs, "reasons", tuple[str, str]),
        decode_field(attrs, "settings", dict[str, float]),
    )
    are_settings_positive = all(0 < value < np.inf for value in settings.values())
    require_valid_field("settings", set(settings) == set(STEP_SETTINGS) and are_settings_positive)
    settings |= {"monitors": {}, "stop": ()}
    optional_entries = (
        decode_field(attrs, "ends", tuple[str, str]) if "ends" in attrs else None
    )  # older files store only the texts
    ends = (
        tuple(map(parse_end, reasons)) if optional_entries is None else tuple(End[value] for value in optional_entries)
    )
    data.attrs = {"parameter": name, **scales_attributes(scene)}
    return Branch(name, bounds, scene, data, segments, tuple(special_points), reasons, settings, ends)


def _build_held_branch(data):
    """Build the `HeldBranch` of a file's data. Raises various errors if fields are invalid."""
    attrs = data.attrs
    names, bounds, scene, reasons = decode_plane_curve(attrs)
    quantity_name, value = str(attrs["held"]), float(attrs["value"])
    require_valid_field("held", quantity_name in HELD_UNITS and np.isfinite(value))
    _check_columns(data, *names)
    data.attrs = scales_attributes(scene)
    return HeldBranch(names, quantity_name, value, bounds, scene, data, reasons)


def _check_columns(data, *parameter_names):
    require_valid_columns(
        data, dict.fromkeys(parameter_names, ("point",)) | DIMENSIONS, (*parameter_names, *FINITE_COLUMNS)
    )
    require_valid_field("sizes", data.sizes["period"] > 0)
    require_valid_field("stable", np.isin(data["stable"].values, (0, 1)).all())


def _parse_neighbour(template, neighbour_fields):
    """Return the `OrbitPoint` of a neighbour of a special point; `template` is a problem without impacts."""
    value, times, speeds, sides, periods, x, v, residual = neighbour_fields
    is_valid = len(times) == len(speeds) == len(sides) and set(map(abs, sides)) <= IMPACT_CODES and periods > 0
    require_valid_field("joins", is_valid)
    impacts = list(zip(times, speeds, sides, strict=True))
    return make_orbit_point(template, value, impacts, periods, (x, v), residual)
