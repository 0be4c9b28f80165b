"""A record of impacts from a CSV file, as [fit] of a scene file names it."""

import csv

from ..design.records import ImpactRecord
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import SIDES
from .text_limits import content

HEADER = ["time", "side"]
CODES = dict(zip(SIDES, (-1.0, 1.0), strict=True)) | {"-1": -1.0, "1": 1.0, "+1": 1.0}


def record(folder, table):
    """The `ImpactRecord` of a `FitTable`, whose file's name counts from a folder.

    Raises SceneError for what the file may not hold, naming its line, OSError where it cannot be read.
    """
    path = folder / table.times
    try:
        lines = list(csv.reader(content(path).decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError as error:
        raise SceneError(path.name, "must be a CSV file", str(error)) from None
    if not lines or [one.strip() for one in lines[0]] != HEADER:
        raise SceneError(f"{path.name}, line 1", "must be time,side", ",".join(lines[0]) if lines else "")
    rows = [_row(path.name, k, line) for k, line in enumerate(lines[1:], 2) if line]
    phase = None if table.phase == "unknown" else float(table.phase)
    try:
        return ImpactRecord([time for time, _ in rows], [side for _, side in rows], table.sigma, phase, table.flawed)
    except ArgumentError as error:
        key = f"fit.{error.key}" if error.key in ("sigma", "phase") else f"{path.name}, {error.key}"
        raise SceneError(key, error.rule, error.value, error.index) from None


def _row(name, k, line):
    """(time, side) of a line."""
    place = f"{name}, line {k}"
    if len(line) != len(HEADER):
        raise SceneError(place, "must be a time and a side", ",".join(line))
    time, side = (one.strip() for one in line)
    if side not in CODES:
        raise SceneError(place, f"must have a side {', '.join(CODES)}", side)
    try:
        return float(time), CODES[side]
    except ValueError:
        raise SceneError(place, "must have a time, a number", time) from None
