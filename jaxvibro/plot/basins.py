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
    check_plot_options,
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


@check_plot_options
def basins(dataset: xr.Dataset, ax: Axes | None = None, legend: bool = True, units: str = "scene") -> Axes:
    """Draw basins of attraction in the plane of position and velocity.

    Each periodic attractor has a marker. The colours of the basins become darker in the order of the attractors. Basins
    of chaotic attractors are white or grey, with dots at the points of the chaotic attractors. Initial states whose
    attractor is not certain are nearly black. States beyond a wall are grey.

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
    attractor_colours, attractor_markers = _attractor_styles(dataset)
    palette = [WALL_COLOUR, UNRESOLVED_COLOUR, *attractor_colours]
    colour_norm = BoundaryNorm(np.arange(OUTSIDE - 0.5, len(attractor_colours)), len(palette))
    cell_borders = [
        cell_edges(axis.factor * dataset[coordinate_name].values)
        for axis, coordinate_name in ((x_axis, "x"), (y_axis, "v"))
    ]
    cell_image = ax.pcolorfast(
        *cell_borders, dataset["label"].values, cmap=ListedColormap(palette), norm=colour_norm, zorder=0
    )
    cell_image.set_rasterized(True)
    for attractor_index, marker in enumerate(attractor_markers):
        attractor_points = (
            x_axis.factor * dataset["point_x"].values[attractor_index],
            y_axis.factor * dataset["point_v"].values[attractor_index],
        )
        ax.plot(
            *attractor_points,
            **_marker_style(marker, attractor_colours[attractor_index]),
            gid="attractor",
            zorder=3 if marker == "." else 3.5,
        )
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.set(xlim=cell_borders[0][[0, -1]], ylim=cell_borders[1][[0, -1]])
    if legend:
        handles = _legend_handles(dataset, attractor_colours, attractor_markers)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    return ax


def _attractor_styles(dataset):
    """Return (colours, markers) of the attractors, with the marker "." for attractors that are not periodic."""
    colours, markers = [], [None] * dataset.sizes["attractor"]
    marker_pairs, single_markers, periodic_basin_colours, chaos_basin_colours = (
        iter(MIRROR_MARKERS * 8),
        iter(SINGLE_MARKERS * 8),
        iter(PALE_COLOURS * 8),
        iter(CHAOS_COLOURS * 8),
    )
    for attractor_index, (attractor_kind, mirror_index) in enumerate(
        zip(dataset["kind"].values, dataset["mirror_of"].values, strict=True)
    ):
        colours.append(next(chaos_basin_colours if attractor_kind == "chaotic" else periodic_basin_colours))
        if attractor_kind != "periodic":
            markers[attractor_index] = "."
        elif markers[attractor_index] is None and mirror_index > attractor_index:
            markers[attractor_index], markers[mirror_index] = next(marker_pairs)
        elif markers[attractor_index] is None:
            markers[attractor_index] = next(single_markers)
    return colours, markers


def _marker_style(marker, colour):
    if marker == ".":
        dot_colour = dict(zip(CHAOS_COLOURS, CHAOS_DOT_COLOURS, strict=True)).get(colour, CHAOS_DOT_COLOURS[0])
        return {"linestyle": "none", "marker": ".", "markersize": 1.5, "color": dot_colour}
    return {"linestyle": "none", "marker": marker, "markersize": 9, "color": colour, "markeredgecolor": "black"}


def _legend_handles(dataset, colours, markers):
    """Return the legend entries of the attractors, of uncertain initial states and of states beyond a wall."""
    handles = []
    for attractor_index, marker in enumerate(markers):
        if dataset["kind"].values[attractor_index] == "unresolved":
            continue
        legend_text = (
            f"{escape_formulas(str(dataset['name'].values[attractor_index]))}:"
            f" {100 * float(dataset['fraction'][attractor_index]):.1f} %"
        )
        if marker == ".":
            handles.append(
                Patch(
                    facecolor=colours[attractor_index],
                    edgecolor=_marker_style(marker, colours[attractor_index])["color"],
                    label=legend_text,
                )
            )
        else:
            handles.append(Line2D([], [], label=legend_text, **_marker_style(marker, colours[attractor_index])))
    cell_labels = dataset["label"].values
    if (cell_labels == UNRESOLVED).any():
        handles.append(Patch(facecolor=UNRESOLVED_COLOUR, label="not certain"))
    if (cell_labels == OUTSIDE).any():
        handles.append(Patch(facecolor=WALL_COLOUR, label="beyond a wall"))
    return handles
