"""Draw basin fractions of attractors along a parameter as stacked bands."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..attractors.basin_fraction_bounds import compute_share_bounds
from .style import (
    COLOURS,
    axes_or_new,
    cell_edges,
    check_plot_options,
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


@check_plot_options
def fractions(
    found: xr.Dataset, ax: Axes | None = None, legend: bool = True, bounds: bool = True, units: str = "scene"
) -> Axes:
    """Draw basin fractions along a parameter as stacked bands.

    Each attractor keeps its colour along the parameter; its mirror image lies beside it in a paler shade. Chaotic
    attractors are dotted. Initial states whose attractor is not certain lie on top, hatched on grey.

    Parameters
    ----------
    found : xarray.Dataset
        Dataset of `jaxvibro.fractions`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    legend : bool, optional
        Add a legend below the drawing. It lists at most ten attractors, those with the largest shares, and up to three
        labels of each.
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
    The bar of a value extends half way to the neighbouring values.

    Examples
    --------
    >>> ax = jv.plot.fractions(jv.fractions(scene, "amplitude", [1.9, 2.1], starts=20, settle=50))
    >>> ax.get_ylabel()
    'share of starts'
    """
    require_dataset("fractions", "fractions", REQUIRED_NAMES, found)
    parameter_name = found.attrs["swept"]
    x_axis, ax = parameter_axis(scales_of(found, units), parameter_name), axes_or_new(ax)
    x = x_axis.factor * found[parameter_name].values
    bar_borders, band_bottom, basin_shares = cell_edges(x), np.zeros(len(x)), np.nan_to_num(found["share"].values)
    attractor_order, attractor_colours = _order_and_colours(found)
    for band_number, attractor_index in enumerate(attractor_order, 1):
        band_top = band_bottom + basin_shares[:, attractor_index]
        _fill_band(ax, bar_borders, band_bottom, band_top, color=attractor_colours[attractor_index], gid="attractor")
        is_chaotic = found["kind"].values[:, attractor_index] == "chaotic"
        if is_chaotic.any():
            chaotic_top = np.where(is_chaotic, band_top, band_bottom)
            _fill_band(
                ax, bar_borders, band_bottom, chaotic_top, facecolor="none", edgecolor="black", hatch=CHAOS_HATCH
            )
        ax.stairs(
            np.where(basin_shares[:, attractor_index] > 0, band_top, np.nan), bar_borders, baseline=None, **EDGE_STYLE
        )
        band_bottom = band_top
        if bounds:
            has_visible_edge = (basin_shares[:, attractor_index] > 0.0) & (band_bottom < 1.0 - ROUNDING)
            # Each edge has its own position inside a bar, so that the bounds do not overlap.
            bound_positions = bar_borders[:-1] + band_number / (len(attractor_order) + 1) * np.diff(bar_borders)
            _draw_share_bounds(
                ax, bound_positions[has_visible_edge], band_bottom[has_visible_edge], found.attrs["starts"]
            )
    band_top = band_bottom + found["unresolved"].values
    _fill_band(ax, bar_borders, band_bottom, band_top, facecolor=GREY, edgecolor="0.3", hatch=UNRESOLVED_HATCH)
    ax.set(xlabel=x_axis.label, ylabel="share of starts", xlim=bar_borders[[0, -1]], ylim=(0.0, 1.0))
    if legend:
        handles = _legend_handles(found, attractor_order, attractor_colours)
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, frameon=False)
    return ax


def _fill_band(ax, bar_borders, band_bottom, band_top, **patch_style):
    """Fill a band between two step functions, without an edge."""
    ax.stairs(band_top, bar_borders, baseline=band_bottom, fill=True, linewidth=0, **patch_style)


def _order_and_colours(dataset):
    """Return (attractors in order of their bands from below, {attractor: colour}), with mirror images side by side."""
    attractor_order, colours = [], {}
    mirror_indices = dataset["mirror_of"].values
    for attractor_index in range(dataset.sizes["attractor"]):
        if attractor_index in attractor_order:
            continue
        colour = ATTRACTOR_COLOURS[
            len([assigned_colour for assigned_colour in colours.values() if assigned_colour in ATTRACTOR_COLOURS])
            % len(ATTRACTOR_COLOURS)
        ]
        attractor_order.append(attractor_index)
        colours[attractor_index] = colour
        mirror_images = [
            int(mirror_index)
            for mirror_index in mirror_indices[:, attractor_index]
            if mirror_index >= 0 and mirror_index not in attractor_order
        ]
        if mirror_images:
            attractor_order.append(mirror_images[0])
            colours[mirror_images[0]] = lighten(colour)
    return attractor_order, colours


def _draw_share_bounds(ax, bound_positions, edge_shares, n_starts):
    """Draw the 95 % bounds of band edges; `edge_shares` are the shares of the initial states below the edges."""
    lower_bounds, upper_bounds = (
        np.array([compute_share_bounds(round(float(edge_share) * n_starts), n_starts) for edge_share in edge_shares])
        .reshape(-1, 2)
        .T
    )
    ax.vlines(bound_positions, lower_bounds, upper_bounds, gid="bounds", **EDGE_STYLE)


def _legend_handles(dataset, attractor_order, colours):
    """Return the legend entries of the attractors with the largest shares, of chaos and of uncertain states."""
    total_shares = dataset["share"].sum(dataset.attrs["swept"]).values
    listed_attractors = set(sorted(attractor_order, key=lambda attractor: -total_shares[attractor])[:MAX_LISTED])
    handles = []
    for attractor_index in (attractor for attractor in attractor_order if attractor in listed_attractors):
        labels = [str(label) for label in dict.fromkeys(dataset["label"].values[:, attractor_index].tolist()) if label]
        legend_text = ", ".join(labels[:MAX_LABELS]) + (", ..." if len(labels) > MAX_LABELS else "")
        if (
            legend_text in [handle.get_label() for handle in handles]
            and colours[attractor_index] not in ATTRACTOR_COLOURS
        ):
            legend_text += " (mirror image)"
        handles.append(
            Patch(
                facecolor=colours[attractor_index], edgecolor="black", linewidth=0.5, label=escape_formulas(legend_text)
            )
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
