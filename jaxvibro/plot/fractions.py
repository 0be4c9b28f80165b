"""Shares of attractors along a parameter, as bands that lie on each other."""

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

ATTRACTOR_COLOURS = tuple(one for one in COLOURS if one != "#000000")  # black is the edges'
CHAOS_HATCH, UNRESOLVED_HATCH = "....", "/////"  # hatches
GREY = "0.8"
EDGE_STYLE: dict[str, Any] = {"color": "black", "linewidth": 0.5}
ROUNDING = 1e-9  # of sums of shares
MAX_LISTED, MAX_LABELS = 10, 3  # attractors in the legend, and labels of each, at most
REQUIRED_NAMES = ("swept", "share", "label", "kind", "unresolved", "starts")


@checked_picture
def fractions(
    found: xr.Dataset, ax: Axes | None = None, legend: bool = True, bounds: bool = True, units: str = "scene"
) -> Axes:
    """Draw a Dataset of `jaxvibro.fractions`: the Axes.

    At each value of the parameter the shares lie on each other, an attractor's in one colour all along, its mirror
    image's beside it in the paler one; dotted where it is chaotic, and on top, hatched on grey, the starts on none. A
    value's bars reach half way to the next. legend: below the picture, with the labels that each attractor has along
    the parameter, at most ten attractors, those of the largest shares. bounds: thin lines, how far from where it is
    drawn the edge between two bands may be, at 95 %. units: of the parameter, "scene", or "physical" of a scene that
    has scales.

    Raises ArgumentError for what is no such Dataset, and for other units.
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
            # each edge at a place of its own in a bar
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
    """(the attractors from the lowest band up, the colour of each): mirror images side by side."""
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
    """How far up and down the edge over some bands may be: of the starts below it, counted together."""
    lower, upper = (
        np.array([share_bounds(round(float(share) * n_starts), n_starts) for share in edge_shares]).reshape(-1, 2).T
    )
    ax.vlines(x, lower, upper, gid="bounds", **EDGE_STYLE)


def _legend_handles(dataset, order, colours):
    """The legend: an entry for each of the attractors with the largest shares, one for starts on none."""
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
