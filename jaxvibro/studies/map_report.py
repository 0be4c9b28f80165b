"""A map told: its table, its numbers for machines, its picture."""

import msgspec
import numpy as np
from matplotlib.figure import Figure

from .. import plot
from ..output import label_codes
from ..output.table_text import columns, headed
from ..output.units import scales_from, told
from ..scene.check import ArgumentError
from ..scene.scene_table import SceneTable
from .figures import described, png

MOST = 20  # labels in the table
WAYS = {1: "up", -1: "down"}
NUMBERS = {"exponent": "largest exponent", "attractors": "attractors of a cell", "work_rate": "work rate of the walls"}


def grid_of(data):
    """The names of a map's parameters, in order."""
    return [str(name) for name in data["status"].dims if name != "way"]


def counts(data):
    """{label: cells} of a map, the most frequent first; of random starts attractors in place of cells."""
    found, many = np.unique(_labels(data), return_counts=True)
    order = np.lexsort((found, -many))
    return {label_codes.label_of(int(found[k])): int(many[k]) for k in order}


def _labels(data):
    """Of cells; or with random starts of attractors, and an undecided one for each cell that has undecided starts."""
    codes = data["label"].values
    if "attractor" not in data["label"].dims:
        return codes.ravel()
    undecided = np.full(int((data["unresolved"].values > 0).sum()), label_codes.UNDECIDED, codes.dtype)
    return np.concatenate([codes[data["share"].values > 0], codes[codes == label_codes.NOT_DONE], undecided])


def lines(data, units="scene"):
    """The table of a map, line by line."""
    scales = scales_from(data) if units == "physical" else None
    names = grid_of(data)
    yield f"map over {' and '.join(names)}: {' x '.join(str(data.sizes[name]) for name in names)} cells"
    rows = [("parameter", "from", "to", "values")]
    for name in names:
        unit, size = told(data[name].attrs.get("units", ""), scales)
        values = size * data[name].values
        rows.append((headed(name, unit, units), float(values[0]), float(values[-1]), len(values)))
    yield columns(rows)
    found = counts(data)
    total = sum(found.values())
    yield ""
    more = {"way": ", each going up and down", "attractor": ", of their attractors"}
    yield "share: of the cells" + "".join(text for name, text in more.items() if name in data.dims)
    listed = [(name, count, f"{100.0 * count / total:.2f} %") for name, count in found.items()]
    rest = [(f"{len(listed) - MOST} more", sum(row[1] for row in listed[MOST:]), "")] if len(listed) > MOST else []
    yield columns([("label", "count", "share"), *listed[:MOST], *rest])
    for name, text in NUMBERS.items():
        if name in data and np.isfinite(data[name].values).any():
            unit, size = told(data[name].attrs.get("units", ""), scales)
            low, high = (size * float(edge(data[name].values)) for edge in (np.nanmin, np.nanmax))
            yield f"{headed(text, unit, units)}: {low:.6g} to {high:.6g}"
    if "stopped" in data.attrs:
        yield data.attrs["stopped"]


def picture(data, units="scene"):
    """The picture of a map over two parameters, a panel for each way that it was carried, or, of random starts, for the
    largest share and for the number of attractors; a PNG's bytes. Raises ArgumentError for another number of them."""
    names = grid_of(data)
    if len(names) != 2:
        rule = "must be of two parameters to be drawn: open the store with xarray and choose"
        raise ArgumentError("map", rule, ", ".join(names))
    panels = [("", data, "label")]
    if "way" in data.dims:
        panels = [(f"{data.attrs['along']} {WAYS[way]}", data.sel(way=way), "label") for way in WAYS]
    if "attractor" in data.dims:
        panels = [("largest share", data.isel(attractor=0), "label")]
        panels += [("attractors", data, "attractors")] if "attractors" in data else []
    figure = Figure(figsize=(6.5 * len(panels), 6.5), layout="constrained")
    for ax, (title, part, quantity) in zip(np.ravel(figure.subplots(1, len(panels))), panels, strict=True):
        plot.map(part, ax, quantity, units=units)
        ax.set_title(title, fontsize="medium")
    scene = msgspec.toml.decode(data.attrs["scene_file"], type=SceneTable).make()
    figure.suptitle(described(scene, names, units), fontsize="medium")
    return png(figure)
