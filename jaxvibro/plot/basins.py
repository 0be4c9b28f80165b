"""Draw basins of attraction with the points of the attractors."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..attractors.basin_labels import OUTSIDE, UNRESOLVED
from .style import (
    WALL_COLOUR,
    axes_or_new,
    cell_edges,
    checked_picture,
    escape_formulas,
    phase_plane_axes,
    require_dataset,
    scales_of,
)

# Pale variants of the colours of Okabe and Ito, from light to dark, so that they differ in grey too.
PALE_COLOURS = ("#FCEFB4", "#A9DCF5", "#F2AE72", "#72AD91", "#A9719A", "#4C79AD", "#94502F", "#3F5750")
CHAOS_COLOURS, UNRESOLVED_COLOUR = ("#FFFFFF", "#C9C9C9", "#E6E6E6"), "#303030"
CHAOS_DOT_COLOURS = ("#000000", "#B03A00", "#00517F")  # of chaotic attractors
# The second of two mirror images has the reflected marker; a symmetric motion has a marker without direction.
MIRROR_MARKERS = (("<", ">"), ("^", "v"), ("$\\subset$", "$\\supset$"), ("P", "X"))
SINGLE_MARKERS = ("o", "s", "D", "p", "h", "8")


@checked_picture
def basins(dataset: xr.Dataset, ax: Axes | None = None, legend: bool = True, units: str = "scene") -> Axes:
    """Draw basins of attraction in the plane of position and velocity.

    Each attractor has its own colour, from light to dark, and its own marker. Basins of chaotic attractors are white or
    grey, and the points of the attractors are dots. Initial states without an attractor are nearly black, those beyond
    a wall grey.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of `jaxvibro.basins`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    legend : bool, optional
        Add a legend below the drawing, with the shares of the initial states.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `dataset` is not a Dataset of `jaxvibro.basins`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.basins : Compute basins of attraction on a grid.
    manifold : Draw an invariant manifold in the same plane.

    Notes
    -----
    The markers of two mirror images are mirror images of each other.

    Examples
    --------
    >>> ax = jv.plot.basins(jv.basins(scene, np.linspace(-1.0, 1.0, 8), np.linspace(-2.0, 2.0, 6)))
    >>> ax.get_xlabel()[:8]
    'position'
    """
    require_dataset("basins", "basins", ("label", "fraction", "x", "v"), dataset)
    x_axis, y_axis = phase_plane_axes(scales_of(dataset, units))
    ax = axes_or_new(ax)
    colours, markers = _attractor_styles(dataset)
    palette = [WALL_COLOUR, UNRESOLVED_COLOUR, *colours]
    norm = BoundaryNorm(np.arange(OUTSIDE - 0.5, len(colours)), len(palette))
    borders = [cell_edges(axis.factor * dataset[name].values) for axis, name in ((x_axis, "x"), (y_axis, "v"))]
    image = ax.pcolorfast(*borders, dataset["label"].values, cmap=ListedColormap(palette), norm=norm, zorder=0)
    image.set_rasterized(True)
    for index, marker in enumerate(markers):
        points = x_axis.factor * dataset["point_x"].values[index], y_axis.factor * dataset["point_v"].values[index]
        ax.plot(*points, **_marker_style(marker, colours[index]), gid="attractor", zorder=3 if marker == "." else 3.5)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.set(xlim=borders[0][[0, -1]], ylim=borders[1][[0, -1]])
    if legend:
        handles = _legend_handles(dataset, colours, markers)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    return ax


def _attractor_styles(dataset):
    """Return (colours, markers) of the attractors, with the marker "." for chaotic ones."""
    colours, markers = [], [None] * dataset.sizes["attractor"]
    marker_pairs, single_markers, pale_colours, chaos_colours = (
        iter(MIRROR_MARKERS * 8),
        iter(SINGLE_MARKERS * 8),
        iter(PALE_COLOURS * 8),
        iter(CHAOS_COLOURS * 8),
    )
    for index, (kind, mirror_index) in enumerate(zip(dataset["kind"].values, dataset["mirror_of"].values, strict=True)):
        colours.append(next(chaos_colours if kind == "chaotic" else pale_colours))
        if kind != "periodic":
            markers[index] = "."
        elif markers[index] is None and mirror_index > index:
            markers[index], markers[mirror_index] = next(marker_pairs)
        elif markers[index] is None:
            markers[index] = next(single_markers)
    return colours, markers


def _marker_style(marker, colour):
    if marker == ".":
        dot_colour = dict(zip(CHAOS_COLOURS, CHAOS_DOT_COLOURS, strict=True)).get(colour, CHAOS_DOT_COLOURS[0])
        return {"linestyle": "none", "marker": ".", "markersize": 1.5, "color": dot_colour}
    return {"linestyle": "none", "marker": marker, "markersize": 9, "color": colour, "markeredgecolor": "black"}


def _legend_handles(dataset, colours, markers):
    """Return the legend entries: one per attractor, and those of states without one."""
    handles = []
    for index, marker in enumerate(markers):
        if dataset["kind"].values[index] == "unresolved":
            continue
        text = f"{escape_formulas(str(dataset['name'].values[index]))}: {100 * float(dataset['fraction'][index]):.1f} %"
        if marker == ".":
            handles.append(
                Patch(facecolor=colours[index], edgecolor=_marker_style(marker, colours[index])["color"], label=text)
            )
        else:
            handles.append(Line2D([], [], label=text, **_marker_style(marker, colours[index])))
    labels = dataset["label"].values
    if (labels == UNRESOLVED).any():
        handles.append(Patch(facecolor=UNRESOLVED_COLOUR, label="not certain"))
    if (labels == OUTSIDE).any():
        handles.append(Patch(facecolor=WALL_COLOUR, label="beyond a wall"))
    return handles
