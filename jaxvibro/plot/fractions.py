"""Draw basin fractions of attractors along a parameter as stacked bands."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..attractors.shares import share_bounds
from .style import (
    COLOURS,
    axes_or_new,
    cell_edges,
    checked_picture,
    escape_formulas,
    lighten,
    parameter_axis,
    require_dataset,
    scales_of,
)

ATTRACTOR_COLOURS = tuple(colour for colour in COLOURS if colour != "#000000")  # black is reserved for edges
CHAOS_HATCH, UNRESOLVED_HATCH = "....", "/////"
GREY = "0.8"
EDGE_STYLE: dict[str, Any] = {"color": "black", "linewidth": 0.5}
ROUNDING = 1e-9  # tolerance of sums of shares
MAX_LISTED, MAX_LABELS = 10, 3  # attractors in the legend, and labels of each
REQUIRED_NAMES = ("swept", "share", "label", "kind", "unresolved", "starts")


@checked_picture
def fractions(
    found: xr.Dataset, ax: Axes | None = None, legend: bool = True, bounds: bool = True, units: str = "scene"
) -> Axes:
    """Draw basin fractions along a parameter as stacked bands.

    Each attractor keeps its colour along the parameter; its mirror image lies beside it in a paler shade. Chaotic
    attractors are dotted. Initial states without an attractor lie on top, hatched on grey.

    Parameters
    ----------
    found : xarray.Dataset
        Dataset of `jaxvibro.fractions`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    legend : bool, optional
        Add a legend below the drawing. It lists the labels of each attractor along the parameter, for at most ten
        attractors, those with the largest shares.
    bounds : bool, optional
        Draw the 95 % bounds of each edge between two bands as thin vertical lines.
    units : {"scene", "physical"}, optional
        Units of the parameter. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `found` is not a Dataset of `jaxvibro.fractions`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.fractions : Compute basin fractions along a parameter.

    Notes
    -----
    The bar of a value extends half way to the next value.

    Examples
    --------
    >>> ax = jv.plot.fractions(jv.fractions(scene, "amplitude", [1.9, 2.1], starts=20, settle=50))
    >>> ax.get_ylabel()
    'share of starts'
    """
    require_dataset("fractions", "fractions", REQUIRED_NAMES, found)
    parameter = found.attrs["swept"]
    x_axis, ax = parameter_axis(scales_of(found, units), parameter), axes_or_new(ax)
    x = x_axis.factor * found[parameter].values
    borders, bottom, shares = cell_edges(x), np.zeros(len(x)), np.nan_to_num(found["share"].values)
    order, colours = _attractor_colours(found)
    for row, attractor in enumerate(order, 1):
        top = bottom + shares[:, attractor]
        ax.stairs(top, borders, baseline=bottom, fill=True, color=colours[attractor], linewidth=0, gid="attractor")
        is_chaotic = found["kind"].values[:, attractor] == "chaotic"
        if is_chaotic.any():
            chaotic_top = np.where(is_chaotic, top, bottom)
            ax.stairs(
                chaotic_top,
                borders,
                baseline=bottom,
                fill=True,
                facecolor="none",
                edgecolor="black",
                hatch=CHAOS_HATCH,
                lw=0,
            )
        ax.stairs(np.where(shares[:, attractor] > 0, top, np.nan), borders, baseline=None, **EDGE_STYLE)
        bottom = top
        if bounds:
            has_edge = (shares[:, attractor] > 0.0) & (bottom < 1.0 - ROUNDING)
            # Each edge has its own position inside a bar, so that the bounds do not overlap.
            bar_positions = borders[:-1] + row / (len(order) + 1) * np.diff(borders)
            _draw_bounds(ax, bar_positions[has_edge], bottom[has_edge], found.attrs["starts"])
    top = bottom + found["unresolved"].values
    ax.stairs(top, borders, baseline=bottom, fill=True, facecolor=GREY, edgecolor="0.3", hatch=UNRESOLVED_HATCH, lw=0)
    ax.set(xlabel=x_axis.label, ylabel="share of starts", xlim=borders[[0, -1]], ylim=(0.0, 1.0))
    if legend:
        handles = _legend_handles(found, order, colours)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, frameon=False)
    return ax


def _attractor_colours(dataset):
    """Return (attractors from the lowest band up, colour of each), with mirror images side by side."""
    order, colours = [], {}
    mirrors = dataset["mirror_of"].values
    for attractor in range(dataset.sizes["attractor"]):
        if attractor in order:
            continue
        colour = ATTRACTOR_COLOURS[
            len([item for item in colours.values() if item in ATTRACTOR_COLOURS]) % len(ATTRACTOR_COLOURS)
        ]
        order.append(attractor)
        colours[attractor] = colour
        twins = [int(item) for item in mirrors[:, attractor] if item >= 0 and item not in order]
        if twins:
            order.append(twins[0])
            colours[twins[0]] = lighten(colour)
    return order, colours


def _draw_bounds(ax, x, edge_shares, n_starts):
    """Draw the bounds of the edges over some bands, from the number of initial states below each edge."""
    lower, upper = (
        np.array([share_bounds(round(float(share) * n_starts), n_starts) for share in edge_shares]).reshape(-1, 2).T
    )
    ax.vlines(x, lower, upper, gid="bounds", **EDGE_STYLE)


def _legend_handles(dataset, order, colours):
    """Return the legend entries: the attractors with the largest shares, and states without one."""
    total_shares = dataset["share"].sum(dataset.attrs["swept"]).values
    listed_attractors = set(sorted(order, key=lambda attractor: -total_shares[attractor])[:MAX_LISTED])
    handles = []
    for attractor in (item for item in order if item in listed_attractors):
        labels = [str(item) for item in dict.fromkeys(dataset["label"].values[:, attractor].tolist()) if item]
        text = ", ".join(labels[:MAX_LABELS]) + (", ..." if len(labels) > MAX_LABELS else "")
        if text in [item.get_label() for item in handles] and colours[attractor] not in ATTRACTOR_COLOURS:
            text += " (mirror image)"
        handles.append(
            Patch(facecolor=colours[attractor], edgecolor="black", linewidth=0.5, label=escape_formulas(text))
        )
    if (dataset["kind"] == "chaotic").any():
        handles.append(
            Patch(facecolor="white", edgecolor="black", hatch=CHAOS_HATCH, linewidth=0.5, label="where chaotic")
        )
    if (dataset["unresolved"] > 0).any():
        handles.append(
            Patch(facecolor=GREY, edgecolor="0.3", hatch=UNRESOLVED_HATCH, linewidth=0.5, label="not certain")
        )
    return handles
