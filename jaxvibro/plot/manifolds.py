"""Draw invariant manifolds in the plane of the stroboscopic section."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from .style import (
    COLOURS,
    WALL_COLOUR,
    add_legend,
    axes_or_new,
    checked_picture,
    escape_formulas,
    phase_plane_axes,
    require_dataset,
    scales_of,
)

# Marker of each reason for a final end. A curve continues beyond a grazing and an impact at the phase of the section.
END_MARKERS = {"attractor": "o", "length": "s", "points": "D", "resolution": "^", "fast": "v"}
KIND_STYLES = {"stable": (COLOURS[2], "-"), "unstable": (COLOURS[7], (0, (5, 2)))}


@checked_picture
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
    A marker shows each final end of the curve, and the legend states the reason. Fixed walls are grey lines.

    Examples
    --------
    >>> saddle = branch.orbit(len(branch) - 1)
    >>> ax = jv.plot.manifold(jv.manifold(saddle, "unstable", length=1.0))
    >>> ax.get_legend_handles_labels()[1][0][:20]
    'unstable manifold of'
    """
    require_dataset("manifold", "manifold", ("kind", "piece", "x", "v"), dataset)
    x_axis, y_axis = phase_plane_axes(scales_of(dataset, units))
    is_new, ax = ax is None, axes_or_new(ax)
    kind_colour, dashes = KIND_STYLES[dataset.attrs["kind"]]
    breaks = np.flatnonzero(np.diff(dataset["piece"].values)) + 1
    states = x_axis.factor * dataset["x"].values, y_axis.factor * dataset["v"].values
    x, v = (np.insert(coordinate, breaks, np.nan) for coordinate in states)
    legend_text = f"{dataset.attrs['kind']} manifold of {escape_formulas(dataset.attrs['label'])}"
    line_style: dict[str, Any] = {"color": colour or kind_colour, "linestyle": dashes, "linewidth": 0.9}
    ax.plot(x, v, label=legend_text, gid="manifold", zorder=2, **line_style)
    if saddle:
        start_rows = np.flatnonzero(dataset["arc"].values == 0)
        marker_style: dict[str, Any] = {
            "linestyle": "none",
            "marker": "X",
            "markersize": 8,
            "color": "white",
            "markeredgecolor": "black",
        }
        ax.plot(*(coordinate[start_rows] for coordinate in states), gid="saddle", zorder=4, **marker_style)
    _mark_ends(ax, dataset, states, line_style["color"])
    _draw_walls(ax, dataset.attrs, x_axis.factor)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    add_legend(ax, is_new)
    return ax


def _mark_ends(ax, dataset, states, colour):
    """Mark the two ends of each piece, with one marker for each reason."""
    pieces = dataset["piece"].values
    known_labels = {line.get_label() for line in ax.lines if line.get_gid() == "end"}
    starts, stops = np.searchsorted(pieces, np.unique(pieces)), np.searchsorted(pieces, np.unique(pieces), "right") - 1
    end_rows = np.append(starts, stops)
    reasons = np.append(*(dataset[name].values.astype(str) for name in ("began", "ended")))
    for reason, marker in END_MARKERS.items():
        rows, legend_text = end_rows[reasons == reason], f"end: {reason}"
        if not len(rows):
            continue
        marker_style = {"marker": marker, "markersize": 4.5, "markerfacecolor": "white"}
        marker_style |= {
            "linestyle": "none",
            "markeredgecolor": colour,
            "label": f"_{legend_text}" if legend_text in known_labels else legend_text,
        }
        ax.plot(*(coordinate[rows] for coordinate in states), gid="end", zorder=3.5, **marker_style)


def _draw_walls(ax, attrs, factor):
    known_positions = [line.get_xdata()[0] for line in ax.lines if line.get_gid() == "wall"]
    for side in ("left", "right"):
        position = attrs.get(f"{side}.position")
        if (
            position is not None
            and f"{side}.motion.amplitude" not in attrs
            and factor * position not in known_positions
        ):
            ax.axvline(factor * position, color=WALL_COLOUR, linewidth=0.8, zorder=1, gid="wall")
