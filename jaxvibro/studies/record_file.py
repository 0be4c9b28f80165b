"""A record of impacts or samples from a CSV file, as [fit] of a scene file names it."""

import csv

from ..design.records import ImpactRecord, SampleRecord
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import SIDES
from .text_limits import content

IMPACTS = ("time", "side")
HEADERS = (IMPACTS, ("time", "x"), ("time", "x", "v"))
CODES = dict(zip(SIDES, (-1.0, 1.0), strict=True)) | {"-1": -1.0, "1": 1.0, "+1": 1.0}
OF_TABLE = ("sigma", "sigma_v", "phase")


def record(folder, table):
    """The `ImpactRecord` or `SampleRecord` of a `FitTable`, whose file's name counts from a folder; its first line says
    which it is.

    Raises SceneError for what the file may not hold, naming its line, OSError where it cannot be read.
    """
    path = folder / table.record
    try:
        lines = list(csv.reader(content(path).decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError as error:
        raise SceneError(path.name, "must be a CSV file", str(error)) from None
    header = tuple(one.strip() for one in lines[0]) if lines else ()
    if header not in HEADERS:
        rule = "must be " + " or ".join(map(",".join, HEADERS))
        raise SceneError(f"{path.name}, line 1", rule, ",".join(header))
    rows = [_row(path.name, k, header, line) for k, line in enumerate(lines[1:], 2) if line]
    columns = [list(one) for one in zip(*rows, strict=True)] or [[] for _ in header]
    phase = None if table.phase == "unknown" else float(table.phase)
    try:
        if header == IMPACTS:
            if table.sigma_v is not None:
                raise ArgumentError("sigma_v", "must be left out of impacts", table.sigma_v)
            return ImpactRecord(*columns, table.sigma, phase, table.flawed)
        times, x, v = [*columns, None][:3]
        return SampleRecord(times, x, table.sigma, v, table.sigma_v, phase)
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
