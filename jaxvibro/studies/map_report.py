"""Format a map: its table, its numbers for machines and its picture."""

import msgspec
import numpy as np
from matplotlib.figure import Figure

from .. import plot
from ..output import label_codes
from ..output.table_text import align_columns, column_header
from ..output.units import display_unit, read_scales
from ..scene.check import ArgumentError
from ..scene.scene_table import SceneTable
from .figures import describe_scene, png_bytes

MAX_LABELS = 20  # rows of the table
DIRECTIONS = {1: "up", -1: "down"}
QUANTITY_TITLES = {
    "exponent": "largest exponent",
    "attractors": "attractors of a cell",
    "work_rate": "work rate of the walls",
}


def parameter_names(data):
    """Return the names of a map's parameters, in order."""
    return [str(name) for name in data["status"].dims if name != "way"]


def label_counts(data):
    """Return {label: number of cells}, the most frequent first; with random starts, the number of attractors."""
    codes, frequencies = np.unique(_cell_labels(data), return_counts=True)
    order = np.lexsort((codes, -frequencies))
    return {label_codes.label_of(int(codes[k])): int(frequencies[k]) for k in order}


def _cell_labels(data):
    """Return the label codes of the cells.

    With random starts these are codes of attractors, with one undecided code per cell that has undecided starts.
    """
    codes = data["label"].values
    if "attractor" not in data["label"].dims:
        return codes.ravel()
    undecided = np.full(int((data["unresolved"].values > 0).sum()), label_codes.UNDECIDED, codes.dtype)
    return np.concatenate([codes[data["share"].values > 0], codes[codes == label_codes.NOT_DONE], undecided])


def map_lines(data, units="scene"):
    """Iterate over the lines of the table of a map."""
    scales = read_scales(data) if units == "physical" else None
    names = parameter_names(data)
    yield f"map over {' and '.join(names)}: {' x '.join(str(data.sizes[name]) for name in names)} cells"
    rows = [("parameter", "from", "to", "values")]
    for name in names:
        unit, factor = display_unit(data[name].attrs.get("units", ""), scales)
        values = factor * data[name].values
        rows.append((column_header(name, unit, units), float(values[0]), float(values[-1]), len(values)))
    yield align_columns(rows)
    cells_by_label = label_counts(data)
    total = sum(cells_by_label.values())
    yield ""
    notes = {"way": ", each going up and down", "attractor": ", of their attractors"}
    yield "share: of the cells" + "".join(text for name, text in notes.items() if name in data.dims)
    entries = [(name, count, f"{100.0 * count / total:.2f} %") for name, count in cells_by_label.items()]
    remainder = (
        [(f"{len(entries) - MAX_LABELS} more", sum(row[1] for row in entries[MAX_LABELS:]), "")]
        if len(entries) > MAX_LABELS
        else []
    )
    yield align_columns([("label", "count", "share"), *entries[:MAX_LABELS], *remainder])
    for name, text in QUANTITY_TITLES.items():
        if name in data and np.isfinite(data[name].values).any():
            unit, factor = display_unit(data[name].attrs.get("units", ""), scales)
            lower, upper = (factor * float(extremum(data[name].values)) for extremum in (np.nanmin, np.nanmax))
            yield f"{column_header(text, unit, units)}: {lower:.6g} to {upper:.6g}"
    if "stopped" in data.attrs:
        yield data.attrs["stopped"]


def map_picture(data, units="scene"):
    """Draw a map over two parameters and return the PNG bytes.

    The picture has one panel per direction of the sweep. With random starts the panels show the largest basin fraction
    and the number of attractors. Raises ArgumentError for another number of parameters.
    """
    names = parameter_names(data)
    if len(names) != 2:
        rule = "must be of two parameters to be drawn: open the store with xarray and choose"
        raise ArgumentError("map", rule, ", ".join(names))
    panels = [("", data, "label")]
    if "way" in data.dims:
        panels = [
            (f"{data.attrs['along']} {DIRECTIONS[direction]}", data.sel(way=direction), "label")
            for direction in DIRECTIONS
        ]
    if "attractor" in data.dims:
        panels = [("largest share", data.isel(attractor=0), "label")]
        panels += [("attractors", data, "attractors")] if "attractors" in data else []
    figure = Figure(figsize=(6.5 * len(panels), 6.5), layout="constrained")
    for ax, (title, panel_data, quantity) in zip(np.ravel(figure.subplots(1, len(panels))), panels, strict=True):
        plot.map(panel_data, ax, quantity, units=units)
        ax.set_title(title, fontsize="medium")
    scene = msgspec.toml.decode(data.attrs["scene_file"], type=SceneTable).make()
    figure.suptitle(describe_scene(scene, names, units), fontsize="medium")
    return png_bytes(figure)
