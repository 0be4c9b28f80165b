"""Read the measured record of impacts or samples for a [fit] from its CSV file."""

import csv

import numpy as np

from ..design.records import ImpactRecord, SampleRecord, record_from_physical
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import SIDES
from .scene_file import read_limited_file

IMPACT_HEADER = ("time", "side")
HEADERS = (IMPACT_HEADER, ("time", "x"), ("time", "x", "v"))
MILLI = 1e-3
# Headers in physical units, for a scene with scales.
PHYSICAL_HEADERS = (("time (s)", "side"), ("time (s)", "x (mm)"), ("time (s)", "x (mm)", "v (m/s)"))
SIDE_CODES = dict(zip(SIDES, (-1.0, 1.0), strict=True)) | {"-1": -1.0, "1": 1.0, "+1": 1.0}
TABLE_KEYS = ("sigma", "sigma_v", "phase")


def load_measured_record(scene_folder, fit_table, scene):
    """Load the `ImpactRecord` or `SampleRecord` of a `FitTable`, in the scene's units.

    The path of the file is relative to `scene_folder`. The header line states the kind of record and its units. If the
    record is in s, mm and m/s, the standard errors in the table are in these units, too. Raises SceneError with the
    line number for invalid content, and OSError if the file cannot be read."""
    record_path = scene_folder / fit_table.record
    try:
        csv_lines = list(csv.reader(read_limited_file(record_path).decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError as error:
        raise SceneError(record_path.name, "must be a CSV file", str(error)) from None
    header = tuple(heading_or_column.strip() for heading_or_column in csv_lines[0]) if csv_lines else ()
    has_physical_units = header in PHYSICAL_HEADERS
    if header not in HEADERS and not has_physical_units:
        rule = "must be " + " or ".join(map(",".join, (*HEADERS, *PHYSICAL_HEADERS)))
        raise SceneError(f"{record_path.name}, line 1", rule, ",".join(header))
    if has_physical_units and scene.scales is None:
        rule = f"must be {','.join(HEADERS[PHYSICAL_HEADERS.index(header)])}, as the scene has no [scene.scales]"
        raise SceneError(f"{record_path.name}, line 1", rule, ",".join(header))
    header = HEADERS[PHYSICAL_HEADERS.index(header)] if has_physical_units else header
    number_rows = [
        _parse_line(record_path.name, line_number, header, line_entries)
        for line_number, line_entries in enumerate(csv_lines[1:], 2)
        if line_entries
    ]
    number_columns = [list(heading_or_column) for heading_or_column in zip(*number_rows, strict=True)] or [
        [] for _ in header
    ]
    phase = None if fit_table.phase == "unknown" else float(fit_table.phase)
    try:
        if header == IMPACT_HEADER:
            if fit_table.sigma_v is not None:
                raise ArgumentError("sigma_v", "must be left out for impacts", fit_table.sigma_v)
            measured_record = ImpactRecord(*number_columns, fit_table.sigma, phase, fit_table.flawed)
            return record_from_physical(measured_record, scene) if has_physical_units else measured_record
        times, x, v = [*number_columns, None][:3]
        if not has_physical_units:
            return SampleRecord(times, x, fit_table.sigma, v, fit_table.sigma_v, phase)
        measured_record = SampleRecord(times, MILLI * np.array(x), MILLI * fit_table.sigma, v, fit_table.sigma_v, phase)
        return record_from_physical(measured_record, scene)
    except ArgumentError as error:
        error_key = f"fit.{error.key}" if error.key in TABLE_KEYS else f"{record_path.name}, {error.key}"
        raise SceneError(error_key, error.rule, error.value, error.index) from None


def _parse_line(file_name, line_number, header, line_entries):
    """Return the numbers in a line of the file."""
    error_location = f"{file_name}, line {line_number}"
    if len(line_entries) != len(header):
        raise SceneError(error_location, f"must be {', '.join(header)}", ",".join(line_entries))
    return [
        _parse_entry(error_location, column_name, entry_text.strip())
        for column_name, entry_text in zip(header, line_entries, strict=True)
    ]


def _parse_entry(error_location, column_name, entry_text):
    """Convert an entry of a line to a number; `column_name` is the name of its column."""
    if column_name == "side":
        if entry_text not in SIDE_CODES:
            raise SceneError(error_location, f"must have a side {', '.join(SIDE_CODES)}", entry_text)
        return SIDE_CODES[entry_text]
    try:
        return float(entry_text)
    except ValueError:
        raise SceneError(error_location, f"must have a number for {column_name}", entry_text) from None
