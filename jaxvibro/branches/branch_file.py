"""The file of a branch, read: every field is held against what its `save` writes."""

from os import PathLike

import numpy as np

from ..output.checksums import opened
from ..output.saved_fields import CODES, field, record_of, require_bounds, require_columns, require_fit, scene_in
from ..output.units import scales_in
from ..problem.end import End, read
from ..problem.orbit_on_branch import OrbitPoint
from ..problem.orbit_rows import row_of
from ..scene import check
from .branch import NUMBERS, Branch, Segment, special_of
from .held_branch import UNITS, HeldBranch
from .normal_form import of_plain

AT_POINTS = ("stable", "least_speed", "least_clearance", "residual", "value_slope", "segment")
DIMS: dict[str, tuple[str, ...]] = dict.fromkeys(AT_POINTS, ("point",))
DIMS |= dict.fromkeys(("time", "speed", "side", "time_slope", "speed_slope"), ("point", "impact"))
DIMS |= dict.fromkeys(("x", "v"), ("point", "period"))
DIMS |= dict.fromkeys(("multiplier_real", "multiplier_imag"), ("point", "multiplier"))
FINITE = ("x", "v", "residual", "value_slope")
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


@check.host("use what was loaded before")
def load_held_branch(path: str | PathLike[str]) -> HeldBranch:
    """The `HeldBranch` of a file that `HeldBranch.save` wrote.

    Raises ArgumentError where the file is damaged or no such branch, OSError where it cannot be read.
    """
    return opened(path, lambda content, path: record_of(content, path, "HeldBranch", _held))


def branch_of(content, path):
    """The `Branch` of a file's bytes. Raises ArgumentError."""
    return record_of(content, path, "Branch", _branch)


def _branch(data):
    """The `Branch` of a file's data. Raises an error of one kind or another where its fields are no branch's."""
    attrs = data.attrs
    name, bounds = str(attrs["parameter"]), tuple(float(each) for each in attrs["bounds"])
    require_bounds(bounds)
    scene = scene_in(attrs, name)
    _check_columns(data, name)
    last = data.sizes["point"] - 1
    segments = tuple(Segment(*one) for one in field(attrs, "segments", list[tuple[int, int, str, Itinerary]]))
    ends = [-1, *(one.last for one in segments)]
    closed = all(one.first == end + 1 for one, end in zip(segments, ends, strict=False))
    require_fit("segments", ends[-1] == last and closed)
    special, told = [], field(attrs, "special", list[Point])
    known = field(attrs, "normal_forms", list[Form | None]) if "normal_forms" in attrs else [None] * len(told)
    for (kind, place, residual, joins, aside), form in zip(told, known, strict=True):
        require_fit("special", kind and 0 <= place <= last)
        more = [_spot(one) for one in joins], aside, of_plain(form)
        special.append(special_of(scene, name, bounds, place, row_of(data, place), kind, residual, *more))
    reasons, settings = field(attrs, "reasons", tuple[str, str]), field(attrs, "settings", dict[str, float])
    steps = all(0 < each < np.inf for each in settings.values())
    require_fit("settings", set(settings) == set(NUMBERS) and steps)
    settings |= {"monitors": {}, "stop": ()}
    known = field(attrs, "ends", tuple[str, str]) if "ends" in attrs else None  # files of before have texts alone
    ends = tuple(map(read, reasons)) if known is None else tuple(End[each] for each in known)
    data.attrs = {"parameter": name, **scales_in(scene)}
    return Branch(name, bounds, scene, data, segments, tuple(special), reasons, settings, ends)


def _held(data):
    """The `HeldBranch` of a file's data, likewise."""
    attrs = data.attrs
    bounds = field(attrs, "bounds", dict[str, tuple[float, float]])
    names, held, value = tuple(bounds), str(attrs["held"]), float(attrs["value"])
    require_fit("parameters", len(names) == 2)
    require_fit("held", held in UNITS and np.isfinite(value))
    for each in bounds.values():
        require_bounds(each)
    scene = scene_in(attrs, *names)
    _check_columns(data, *names)
    reasons = field(attrs, "reasons", tuple[str, str])
    data.attrs = scales_in(scene)
    return HeldBranch(names, held, value, bounds, scene, data, reasons)


def _check_columns(data, *names):
    require_columns(data, dict.fromkeys(names, ("point",)) | DIMS, (*names, *FINITE))
    require_fit("sizes", data.sizes["period"] > 0)
    require_fit("stable", np.isin(data["stable"].values, (0, 1)).all())


def _spot(join):
    value, times, speeds, sides, periods, *rest = join
    fits = len(times) == len(speeds) == len(sides) and set(map(abs, sides)) <= CODES and periods > 0
    require_fit("joins", fits)
    return OrbitPoint(value, *(np.array(each, float) for each in (times, speeds, sides)), periods, *rest)
