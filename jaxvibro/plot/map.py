"""Maps over two parameters: each cell in the colour of its label, or of a number."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, to_hex, to_rgb
from matplotlib.patches import Patch

from ..output import label_codes
from ..scene.check import ArgumentError
from .plane import in_plane
from .style import axes, edges, is_from, picture, plain, scales_of

# Of orbits of 1, 2, ... periods; Okabe and Ito's, and two that differ from them in lightness. Further ones begin anew.
HUES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#B5A000", "#7A4B9E")
WHITE = (0.75, 0.0, 0.35, 0.55, 0.18)  # how much of it there is, by the number of an orbit's impacts
ONE_SIDED = 0.1  # more of it where the left wall is hit more often than the right one
OTHERS = {label_codes.CHAOTIC: "#303030", label_codes.UNDECIDED: "#C9C9C9", label_codes.NOT_DONE: "#FFFFFF"}
MOST = 12  # labels that the legend tells
AROUND_ZERO = ("exponent",)  # quantities whose sign matters


@picture
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
    is_from("map", "map_parameters", ("label", "scene_file"), data)
    if not isinstance(quantity, str) or quantity not in data.data_vars:
        raise ArgumentError("quantity", f"must be one of {_words(data.data_vars)}", quantity)
    drawn = data[quantity]
    if drawn.ndim != 2 or not set(drawn.dims) <= set(data.coords):
        rule = "must have two parameters as dimensions: choose from the others first, as data.sel(way=1)"
        raise ArgumentError("quantity", rule, f"{quantity} along {_words(drawn.dims)}")
    up, across = (str(name) for name in drawn.dims)
    ax, sizes = in_plane(axes(ax), (across, up), scales_of(data, units))
    cells = [edges(size * data[name].values) for name, size in zip((across, up), sizes, strict=True)]
    if quantity == "label":
        codes = np.unique(drawn.values)
        places, listed = np.searchsorted(codes, drawn.values), [label_colour(code) for code in codes.tolist()]
        norm = BoundaryNorm(np.arange(-0.5, len(codes)), max(len(codes), 2))
        image = ax.pcolorfast(*cells, places, cmap=ListedColormap(listed + listed[:1]), norm=norm, zorder=0)
    else:
        look = {"cmap": "PuOr_r", "norm": CenteredNorm()} if quantity in AROUND_ZERO else {"cmap": "cividis"}
        image = ax.pcolorfast(*cells, np.ma.masked_invalid(drawn.values), zorder=0, **look)
    image.set_rasterized(True)
    ax.set(xlim=cells[0][[0, -1]], ylim=cells[1][[0, -1]])
    if legend and quantity == "label":
        handles = _entries(drawn.values)
        ax.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.12),
            ncols=4,
            frameon=False,
            fontsize="small",
        )
    elif legend:
        unit = drawn.attrs.get("units", "")
        told = plain(str(drawn.attrs.get("long_name", quantity)))
        ax.figure.colorbar(image, ax=ax, label=told if unit in ("", "1") else f"{told} ({plain(unit)})")
    return ax


def label_colour(code: int) -> str:
    """The colour of a label's code, the same in all maps."""
    if code in OTHERS:
        return OTHERS[code]
    n, hits = int(label_codes.period_of(code)), [code // label_codes.LEFT % 1000, code % 1000]
    own = np.array(to_rgb(HUES[(n - 1) % len(HUES)]))
    white = WHITE[sum(hits) % len(WHITE)] + (ONE_SIDED if hits[0] > hits[1] else 0.0)
    return to_hex(tuple(own + (1.0 - own) * white))


def _entries(codes):
    """The legend: an entry for each of the most frequent labels, and how many there are besides."""
    found, counts = np.unique(codes, return_counts=True)
    order = np.lexsort((found, -counts))
    entries = [
        Patch(facecolor=label_colour(code), edgecolor="0.4", linewidth=0.5, label=label_codes.label_of(code))
        for code in found[order[:MOST]].tolist()
    ]
    if len(found) > MOST:
        entries.append(Patch(facecolor="none", label=f"and {len(found) - MOST} more"))
    return entries


def _words(names):
    return ", ".join(str(name) for name in names)
