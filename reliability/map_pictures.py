"""Pictures of the maps of failure: a panel a method, the same cells in all."""

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

from benchmarks import chart, page

from .methods import OURS

LABELS = {
    "amplitude": "A",
    "omega": "omega",
    "restitution": "R",
    "gamma": "gamma",
}
LEFT_OUT = "0.75"


def save(path, found, count):
    """Write the picture of a `FailureMap` of so many periods to a PNG."""
    names = [OURS, *(name for name in found.first if name != OURS)]
    figure, grid = plt.subplots(2, 5, figsize=(13.5, 6.0), layout="constrained", sharex=True, sharey=True)
    colours = plt.get_cmap("viridis").copy()
    colours.set_over("white")
    colours.set_bad(LEFT_OUT)
    for axes, name in zip(grid.flat, names, strict=False):
        first = np.where(found.judged, found.first[name], np.nan)
        shown = axes.pcolormesh(
            *found.values, first, cmap=colours, vmin=0, vmax=count - 1, edgecolors="0.9", linewidth=0.2
        )
        wrong = int((found.judged & (found.first[name] < count)).sum())
        axes.set_title(f"{name}: {wrong} of {found.judged.sum()}", fontsize=9)
    for axes in grid.flat[len(names) :]:
        axes.axis("off")
    figure.colorbar(shown, ax=grid, label="first period with a wrong itinerary", extend="max", shrink=0.8)
    figure.supxlabel(LABELS[found.names[0]])
    figure.supylabel(LABELS[found.names[1]])
    figure.suptitle(
        f"Wrong itineraries within {count} periods; white: none; grey: chaotic or with rests, not judged", fontsize=10
    )
    chart.write(figure, path)


def table(maps, count):
    """Markdown of {words: FailureMap}: cells in which a method is wrong."""
    names = [OURS, *(name for name in next(iter(maps.values())).first if name != OURS)]
    lines = []
    for words, found in maps.items():
        wrong = [int((found.judged & (found.first[name] < count)).sum()) for name in names]
        cells = (f"**{each}**" if each else "0" for each in wrong)
        lines.append((words, f"{found.judged.sum()} of {found.judged.size}", *cells))
    return page.table(("map", "cells judged", *names), lines)
