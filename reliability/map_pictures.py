"""Draw the maps of failure: one panel per method, the same cells in all."""

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from benchmarks import chart, page

from .periods import ROOM

LABELS = {
    "amplitude": "drive amplitude A",
    "omega": "drive frequency omega",
    "restitution": "restitution R",
    "gamma": "damping gamma",
}
CHAOTIC, CROWDED = "0.87", "0.6"
BINS = (1, 2, 3, 6, 11, 31, 101)  # bins of the first wrong period, counted from 1


def save(path, found, count):
    """Write the picture of a `FailureMap` over `count` periods to a PNG."""
    figure, grid = plt.subplots(2, 5, figsize=(13.5, 6.0), layout="constrained", sharex=True, sharey=True)
    colours = plt.get_cmap("plasma", len(BINS) - 1)
    colours.set_bad("none")
    norm, greys = BoundaryNorm(BINS, len(BINS) - 1), ListedColormap([CHAOTIC, CROWDED])
    for axes, name in zip(grid.flat, found.first, strict=False):
        given, wrong = found.first[name], found.judged & (found.first[name] < count)
        left_out = np.where(found.judged, np.nan, found.crowded)
        axes.pcolormesh(*found.values, left_out, cmap=greys, vmin=0, vmax=1)
        shown = axes.pcolormesh(*found.values, np.where(wrong, given + 1.0, np.nan), cmap=colours, norm=norm)
        axes.set_title(f"{name}: {wrong.sum()} of {found.judged.sum()}", fontsize=7.5)
    for axes in grid.flat[len(found.first) :]:
        axes.axis("off")
        axes.legend(
            handles=[
                Patch(facecolor="white", edgecolor="k", label=f"correct for {count} periods"),
                Patch(facecolor=CHAOTIC, label="chaotic: not evaluated"),
                Patch(facecolor=CROWDED, label=f"sticks, or over {ROOM} impacts\nper period: not evaluated"),
            ],
            loc="center",
            fontsize=9,
        )
    figure.colorbar(shown, ax=grid, label="first period with a wrong itinerary", shrink=0.8)
    figure.supxlabel(LABELS[found.names[0]])
    figure.supylabel(LABELS[found.names[1]])
    figure.suptitle(f"Cells with a wrong itinerary within {count} periods", fontsize=10)
    chart.write(figure, path)


def table(maps, count):
    """Format {words: FailureMap} as Markdown: cells in which a method is wrong."""
    names = list(next(iter(maps.values())).first)
    lines = []
    for words, found in maps.items():
        wrong = [int((found.judged & (found.first[name] < count)).sum()) for name in names]
        cells = (f"**{each}**" if each else "0" for each in wrong)
        lines.append((words, f"{found.judged.sum()} of {found.judged.size}", *cells))
    return page.table(("map", "cells evaluated", *names), lines)
