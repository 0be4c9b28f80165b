"""Make the scene files of the panels of a figure, and the figures themselves."""

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
    """Recomputed figure.

    Attributes
    ----------
    picture : bytes or None
        Image as PNG; None for a job without a figure.
    caption : str
        Caption.
    claims : tuple of Claim
        Claims on the figure.
    data : dict of str to Dataset
        Data, by the ending of their file names.
    """

    picture: bytes | None
    caption: str
    claims: tuple[Claim, ...]
    data: dict[str, xr.Dataset] = field(default_factory=dict)


def panel_files(file):
    """Return the scene file of each panel of a scene file."""
    scene = file.scene.make()
    return [
        msgspec.structs.replace(file, scene=make_scene_table(scene.replace(**values)), panels={})
        for values in file.panel_values
    ]


def make_figure(rows, columns, height):
    """Return (Figure, array of Axes) for panels of a height in inches."""
    figure = Figure(figsize=(FIGURE_WIDTH, height * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def trim_labels(axes_grid, shared=True, max_ticks=5):
    """Keep labels at the edge of a figure only, as symbols and units, and numbers too if the panels share their ranges.

    `max_ticks` is the largest number of ticks on the x axis of a panel.
    """
    for (row, column), ax in np.ndenumerate(axes_grid):
        x_label, y_label = (label[label.find("$") :] for label in (ax.get_xlabel(), ax.get_ylabel()))
        is_last = row + 1 == len(axes_grid) or not axes_grid[row + 1, column].axison
        ax.set(xlabel=x_label if is_last else "", ylabel="" if column else y_label)
        ax.locator_params(axis="x", nbins=max_ticks)
        if shared:
            ax.label_outer()


def add_legend(figure, axes_grid, columns=3, excluded_gids=()):
    """Add one legend below all panels, each entry once, without artists that have one of `excluded_gids`."""
    entries = {}
    for ax in axes_grid.flat:
        for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
            if handle.get_gid() not in excluded_gids:
                entries.setdefault(text, handle)
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False)


def png_bytes(figure):
    """Return a figure as the bytes of a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def figure_style():
    """Return the context manager of the style in which all figures are drawn and saved."""
    return rc_context(RC_STYLE)
