"""A record of impacts or samples from a CSV file, as [fit] of a scene file names it."""

import csv

import numpy as np

from ..design.records import ImpactRecord, SampleRecord, record_from_physical
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import SIDES
from .text_limits import content

IMPACTS = ("time", "side")
HEADERS = (IMPACTS, ("time", "x"), ("time", "x", "v"))
MILLI = 1e-3
# In physical units: of a scene that has scales.
PHYSICAL = (("time (s)", "side"), ("time (s)", "x (mm)"), ("time (s)", "x (mm)", "v (m/s)"))
CODES = dict(zip(SIDES, (-1.0, 1.0), strict=True)) | {"-1": -1.0, "1": 1.0, "+1": 1.0}
OF_TABLE = ("sigma", "sigma_v", "phase")


def record(folder, table, scene):
    """The `ImpactRecord` or `SampleRecord` of a `FitTable`, whose file's name counts from a folder, as the scene
    measures it; its first line says which it is, and whether it is in s, mm and m/s, as the errors in the table are
    then.

    Raises SceneError for what the file may not hold, naming its line, OSError where it cannot be read.
    """
    path = folder / table.record
    try:
        lines = list(csv.reader(content(path).decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError as error:
        raise SceneError(path.name, "must be a CSV file", str(error)) from None
    header = tuple(one.strip() for one in lines[0]) if lines else ()
    measured = header in PHYSICAL
    if header not in HEADERS and not measured:
        rule = "must be " + " or ".join(map(",".join, (*HEADERS, *PHYSICAL)))
        raise SceneError(f"{path.name}, line 1", rule, ",".join(header))
    if measured and scene.scales is None:
        rule = f"must be {','.join(HEADERS[PHYSICAL.index(header)])}, as the scene has no [scene.scales]"
        raise SceneError(f"{path.name}, line 1", rule, ",".join(header))
    header = HEADERS[PHYSICAL.index(header)] if measured else header
    rows = [_row(path.name, k, header, line) for k, line in enumerate(lines[1:], 2) if line]
    columns = [list(one) for one in zip(*rows, strict=True)] or [[] for _ in header]
    phase = None if table.phase == "unknown" else float(table.phase)
    try:
        if header == IMPACTS:
            if table.sigma_v is not None:
                raise ArgumentError("sigma_v", "must be left out of impacts", table.sigma_v)
            found = ImpactRecord(*columns, table.sigma, phase, table.flawed)
            return record_from_physical(found, scene) if measured else found
        times, x, v = [*columns, None][:3]
        if not measured:
            return SampleRecord(times, x, table.sigma, v, table.sigma_v, phase)
        found = SampleRecord(times, MILLI * np.array(x), MILLI * table.sigma, v, table.sigma_v, phase)
        return record_from_physical(found, scene)
    except ArgumentError as error:
        key = f"fit.{error.key}" if error.key in OF_TABLE else f"{path.name}, {error.key}"
        raise SceneError(key, error.rule, error.value, error.index) from None


def _row(name, k, header, line):
    """The numbers of a line."""
    place = f"{name}, line {k}"
    if len(line) != len(header):
        raise SceneError(place, f"must be {', '.join(header)}", ",".join(line))
    return [_number(place, key, one.strip()) for key, one in zip(header, line, strict=True)]


def _number(place, key, text):
    if key == "side":
        if text not in CODES:
            raise SceneError(place, f"must have a side {', '.join(CODES)}", text)
        return CODES[text]
    try:
        return float(text)
    except ValueError:
        raise SceneError(place, f"must have a number for {key}", text) from None
