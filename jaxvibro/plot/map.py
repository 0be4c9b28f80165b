"""Draw maps over two parameters: the label or another quantity of each cell as a colour."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, to_hex, to_rgb
from matplotlib.patches import Patch

from ..output import label_codes
from ..scene.check import ArgumentError
from .parameter_plane import prepare_plane
from .style import axes_or_new, cell_edges, checked_picture, escape_formulas, require_dataset, scales_of

# Hues of orbits with 1, 2, ... periods: those of Okabe and Ito and two that differ in lightness, then repeated.
PERIOD_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#B5A000", "#7A4B9E")
WHITE_SHARES = (0.75, 0.0, 0.35, 0.55, 0.18)  # fraction of white, by the number of impacts of the orbit
ASYMMETRY_WHITE = 0.1  # additional white if the left wall has more impacts than the right one
SPECIAL_COLOURS = {label_codes.CHAOTIC: "#303030", label_codes.UNDECIDED: "#C9C9C9", label_codes.NOT_DONE: "#FFFFFF"}
MAX_LEGEND_LABELS = 12  # labels in the legend
SIGNED_QUANTITIES = ("exponent",)  # quantities with a diverging colour map


@checked_picture
def map(
    data: xr.Dataset,
    ax: Axes | None = None,
    quantity: str = "label",
    legend: bool = True,
    units: str = "scene",
) -> Axes:
    """Draw a quantity of a parameter map over its two parameters.

    The second parameter is on the x axis, the first on the y axis. Each label has the same colour in all maps: a hue
    for the number of drive periods, paler or deeper by the number of impacts. Chaos is nearly black, undecided cells
    are grey, cells that are not computed white.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset of `jaxvibro.map_parameters`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    quantity : str, optional
        Variable to draw. Its only dimensions must be the two parameters; select from others first, for example with
        ``data.sel(way=1)``, ``data.isel(attractor=0)`` or ``data.sel(wall="left")``.
    legend : bool, optional
        Add a legend of the labels below the drawing, at most 12 with the most frequent first, or the colour bar of a
        numerical quantity.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing. `locus` and `region` can draw into them.

    Raises
    ------
    ArgumentError
        If `data` is not a Dataset of `jaxvibro.map_parameters`, if `quantity` is not one of its variables or has other
        dimensions, or if `units` is unknown.

    See Also
    --------
    jaxvibro.map_parameters : Compute a map over two or more parameters.
    locus : Draw a locus in the same plane.

    Examples
    --------
    >>> grid = {"amplitude": [1.9, 2.1], "frequency": [2.0, 2.2, 2.4]}
    >>> ax = jv.plot.map(jv.map_parameters(scene, grid, settle=50))
    >>> ax.get_xlabel()[:15]
    'drive frequency'
    """
    require_dataset("map", "map_parameters", ("label", "scene_file"), data)
    if not isinstance(quantity, str) or quantity not in data.data_vars:
        raise ArgumentError("quantity", f"must be one of {_join_names(data.data_vars)}", quantity)
    quantity_data = data[quantity]
    if quantity_data.ndim != 2 or not set(quantity_data.dims) <= set(data.coords):
        rule = "must have two parameters as dimensions; select from the others first, for example data.sel(way=1)"
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
    """Return the colour of a label's code, the same in all maps."""
    if code in SPECIAL_COLOURS:
        return SPECIAL_COLOURS[code]
    period, impact_counts = int(label_codes.period_of(code)), [code // label_codes.LEFT_FACTOR % 1000, code % 1000]
    hue = np.array(to_rgb(PERIOD_COLOURS[(period - 1) % len(PERIOD_COLOURS)]))
    white_share = WHITE_SHARES[sum(impact_counts) % len(WHITE_SHARES)] + (
        ASYMMETRY_WHITE if impact_counts[0] > impact_counts[1] else 0.0
    )
    return to_hex(tuple(hue + (1.0 - hue) * white_share))


def _legend_handles(codes):
    """Return the legend entries: the most frequent labels, and the number of others."""
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
