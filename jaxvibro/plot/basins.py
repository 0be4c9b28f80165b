"""Basins of attraction: each start in the colour of what it ends on, and the attractors' own points."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..attractors.assign import OUTSIDE, UNRESOLVED
from .style import WALL, axes, edges, is_from, of_plane, picture, plain, scales_of

# Pale kin of Okabe and Ito's colours, from light to dark, so that they are told in grey too.
PALE = ("#FCEFB4", "#A9DCF5", "#F2AE72", "#72AD91", "#A9719A", "#4C79AD", "#94502F", "#3F5750")
CHAOS, UNKNOWN = ("#FFFFFF", "#C9C9C9", "#E6E6E6"), "#303030"
DOTS = ("#000000", "#B03A00", "#00517F")  # of chaotic attractors
# Of mirror images the second has the turned shape, of a motion that is its own image the shape has no direction.
PAIRS = (("<", ">"), ("^", "v"), ("$\\subset$", "$\\supset$"), ("P", "X"))
SINGLE = ("o", "s", "D", "p", "h", "8")


@picture
def basins(dataset: xr.Dataset, ax: Axes | None = None, legend: bool = True, units: str = "scene") -> Axes:
    """Draw a Dataset of `jaxvibro.basins`, velocity against position: the Axes.

    Each attractor has a colour, the lightest the first, and a shape for its points; of two mirror images the shapes
    mirror each other. Chaos is white or a grey, its points are dots, black or of a dark colour. Starts on no attractor
    are nearly black, those beyond a wall grey. legend: below the picture, with the shares of the starts. units:
    "scene", or "physical" of a scene that has scales.

    Raises ArgumentError for what is no such Dataset, and for other units.
    """
    is_from("basins", "basins", ("label", "fraction", "x", "v"), dataset)
    across, up = of_plane(scales_of(dataset, units))
    ax = axes(ax)
    colours, shapes = _looks(dataset)
    listed = [WALL, UNKNOWN, *colours]
    norm = BoundaryNorm(np.arange(OUTSIDE - 0.5, len(colours)), len(listed))
    borders = [edges(axis.size * dataset[name].values) for axis, name in ((across, "x"), (up, "v"))]
    drawn = ax.pcolorfast(*borders, dataset["label"].values, cmap=ListedColormap(listed), norm=norm, zorder=0)
    drawn.set_rasterized(True)
    for place, shape in enumerate(shapes):
        points = across.size * dataset["point_x"].values[place], up.size * dataset["point_v"].values[place]
        ax.plot(*points, **_mark(shape, colours[place]), gid="attractor", zorder=3 if shape == "." else 3.5)
    ax.set(xlabel=across.label, ylabel=up.label)
    ax.set(xlim=borders[0][[0, -1]], ylim=borders[1][[0, -1]])
    if legend:
        handles = _entries(dataset, colours, shapes)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    return ax


def _looks(dataset):
    """(colours, shapes) of the attractors, a shape "." where chaotic."""
    colours, shapes = [], [None] * dataset.sizes["attractor"]
    pairs, single, pale, chaos = iter(PAIRS * 8), iter(SINGLE * 8), iter(PALE * 8), iter(CHAOS * 8)
    for place, (kind, twin) in enumerate(zip(dataset["kind"].values, dataset["mirror_of"].values, strict=True)):
        colours.append(next(chaos if kind == "chaotic" else pale))
        if kind != "periodic":
            shapes[place] = "."
        elif shapes[place] is None and twin > place:
            shapes[place], shapes[twin] = next(pairs)
        elif shapes[place] is None:
            shapes[place] = next(single)
    return colours, shapes


def _mark(shape, colour):
    if shape == ".":
        dots = dict(zip(CHAOS, DOTS, strict=True)).get(colour, DOTS[0])
        return {"linestyle": "none", "marker": ".", "markersize": 1.5, "color": dots}
    return {"linestyle": "none", "marker": shape, "markersize": 9, "color": colour, "markeredgecolor": "black"}


def _entries(dataset, colours, shapes):
    """The legend: an entry for each attractor, and for starts on none."""
    found = []
    for place, shape in enumerate(shapes):
        if dataset["kind"].values[place] == "unresolved":
            continue
        told = f"{plain(str(dataset['name'].values[place]))}: {100 * float(dataset['fraction'][place]):.1f} %"
        if shape == ".":
            found.append(Patch(facecolor=colours[place], edgecolor=_mark(shape, colours[place])["color"], label=told))
        else:
            found.append(Line2D([], [], label=told, **_mark(shape, colours[place])))
    label = dataset["label"].values
    if (label == UNRESOLVED).any():
        found.append(Patch(facecolor=UNKNOWN, label="not certain"))
    if (label == OUTSIDE).any():
        found.append(Patch(facecolor=WALL, label="beyond a wall"))
    return found
