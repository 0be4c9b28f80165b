"""Make the scene files of the panels of a figure, and lay out and save figures."""

from dataclasses import dataclass, field
from io import BytesIO

import msgspec
import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.figure import Figure

from ..scene.scene_table import make_scene_table
from .claim import Claim

DPI = 300  # dots per inch
FIGURE_WIDTH = 5.0  # inches: text has 6 points at a column width of 8.6 cm and is large enough for slides
RC_STYLE = {"font.size": 9.5, "axes.titlesize": 9.5, "legend.fontsize": 8.5, "axes.linewidth": 0.8}


@dataclass(frozen=True, eq=False)
class FigureResult:
    """Reproduced figure with its claims and data.

    Attributes
    ----------
    picture : bytes or None
        Image as PNG; None for a job without a figure.
    caption : str
        Caption.
    claims : tuple of Claim
        Claims on the figure.
    data : dict of str to Dataset
        Datasets by the suffix of their file names.
    """

    picture: bytes | None
    caption: str
    claims: tuple[Claim, ...]
    data: dict[str, xr.Dataset] = field(default_factory=dict)


def panel_scene_files(scene_file):
    """Return a `SceneFile` for each panel of a scene file."""
    scene = scene_file.scene.make()
    return [
        msgspec.structs.replace(scene_file, scene=make_scene_table(scene.replace(**panel_values)), panels={})
        for panel_values in scene_file.panel_values
    ]


def make_figure(n_rows, n_columns, panel_height):
    """Return (Figure, array of Axes) for rows and columns of panels; `panel_height` is in inches per panel."""
    figure = Figure(figsize=(FIGURE_WIDTH, panel_height * n_rows), layout="constrained")
    return figure, figure.subplots(n_rows, n_columns, squeeze=False)


def trim_axis_labels(axes_grid, has_shared_ranges=True, max_ticks=5):
    """Remove axis labels between the panels of a figure and shorten the others to symbols and units.

    If the panels share their ranges, tick labels between them are also removed. `max_ticks` is the largest number of
    ticks on the x axis of a panel.
    """
    for (row, column), ax in np.ndenumerate(axes_grid):
        x_label, y_label = (axis_label[axis_label.find("$") :] for axis_label in (ax.get_xlabel(), ax.get_ylabel()))
        is_bottom_panel = row + 1 == len(axes_grid) or not axes_grid[row + 1, column].axison
        ax.set(xlabel=x_label if is_bottom_panel else "", ylabel="" if column else y_label)
        ax.locator_params(axis="x", nbins=max_ticks)
        if has_shared_ranges:
            ax.label_outer()


def add_figure_legend(figure, axes_grid, n_columns=3, excluded_artist_ids=()):
    """Add a legend for all panels below them; artists with one of `excluded_artist_ids` have no entry."""
    handle_by_text = {}
    for ax in axes_grid.flat:
        for legend_handle, legend_text in zip(*ax.get_legend_handles_labels(), strict=True):
            if legend_handle.get_gid() not in excluded_artist_ids:
                handle_by_text.setdefault(legend_text, legend_handle)
    figure.legend(
        handle_by_text.values(), handle_by_text.keys(), loc="outside lower center", ncols=n_columns, frameon=False
    )


def png_bytes(figure):
    """Return a figure as the bytes of a PNG file."""
    png_buffer = BytesIO()
    figure.savefig(png_buffer, format="png", dpi=DPI)
    return png_buffer.getvalue()


def figure_style():
    """Return a context manager that sets the style of all figures."""
    return rc_context(RC_STYLE)
