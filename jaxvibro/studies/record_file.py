"""Read a record of impacts or samples from the CSV file of a [fit]."""

import csv

import numpy as np

from ..design.records import ImpactRecord, SampleRecord, record_from_physical
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import SIDES
from .text_limits import read_content

IMPACT_HEADER = ("time", "side")
HEADERS = (IMPACT_HEADER, ("time", "x"), ("time", "x", "v"))
MILLI = 1e-3
# Headers in physical units, for a scene with scales.
PHYSICAL_HEADERS = (("time (s)", "side"), ("time (s)", "x (mm)"), ("time (s)", "x (mm)", "v (m/s)"))
SIDE_CODES = dict(zip(SIDES, (-1.0, 1.0), strict=True)) | {"-1": -1.0, "1": 1.0, "+1": 1.0}
TABLE_KEYS = ("sigma", "sigma_v", "phase")


def load_record(folder, table, scene):
    """Load the `ImpactRecord` or `SampleRecord` of a `FitTable`, in the scene's units.

    The path of the file is relative to `folder`. The first line states the kind of record, and whether it is in s, mm
    and m/s; the errors in the table are then in these units, too. Raises SceneError with the line for invalid contents,
    OSError if the file cannot be read.
    """
    path = folder / table.record
    try:
        lines = list(csv.reader(read_content(path).decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError as error:
        raise SceneError(path.name, "must be a CSV file", str(error)) from None
    header = tuple(item.strip() for item in lines[0]) if lines else ()
    is_physical = header in PHYSICAL_HEADERS
    if header not in HEADERS and not is_physical:
        rule = "must be " + " or ".join(map(",".join, (*HEADERS, *PHYSICAL_HEADERS)))
        raise SceneError(f"{path.name}, line 1", rule, ",".join(header))
    if is_physical and scene.scales is None:
        rule = f"must be {','.join(HEADERS[PHYSICAL_HEADERS.index(header)])}, as the scene has no [scene.scales]"
        raise SceneError(f"{path.name}, line 1", rule, ",".join(header))
    header = HEADERS[PHYSICAL_HEADERS.index(header)] if is_physical else header
    rows = [_row(path.name, line_number, header, line) for line_number, line in enumerate(lines[1:], 2) if line]
    columns = [list(item) for item in zip(*rows, strict=True)] or [[] for _ in header]
    phase = None if table.phase == "unknown" else float(table.phase)
    try:
        if header == IMPACT_HEADER:
            if table.sigma_v is not None:
                raise ArgumentError("sigma_v", "must be left out for impacts", table.sigma_v)
            result = ImpactRecord(*columns, table.sigma, phase, table.flawed)
            return record_from_physical(result, scene) if is_physical else result
        times, x, v = [*columns, None][:3]
        if not is_physical:
            return SampleRecord(times, x, table.sigma, v, table.sigma_v, phase)
        result = SampleRecord(times, MILLI * np.array(x), MILLI * table.sigma, v, table.sigma_v, phase)
        return record_from_physical(result, scene)
    except ArgumentError as error:
        key = f"fit.{error.key}" if error.key in TABLE_KEYS else f"{path.name}, {error.key}"
        raise SceneError(key, error.rule, error.value, error.index) from None


def _row(file_name, line_number, header, line):
    """Return the numbers of a line."""
    location = f"{file_name}, line {line_number}"
    if len(line) != len(header):
        raise SceneError(location, f"must be {', '.join(header)}", ",".join(line))
    return [_parse_number(location, key, text.strip()) for key, text in zip(header, line, strict=True)]


def _parse_number(location, key, text):
    """Return one entry of a line as a number."""
    if key == "side":
        if text not in SIDE_CODES:
            raise SceneError(location, f"must have a side {', '.join(SIDE_CODES)}", text)
        return SIDE_CODES[text]
    try:
        return float(text)
    except ValueError:
        raise SceneError(location, f"must have a number for {key}", text) from None
