"""The panels of a scene file: the same asked of several scenes. And the sheets that figures are drawn on."""

from dataclasses import dataclass, field
from io import BytesIO

import msgspec
import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.figure import Figure

from ..scene.scene_table import make_scene_table
from .claim import Claim

DPI = 300  # per inch
FIGURE_WIDTH = 5.0  # inches: at a column's width, 8.6 cm, texts are of 6 points; on a slide they are large enough
RC_STYLE = {"font.size": 9.5, "axes.titlesize": 9.5, "legend.fontsize": 8.5, "axes.linewidth": 0.8}


@dataclass(frozen=True, eq=False)
class FigureResult:
    """A figure computed. picture: a PNG's bytes, None where there is none; caption; claims; data: by an ending."""

    picture: bytes | None
    caption: str
    claims: tuple[Claim, ...]
    data: dict[str, xr.Dataset] = field(default_factory=dict)


def panel_files(file):
    """The scene file of each of its panels."""
    scene = file.scene.make()
    return [
        msgspec.structs.replace(file, scene=make_scene_table(scene.replace(**values)), panels={})
        for values in file.panel_values
    ]


def make_figure(rows, columns, height):
    """(Figure, Axes in an array) for panels; height: of one of them, inches."""
    figure = Figure(figsize=(FIGURE_WIDTH, height * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def trim_labels(axes_grid, shared=True, max_ticks=5):
    """Labels at the sheet's edge alone, their symbols and units; numbers too where all panels have the same ranges.

    max_ticks: numbers along each panel, at most."""
    for (row, column), ax in np.ndenumerate(axes_grid):
        x_label, y_label = (label[label.find("$") :] for label in (ax.get_xlabel(), ax.get_ylabel()))
        is_last = row + 1 == len(axes_grid) or not axes_grid[row + 1, column].axison
        ax.set(xlabel=x_label if is_last else "", ylabel="" if column else y_label)
        ax.locator_params(axis="x", nbins=max_ticks)
        if shared:
            ax.label_outer()


def add_legend(figure, axes_grid, columns=3, excluded_gids=()):
    """One legend below all panels, each entry once; excluded_gids: group ids of what is left out."""
    entries = {}
    for ax in axes_grid.flat:
        for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
            if handle.get_gid() not in excluded_gids:
                entries.setdefault(text, handle)
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False)


def png_bytes(figure):
    """A figure as a PNG's bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def figure_style():
    """The style that all figures share, for a `with` block in which they are drawn and saved."""
    return rc_context(RC_STYLE)
