"""Shares of attractors along a parameter, as bands that lie on each other."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..attractors.shares import share_bounds
from .style import COLOURS, axes, edges, is_from, of_parameter, paler, picture, plain, scales_of

HUES = tuple(one for one in COLOURS if one != "#000000")  # black is the edges'
CHAOS, UNKNOWN = "....", "/////"  # hatches
GREY = "0.8"
LINE: dict[str, Any] = {"color": "black", "linewidth": 0.5}
ROUNDING = 1e-9  # of sums of shares
LISTED, TOLD = 10, 3  # attractors in the legend, and labels of each, at most
NEEDED = ("swept", "share", "label", "kind", "unresolved", "starts")


@picture
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
    is_from("fractions", "fractions", NEEDED, found)
    name = found.attrs["swept"]
    wide, ax = of_parameter(scales_of(found, units), name), axes(ax)
    across = wide.size * found[name].values
    borders, base, share = edges(across), np.zeros(len(across)), np.nan_to_num(found["share"].values)
    order, colours = _looks(found)
    for row, place in enumerate(order, 1):
        top = base + share[:, place]
        ax.stairs(top, borders, baseline=base, fill=True, color=colours[place], linewidth=0, gid="attractor")
        wild = found["kind"].values[:, place] == "chaotic"
        if wild.any():
            dotted = np.where(wild, top, base)
            ax.stairs(dotted, borders, baseline=base, fill=True, facecolor="none", edgecolor="black", hatch=CHAOS, lw=0)
        ax.stairs(np.where(share[:, place] > 0, top, np.nan), borders, baseline=None, **LINE)
        base = top
        if bounds:
            there = (share[:, place] > 0.0) & (base < 1.0 - ROUNDING)
            # each edge at a place of its own in a bar
            inside = borders[:-1] + row / (len(order) + 1) * np.diff(borders)
            _bounds(ax, inside[there], base[there], found.attrs["starts"])
    top = base + found["unresolved"].values
    ax.stairs(top, borders, baseline=base, fill=True, facecolor=GREY, edgecolor="0.3", hatch=UNKNOWN, lw=0)
    ax.set(xlabel=wide.label, ylabel="share of starts", xlim=borders[[0, -1]], ylim=(0.0, 1.0))
    if legend:
        handles = _entries(found, order, colours)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, frameon=False)
    return ax


def _looks(found):
    """(the attractors from the lowest band up, the colour of each): mirror images side by side."""
    order, colours = [], {}
    mirrors = found["mirror_of"].values
    for place in range(found.sizes["attractor"]):
        if place in order:
            continue
        hue = HUES[len([one for one in colours.values() if one in HUES]) % len(HUES)]
        order.append(place)
        colours[place] = hue
        twins = [int(one) for one in mirrors[:, place] if one >= 0 and one not in order]
        if twins:
            order.append(twins[0])
            colours[twins[0]] = paler(hue)
    return order, colours


def _bounds(ax, across, edge, starts):
    """How far up and down the edge over some bands may be: of the starts below it, counted together."""
    low, high = np.array([share_bounds(round(float(one) * starts), starts) for one in edge]).reshape(-1, 2).T
    ax.vlines(across, low, high, gid="bounds", **LINE)


def _entries(found, order, colours):
    """The legend: an entry for each of the attractors with the largest shares, one for starts on none."""
    total = found["share"].sum(found.attrs["swept"]).values
    listed = set(sorted(order, key=lambda place: -total[place])[:LISTED])
    handles = []
    for place in (one for one in order if one in listed):
        labels = [str(one) for one in dict.fromkeys(found["label"].values[:, place].tolist()) if one]
        told = ", ".join(labels[:TOLD]) + (", ..." if len(labels) > TOLD else "")
        if told in [one.get_label() for one in handles] and colours[place] not in HUES:
            told += " (mirror image)"
        handles.append(Patch(facecolor=colours[place], edgecolor="black", linewidth=0.5, label=plain(told)))
    if (found["kind"] == "chaotic").any():
        handles.append(Patch(facecolor="white", edgecolor="black", hatch=CHAOS, linewidth=0.5, label="where chaotic"))
    if (found["unresolved"] > 0).any():
        handles.append(Patch(facecolor=GREY, edgecolor="0.3", hatch=UNKNOWN, linewidth=0.5, label="not certain"))
    return handles
