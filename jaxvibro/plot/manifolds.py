"""Draw invariant manifolds in the plane of the stroboscopic section."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from .style import (
    COLOURS,
    WALL_COLOUR,
    WALL_GID,
    add_legend,
    axes_or_new,
    check_plot_options,
    escape_formulas,
    fixed_wall_positions,
    label_once,
    phase_plane_axes,
    require_dataset,
    scales_of,
)

# Marker of each reason for a final end. A curve continues beyond a grazing and an impact at the phase of the section.
END_MARKERS = {"attractor": "o", "length": "s", "points": "D", "resolution": "^", "fast": "v"}
KIND_STYLES = {"stable": (COLOURS[2], "-"), "unstable": (COLOURS[7], (0, (5, 2)))}


@check_plot_options
def manifold(
    dataset: xr.Dataset,
    ax: Axes | None = None,
    colour: ColorType | None = None,
    saddle: bool = True,
    units: str = "scene",
) -> Axes:
    """Draw an invariant manifold, velocity against position.

    A stable manifold is a solid black line, an unstable one a dashed orange-red line. The line breaks where the
    manifold is discontinuous.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of `jaxvibro.manifold`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure, whose Axes get a legend.
    colour : colour, optional
        Colour of the line. None takes the colour of its kind.
    saddle : bool, optional
        Mark the points of the saddle with crosses.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `dataset` is not a Dataset of `jaxvibro.manifold`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.manifold : Compute a stable or unstable manifold.
    basins : Draw basins of attraction.

    Notes
    -----
    A marker shows where the curve ends, and the legend states why it ends there. An end due to `max_seconds` has no
    marker. Fixed walls are grey lines.

    Examples
    --------
    >>> saddle = branch.orbit(len(branch) - 1)
    >>> ax = jv.plot.manifold(jv.manifold(saddle, "unstable", length=1.0))
    >>> ax.get_legend_handles_labels()[1][0][:20]
    'unstable manifold of'
    """
    require_dataset("manifold", "manifold", ("kind", "piece", "x", "v"), dataset)
    x_axis, y_axis = phase_plane_axes(scales_of(dataset, units))
    is_new_axes, ax = ax is None, axes_or_new(ax)
    kind_colour, kind_dash_pattern = KIND_STYLES[dataset.attrs["kind"]]
    piece_breaks = np.flatnonzero(np.diff(dataset["piece"].values)) + 1
    scaled_coordinates = x_axis.factor * dataset["x"].values, y_axis.factor * dataset["v"].values
    x, v = (np.insert(coordinate, piece_breaks, np.nan) for coordinate in scaled_coordinates)
    line_colour = colour or kind_colour
    ax.plot(
        x,
        v,
        label=f"{dataset.attrs['kind']} manifold of {escape_formulas(dataset.attrs['label'])}",
        gid="manifold",
        color=line_colour,
        linestyle=kind_dash_pattern,
        linewidth=0.9,
        zorder=2,
    )
    if saddle:
        saddle_row_indices = np.flatnonzero(dataset["arc"].values == 0)
        ax.plot(
            *(coordinate[saddle_row_indices] for coordinate in scaled_coordinates),
            gid="saddle",
            linestyle="none",
            marker="X",
            markersize=8,
            color="white",
            markeredgecolor="black",
            zorder=4,
        )
    _mark_piece_ends(ax, dataset, scaled_coordinates, line_colour)
    _draw_walls(ax, dataset.attrs, x_axis.factor)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    add_legend(ax, is_new_axes)
    return ax


def _mark_piece_ends(ax, dataset, scaled_coordinates, colour):
    """Mark the ends of the curve, with a separate marker for each reason in `END_MARKERS`."""
    piece_numbers = dataset["piece"].values
    first_rows, last_rows = (
        np.searchsorted(piece_numbers, np.unique(piece_numbers)),
        np.searchsorted(piece_numbers, np.unique(piece_numbers), "right") - 1,
    )
    end_rows = np.append(first_rows, last_rows)
    end_reasons = np.append(*(dataset[name].values.astype(str) for name in ("began", "ended")))
    for end_reason, marker in END_MARKERS.items():
        reason_rows = end_rows[end_reasons == end_reason]
        if not len(reason_rows):
            continue
        ax.plot(
            *(coordinate[reason_rows] for coordinate in scaled_coordinates),
            label=label_once(ax, "end", f"end: {end_reason}"),
            gid="end",
            linestyle="none",
            marker=marker,
            markersize=4.5,
            markerfacecolor="white",
            markeredgecolor=colour,
            zorder=3.5,
        )


def _draw_walls(ax, manifold_attrs, position_factor):
    known_positions = [line.get_xdata()[0] for line in ax.lines if line.get_gid() == WALL_GID]
    for position in fixed_wall_positions(manifold_attrs):
        if position_factor * position not in known_positions:
            ax.axvline(position_factor * position, color=WALL_COLOUR, linewidth=0.8, zorder=1, gid=WALL_GID)
