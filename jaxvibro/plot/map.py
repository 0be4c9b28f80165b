"""Draw maps over two parameters: the label or another quantity of each cell as a colour."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, to_hex, to_rgb
from matplotlib.patches import Patch

from ..output import label_codes
from ..scene.check import ArgumentError
from .plane_axes import prepare_plane
from .style import axes_or_new, cell_edges, check_plot_options, escape_formulas, require_dataset, scales_of

# Hues of orbits with 1, 2, ... periods: those of Okabe and Ito and two that differ in lightness, then repeated.
PERIOD_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#B5A000", "#7A4B9E")
WHITE_SHARES = (0.75, 0.0, 0.35, 0.55, 0.18)  # fraction of white, by the number of impacts of the orbit
ASYMMETRY_WHITE = 0.1  # additional white if the left wall has more impacts than the right one
SPECIAL_COLOURS = {label_codes.CHAOTIC: "#303030", label_codes.UNDECIDED: "#C9C9C9", label_codes.NOT_DONE: "#FFFFFF"}
MAX_LEGEND_LABELS = 12  # labels in the legend
SIGNED_QUANTITIES = ("exponent",)  # quantities with a diverging colour map


@check_plot_options
def map(
    data: xr.Dataset,
    ax: Axes | None = None,
    quantity: str = "label",
    legend: bool = True,
    units: str = "scene",
) -> Axes:
    """Draw a quantity of a parameter map over its two parameters.

    The second parameter is on the x axis, the first on the y axis. Each label has the same colour in all maps. The hue
    depends on the number of drive periods, the lightness on the number of impacts. Chaos is nearly black. Undecided
    cells are grey, and cells that are not computed are white.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset of `jaxvibro.map_parameters`.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    quantity : str, optional
        Variable to draw. Its only dimensions must be the two parameters. Select an entry of each other dimension first,
        for example with ``data.sel(way=1)``, ``data.isel(attractor=0)`` or ``data.sel(wall="left")``.
    legend : bool, optional
        Add a legend of the most frequent labels, at most 12, below the drawing, or the colour bar of a numerical
        quantity.
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
        error_rule = "must have two parameters as dimensions; select from the others first, for example data.sel(way=1)"
        raise ArgumentError("quantity", error_rule, f"{quantity} along {_join_names(quantity_data.dims)}")
    y_name, x_name = (str(name) for name in quantity_data.dims)
    ax, axis_factors = prepare_plane(axes_or_new(ax), (x_name, y_name), scales_of(data, units))
    cell_borders = [
        cell_edges(axis_factor * data[name].values)
        for name, axis_factor in zip((x_name, y_name), axis_factors, strict=True)
    ]
    if quantity == "label":
        unique_codes = np.unique(quantity_data.values)
        colour_indices, palette = (
            np.searchsorted(unique_codes, quantity_data.values),
            [label_colour(label_code) for label_code in unique_codes.tolist()],
        )
        colour_norm = BoundaryNorm(np.arange(-0.5, len(unique_codes)), max(len(unique_codes), 2))
        cell_image = ax.pcolorfast(
            *cell_borders, colour_indices, cmap=ListedColormap(palette + palette[:1]), norm=colour_norm, zorder=0
        )
    else:
        colour_style = (
            {"cmap": "PuOr_r", "norm": CenteredNorm()} if quantity in SIGNED_QUANTITIES else {"cmap": "cividis"}
        )
        cell_image = ax.pcolorfast(*cell_borders, np.ma.masked_invalid(quantity_data.values), zorder=0, **colour_style)
    cell_image.set_rasterized(True)
    ax.set(xlim=cell_borders[0][[0, -1]], ylim=cell_borders[1][[0, -1]])
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
        quantity_unit = quantity_data.attrs.get("units", "")
        label = escape_formulas(str(quantity_data.attrs.get("long_name", quantity)))
        ax.figure.colorbar(
            cell_image,
            ax=ax,
            label=label if quantity_unit in ("", "1") else f"{label} ({escape_formulas(quantity_unit)})",
        )
    return ax


def label_colour(label_code: int) -> str:
    """Return the colour of a label's code, the same in all maps."""
    if label_code in SPECIAL_COLOURS:
        return SPECIAL_COLOURS[label_code]
    n_periods, impact_counts = (
        int(label_codes.period_of(label_code)),
        [label_code // label_codes.LEFT_FACTOR % 1000, label_code % 1000],
    )
    base_colour = np.array(to_rgb(PERIOD_COLOURS[(n_periods - 1) % len(PERIOD_COLOURS)]))
    white_fraction = WHITE_SHARES[sum(impact_counts) % len(WHITE_SHARES)] + (
        ASYMMETRY_WHITE if impact_counts[0] > impact_counts[1] else 0.0
    )
    return to_hex(tuple(base_colour + (1.0 - base_colour) * white_fraction))


def _legend_handles(cell_codes):
    """Return the legend entries of the most frequent labels, and an entry with the number of other labels."""
    unique_codes, cell_counts = np.unique(cell_codes, return_counts=True)
    order_by_cell_count = np.lexsort((unique_codes, -cell_counts))
    handles = [
        Patch(
            facecolor=label_colour(label_code), edgecolor="0.4", linewidth=0.5, label=label_codes.label_of(label_code)
        )
        for label_code in unique_codes[order_by_cell_count[:MAX_LEGEND_LABELS]].tolist()
    ]
    if len(unique_codes) > MAX_LEGEND_LABELS:
        handles.append(Patch(facecolor="none", label=f"and {len(unique_codes) - MAX_LEGEND_LABELS} more"))
    return handles


def _join_names(names):
    return ", ".join(str(name) for name in names)
