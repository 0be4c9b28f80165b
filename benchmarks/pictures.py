"""Draw rows as bars beside their requirements, and curves."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib import pyplot as plt

from benchmarks.chart import STYLES, write

# Okabe and Ito's colours are distinct to colour-blind readers; markers and hatches distinguish them in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
MARKERS, HATCHES = "osD^v", ("", "//", "..")


class Panel(NamedTuple):
    """Curves {name: [(x, median and quartiles)]}, horizontal lines `levels` {name: value}, `scale` of both axes."""

    across: str
    up: str
    curves: dict[str, list[tuple[float, Any]]]
    levels: dict[str, float] = {}  # noqa: RUF012  # never changed
    scale: str = "log"


def bars(path, groups, unit, title):
    """Draw groups {name: rows} of bars side by side, with whiskers at the quartiles and a mark at the requirement."""
    names = list(dict.fromkeys(row.what for rows in groups.values() for row in rows if row.found))
    figure, axes = plt.subplots(figsize=(9.0, 1.5 + 0.22 * len(names) * (len(groups) + 0.6)), layout="constrained")
    high, ends = 0.8 / len(groups), []
    for k, (group, rows) in enumerate(groups.items()):
        for row in (row for row in rows if row.found):
            y = names.index(row.what) + high * (k + 0.5) - 0.4
            median, low, top = row.found
            axes.barh(y, median, 0.92 * high, color=COLOURS[k], hatch=HATCHES[k], edgecolor="w", linewidth=0)
            axes.plot([low, top], [y, y], color="k", linewidth=1.2)
            if row.asked is not None:
                axes.plot([row.asked] * 2, [y - 0.46 * high, y + 0.46 * high], color="k", linewidth=2.5)
            ends.append((top, row.asked or 0.0, y, f"{median:,.3g}"))
        axes.barh([0], [0], 0, color=COLOURS[k], hatch=HATCHES[k], label=group)
    longest = max(max(top, asked) for top, asked, _, _ in ends)
    for top, asked, y, words in ends:
        beside = asked if -0.01 < (asked - top) / longest < 0.08 else top  # keeps the mark clear of the text
        axes.text(beside + 0.012 * longest, y, words, va="center", fontsize=8)
    axes.plot([], [], color="k", linewidth=2.5, label="target: at most")
    axes.plot([], [], color="k", linewidth=1.2, label="lower to upper quartile")
    axes.set(yticks=range(len(names)), yticklabels=names, xlabel=unit, xlim=(0, 1.12 * longest))
    axes.set_title(title, fontsize=10)
    axes.invert_yaxis()
    axes.grid(True, axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)
    write(figure, path)


def curves(path, panels, title):
    """Draw panels of curves side by side, with whiskers at the quartiles."""
    wide = max(7.0, 4.6 * len(panels))
    figure, places = plt.subplots(1, len(panels), figsize=(wide, 4.4), layout="constrained", squeeze=False)
    for axes, panel in zip(places[0], panels, strict=True):
        for (name, points), colour, marker in zip(panel.curves.items(), COLOURS, MARKERS, strict=False):
            colour, marker = STYLES.get(name, (colour, marker))  # the hand-written kernel has one style in all pictures
            x = [each for each, _ in points]
            median, low, high = np.array([found for _, found in points]).T
            whiskers = np.maximum(0.0, [median - low, high - median])
            axes.errorbar(x, median, whiskers, color=colour, marker=marker, markersize=5, capsize=2, label=name)
        for (name, level), style in zip(panel.levels.items(), ("--", ":", "-."), strict=False):
            axes.axhline(level, color="k", linestyle=style, linewidth=1.2, label=name)
        axes.set(xscale=panel.scale, yscale=panel.scale, xlabel=panel.across, ylabel=panel.up)
        if panel.scale == "linear":
            axes.set_ylim(0)
        axes.grid(True, which="both", alpha=0.25)
        axes.legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    write(figure, path)
