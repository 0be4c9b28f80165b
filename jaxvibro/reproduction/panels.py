"""The panels of a scene file: the same asked of several scenes. And the sheets that figures are drawn on."""

from dataclasses import dataclass, field
from io import BytesIO

import msgspec
import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.figure import Figure

from ..scene.scene_table import table_of
from .claim import Claim

DOTS = 300  # per inch
WIDE = 5.0  # inches: at a column's width, 8.6 cm, texts are of 6 points; on a slide they are large enough
STYLE = {"font.size": 9.5, "axes.titlesize": 9.5, "legend.fontsize": 8.5, "axes.linewidth": 0.8}


@dataclass(frozen=True, eq=False)
class Drawn:
    """A figure computed. picture: a PNG's bytes, None where there is none; caption; claims; data: by an ending."""

    picture: bytes | None
    caption: str
    claims: tuple[Claim, ...]
    data: dict[str, xr.Dataset] = field(default_factory=dict)


def panels(file):
    """The scene file of each of its panels."""
    scene = file.scene.make()
    return [
        msgspec.structs.replace(file, scene=table_of(scene.replace(**values)), panels={})
        for values in file.panel_values
    ]


def sheet(rows, columns, height):
    """(Figure, Axes in an array) for panels; height: of one of them, inches."""
    figure = Figure(figsize=(WIDE, height * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def trim(places, shared=True, ticks=5):
    """Labels at the sheet's edge alone, their symbols and units; numbers too where all panels have the same ranges.

    ticks: numbers along each panel, at most."""
    for (row, column), ax in np.ndenumerate(places):
        across, up = (label[label.find("$") :] for label in (ax.get_xlabel(), ax.get_ylabel()))
        is_last = row + 1 == len(places) or not places[row + 1, column].axison
        ax.set(xlabel=across if is_last else "", ylabel="" if column else up)
        ax.locator_params(axis="x", nbins=ticks)
        if shared:
            ax.label_outer()


def legend(figure, places, columns=3, without=()):
    """One legend below all panels, each entry once; without: group ids of what is left out."""
    told = {}
    for ax in places.flat:
        for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
            if handle.get_gid() not in without:
                told.setdefault(text, handle)
    figure.legend(told.values(), told.keys(), loc="outside lower center", ncols=columns, frameon=False)


def png(figure):
    """A figure as a PNG's bytes."""
    held = BytesIO()
    figure.savefig(held, format="png", dpi=DOTS)
    return held.getvalue()


def styled():
    """The style that all figures share, for a `with` block in which they are drawn and saved."""
    return rc_context(STYLE)
