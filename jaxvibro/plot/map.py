"""Maps over two parameters: each cell in the colour of its label, or of a number."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, to_hex, to_rgb
from matplotlib.patches import Patch

from ..output import label_codes
from ..scene.check import ArgumentError
from .parameter_plane import prepare_plane
from .style import axes_or_new, cell_edges, checked_picture, escape_formulas, require_dataset, scales_of

# Of orbits of 1, 2, ... periods; Okabe and Ito's, and two that differ from them in lightness. Further ones begin anew.
PERIOD_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#B5A000", "#7A4B9E")
WHITE_SHARES = (0.75, 0.0, 0.35, 0.55, 0.18)  # how much of it there is, by the number of an orbit's impacts
ASYMMETRY_WHITE = 0.1  # more of it where the left wall is hit more often than the right one
SPECIAL_COLOURS = {label_codes.CHAOTIC: "#303030", label_codes.UNDECIDED: "#C9C9C9", label_codes.NOT_DONE: "#FFFFFF"}
MAX_LEGEND_LABELS = 12  # labels that the legend tells
SIGNED_QUANTITIES = ("exponent",)  # quantities whose sign matters


@checked_picture
def map(
    data: xr.Dataset,
    ax: Axes | None = None,
    quantity: str = "label",
    legend: bool = True,
    units: str = "scene",
) -> Axes:
    """Draw a Dataset of `jaxvibro.map_parameters` over its two parameters, the second across, the first up: the Axes.

    quantity: the variable that is drawn, with no other dimension than these: of a map with more, first choose, as
    data.sel(way=1), data.isel(attractor=0) or data.sel(wall="left"). A label has its own colour, the same in all maps:
    a hue for the orbit's periods, paler or deeper by how many impacts it has; chaos is nearly black, what is undecided
    grey, what is not done white. legend: below the picture the labels, the most frequent first, 12 at most; beside it
    the scale of a number. units: "scene", or "physical" of a scene that has scales. `locus` and `region` draw over it.

    Raises ArgumentError for what is no such Dataset, and for other quantities and units.
    """
    require_dataset("map", "map_parameters", ("label", "scene_file"), data)
    if not isinstance(quantity, str) or quantity not in data.data_vars:
        raise ArgumentError("quantity", f"must be one of {_join_names(data.data_vars)}", quantity)
    quantity_data = data[quantity]
    if quantity_data.ndim != 2 or not set(quantity_data.dims) <= set(data.coords):
        rule = "must have two parameters as dimensions: choose from the others first, as data.sel(way=1)"
        raise ArgumentError("quantity", rule, f"{quantity} along {_join_names(quantity_data.dims)}")
    y_name, x_name = (str(name) for name in quantity_data.dims)
    ax, factors = prepare_plane(axes_or_new(ax), (x_name, y_name), scales_of(data, units))
    borders = [cell_edges(factor * data[name].values) for name, factor in zip((x_name, y_name), factors, strict=True)]
    if quantity == "label":
        codes = np.unique(quantity_data.values)
        colour_indices, palette = (
            np.searchsorted(codes, quantity_data.values),
            [label_colour(code) for code in codes.tolist()],
        )
        norm = BoundaryNorm(np.arange(-0.5, len(codes)), max(len(codes), 2))
        image = ax.pcolorfast(*borders, colour_indices, cmap=ListedColormap(palette + palette[:1]), norm=norm, zorder=0)
    else:
        colour_style = (
            {"cmap": "PuOr_r", "norm": CenteredNorm()} if quantity in SIGNED_QUANTITIES else {"cmap": "cividis"}
        )
        image = ax.pcolorfast(*borders, np.ma.masked_invalid(quantity_data.values), zorder=0, **colour_style)
    image.set_rasterized(True)
    ax.set(xlim=borders[0][[0, -1]], ylim=borders[1][[0, -1]])
    if legend and quantity == "label":
        handles = _legend_handles(quantity_data.values)
        ax.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.12),
            ncols=4,
            frameon=False,
            fontsize="small",
        )
    elif legend:
        unit = quantity_data.attrs.get("units", "")
        label = escape_formulas(str(quantity_data.attrs.get("long_name", quantity)))
        ax.figure.colorbar(image, ax=ax, label=label if unit in ("", "1") else f"{label} ({escape_formulas(unit)})")
    return ax


def label_colour(code: int) -> str:
    """The colour of a label's code, the same in all maps."""
    if code in SPECIAL_COLOURS:
        return SPECIAL_COLOURS[code]
    period, impact_counts = int(label_codes.period_of(code)), [code // label_codes.LEFT_FACTOR % 1000, code % 1000]
    hue = np.array(to_rgb(PERIOD_COLOURS[(period - 1) % len(PERIOD_COLOURS)]))
    white_share = WHITE_SHARES[sum(impact_counts) % len(WHITE_SHARES)] + (
        ASYMMETRY_WHITE if impact_counts[0] > impact_counts[1] else 0.0
    )
    return to_hex(tuple(hue + (1.0 - hue) * white_share))


def _legend_handles(codes):
    """The legend: an entry for each of the most frequent labels, and how many there are besides."""
    unique_codes, counts = np.unique(codes, return_counts=True)
    order = np.lexsort((unique_codes, -counts))
    handles = [
        Patch(facecolor=label_colour(code), edgecolor="0.4", linewidth=0.5, label=label_codes.label_of(code))
        for code in unique_codes[order[:MAX_LEGEND_LABELS]].tolist()
    ]
    if len(unique_codes) > MAX_LEGEND_LABELS:
        handles.append(Patch(facecolor="none", label=f"and {len(unique_codes) - MAX_LEGEND_LABELS} more"))
    return handles


def _join_names(names):
    return ", ".join(str(name) for name in names)
