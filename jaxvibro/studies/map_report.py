"""Format a map over parameters as a table and as a picture, and count its labels."""

import msgspec
import numpy as np
from matplotlib.figure import Figure

from .. import plot
from ..output import label_codes
from ..output.table_text import align_columns, column_header
from ..output.units import display_unit, read_scales
from ..scene.check import ArgumentError
from ..scene.scene_table import SceneTable
from .result_pictures import describe_scene, png_bytes

MAX_LABELS = 20  # rows of the table
DIRECTIONS = {1: "up", -1: "down"}
QUANTITY_TITLES = {
    "exponent": "largest exponent",
    "attractors": "attractors of a cell",
    "work_rate": "work rate of the walls",
}


def map_parameter_names(map_data):
    """Return the names of the parameters of a map, in the order of its dimensions."""
    return [str(dimension_name) for dimension_name in map_data["status"].dims if dimension_name != "way"]


def count_cells_by_label(map_data):
    """Return {label: number of cells}, with the most frequent label first.

    For a map with random starts, the result contains the number of attractors with each label, summed over the cells,
    and the number of cells with undecided initial states.
    """
    distinct_codes, code_counts = np.unique(_cell_label_codes(map_data), return_counts=True)
    count_order = np.lexsort((distinct_codes, -code_counts))
    return {label_codes.label_of(int(distinct_codes[index])): int(code_counts[index]) for index in count_order}


def _cell_label_codes(map_data):
    """Return the label codes of all cells.

    For a map with random starts, these are the codes of all attractors of the cells, one undecided code for each cell
    with undecided initial states, and one code `NOT_DONE` for each attractor index of a cell that is not computed.
    """
    cell_codes = map_data["label"].values
    if "attractor" not in map_data["label"].dims:
        return cell_codes.ravel()
    undecided_codes = np.full(int((map_data["unresolved"].values > 0).sum()), label_codes.UNDECIDED, cell_codes.dtype)
    return np.concatenate(
        [cell_codes[map_data["share"].values > 0], cell_codes[cell_codes == label_codes.NOT_DONE], undecided_codes]
    )


def map_lines(map_data, units="scene"):
    """Yield the lines of the table of a map."""
    scales = read_scales(map_data) if units == "physical" else None
    axis_names = map_parameter_names(map_data)
    yield f"map over {' and '.join(axis_names)}: {' x '.join(str(map_data.sizes[name]) for name in axis_names)} cells"
    parameter_rows = [("parameter", "from", "to", "values")]
    for name in axis_names:
        unit, unit_factor = display_unit(map_data[name].attrs.get("units", ""), scales)
        parameter_values = unit_factor * map_data[name].values
        parameter_rows.append(
            (
                column_header(name, unit, units),
                float(parameter_values[0]),
                float(parameter_values[-1]),
                len(parameter_values),
            )
        )
    yield align_columns(parameter_rows)
    counts_by_label = count_cells_by_label(map_data)
    n_total = sum(counts_by_label.values())
    yield ""
    share_notes = {"way": ", each going up and down", "attractor": ", of their attractors"}
    yield "share: of the cells" + "".join(text for name, text in share_notes.items() if name in map_data.dims)
    label_rows = [(name, count, f"{100.0 * count / n_total:.2f} %") for name, count in counts_by_label.items()]
    remainder_row = (
        [(f"{len(label_rows) - MAX_LABELS} more", sum(label_row[1] for label_row in label_rows[MAX_LABELS:]), "")]
        if len(label_rows) > MAX_LABELS
        else []
    )
    yield align_columns([("label", "count", "share"), *label_rows[:MAX_LABELS], *remainder_row])
    for name, text in QUANTITY_TITLES.items():
        if name in map_data and np.isfinite(map_data[name].values).any():
            unit, unit_factor = display_unit(map_data[name].attrs.get("units", ""), scales)
            min_value, max_value = (
                unit_factor * float(extremum_function(map_data[name].values))
                for extremum_function in (np.nanmin, np.nanmax)
            )
            yield f"{column_header(text, unit, units)}: {min_value:.6g} to {max_value:.6g}"
    if "stopped" in map_data.attrs:
        yield map_data.attrs["stopped"]


def draw_map_picture(map_data, units="scene"):
    """Draw a map over two parameters and return the PNG bytes.

    If the map has a sweep, the picture has a panel for each direction. For a map with random starts, the panels show
    the attractor with the largest basin fraction and the number of attractors. Raises ArgumentError if the map does not
    have two parameters.
    """
    axis_names = map_parameter_names(map_data)
    if len(axis_names) != 2:
        rule = "must be of two parameters to be drawn: open the store with xarray and choose"
        raise ArgumentError("map", rule, ", ".join(axis_names))
    panels = [("", map_data, "label")]
    if "way" in map_data.dims:
        panels = [
            (f"{map_data.attrs['along']} {DIRECTIONS[direction]}", map_data.sel(way=direction), "label")
            for direction in DIRECTIONS
        ]
    if "attractor" in map_data.dims:
        panels = [("largest share", map_data.isel(attractor=0), "label")]
        panels += [("attractors", map_data, "attractors")] if "attractors" in map_data else []
    figure = Figure(figsize=(6.5 * len(panels), 6.5), layout="constrained")
    for ax, (panel_title, panel_data, quantity_name) in zip(
        np.ravel(figure.subplots(1, len(panels))), panels, strict=True
    ):
        plot.map(panel_data, ax, quantity_name, units=units)
        ax.set_title(panel_title, fontsize="medium")
    scene = msgspec.toml.decode(map_data.attrs["scene_file"], type=SceneTable).make()
    figure.suptitle(describe_scene(scene, axis_names, units), fontsize="medium")
    return png_bytes(figure)
