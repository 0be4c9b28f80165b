"""The file of a branch, read: every field is held against what `Branch.save` writes."""

import json
from os import PathLike

import msgspec
import numpy as np

from ..output.checksums import dataset_of, opened
from ..output.units import scales_in
from ..problem.end import End, read
from ..problem.orbit_on_branch import OrbitPoint
from ..problem.orbit_rows import row_of
from ..scene import check
from ..scene.scene_table import SceneTable
from .branch import NUMBERS, Branch, Segment, special_of
from .normal_form import of_plain

AT_POINTS = ("stable", "least_speed", "least_clearance", "residual", "value_slope", "segment")
COLUMNS = {
    "impact": ("time", "speed", "side", "time_slope", "speed_slope"),
    "period": ("x", "v"),
    "multiplier": ("multiplier_real", "multiplier_imag"),
}
FINITE = ("x", "v", "residual", "value_slope")
CODES = {1, 2, 3}  # of an impact, and of releases, times the wall's sign
Itinerary = tuple[str, ...]
Join = tuple[float, list[float], list[float], list[float], int, float, float, float]  # a `OrbitPoint`
Form = tuple[float, int, float, list[float], list[tuple[int, float, float, float]], str, str]  # a `NormalForm`
Point = tuple[str, int, float, list[Join], list[bool]]  # a special point: kind, place, residual, joins, aside


@check.host("use what was loaded before")
def load_branch(path: str | PathLike[str]) -> Branch:
    """The `Branch` of a file that `Branch.save` wrote. Monitors and stops are not kept.

    A file of before, without a checksum, is read with a warning. Raises ArgumentError where the file is damaged or no
    branch, OSError where it cannot be read.
    """
    return opened(path, branch_of)


def branch_of(content, path):
    """The `Branch` of a file's bytes. Raises ArgumentError."""
    data = dataset_of(content, path)
    try:
        return _branch(data)
    except (LookupError, ValueError, TypeError, ArithmeticError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise check.ArgumentError("path", f"must be a file of Branch.save ({check.short(reason)})", str(path)) from None


def _branch(data):
    """The `Branch` of a file's data. Raises an error of one kind or another where its fields are no branch's."""
    attrs = data.attrs
    name, bounds = str(attrs["parameter"]), tuple(float(each) for each in attrs["bounds"])
    _fits("bounds", len(bounds) == 2 and np.isfinite(bounds).all() and bounds[0] < bounds[1])
    scene = msgspec.toml.decode(attrs["scene"], type=SceneTable).make()
    check.require_known(name, scene.names, name)
    _check_columns(data, name)
    last = data.sizes["point"] - 1
    segments = tuple(Segment(*one) for one in _field(attrs, "segments", list[tuple[int, int, str, Itinerary]]))
    ends = [-1, *(one.last for one in segments)]
    _fits("segments", ends[-1] == last and all(one.first == end + 1 for one, end in zip(segments, ends, strict=False)))
    special, told = [], _field(attrs, "special", list[Point])
    known = _field(attrs, "normal_forms", list[Form | None]) if "normal_forms" in attrs else [None] * len(told)
    for (kind, place, residual, joins, aside), form in zip(told, known, strict=True):
        _fits("special", kind and 0 <= place <= last)
        more = [_spot(one) for one in joins], aside, of_plain(form)
        special.append(special_of(scene, name, bounds, place, row_of(data, place), kind, residual, *more))
    reasons, settings = _field(attrs, "reasons", tuple[str, str]), _field(attrs, "settings", dict[str, float])
    _fits("settings", set(settings) == set(NUMBERS) and all(0 < each < np.inf for each in settings.values()))
    settings |= {"monitors": {}, "stop": ()}
    known = _field(attrs, "ends", tuple[str, str]) if "ends" in attrs else None  # files of before have texts alone
    ends = tuple(map(read, reasons)) if known is None else tuple(End[each] for each in known)
    data.attrs = {"parameter": name, **scales_in(scene)}
    return Branch(name, bounds, scene, data, segments, tuple(special), reasons, settings, ends)


def _field(attrs, key, kind):
    """A field that is JSON, of a kind that msgspec tells."""
    return msgspec.convert(json.loads(attrs[key]), kind)


def _fits(field, holds):
    if not holds:
        raise ValueError(f"its {field} cannot be")


def _check_columns(data, name):
    """Refuse data without the columns of a branch, and numbers that no orbit has."""
    wanted = dict.fromkeys((name, *AT_POINTS), ("point",))
    wanted |= {key: ("point", dim) for dim, keys in COLUMNS.items() for key in keys}
    for key, dims in wanted.items():
        _fits(key, data[key].dims == dims and data[key].dtype.kind in "fi")
    _fits("sizes", data.sizes["point"] > 0 and data.sizes["period"] > 0 and data.sizes["multiplier"] == 2)
    sides = data["side"].values
    hit = sides != 0
    _fits("side", np.isin(abs(sides), (0, *CODES)).all())
    for key in (name, *FINITE):
        _fits(key, np.isfinite(data[key].values).all())
    for key in ("time", "speed"):
        _fits(key, np.isfinite(data[key].values[hit]).all())
    _fits("stable", np.isin(data["stable"].values, (0, 1)).all())


def _spot(join):
    value, times, speeds, sides, periods, *rest = join
    _fits("joins", len(times) == len(speeds) == len(sides) and set(map(abs, sides)) <= CODES and periods > 0)
    return OrbitPoint(value, *(np.array(each, float) for each in (times, speeds, sides)), periods, *rest)
