"""Draw error against cost: one marker per method, one point per setting, wrong itineraries ringed."""

import os
import pathlib

import matplotlib
from matplotlib import patheffects

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from benchmarks.sides import BY_SOLVER, OURS, PLAIN, VMAP, YARDSTICK
from benchmarks.work import words

# Okabe and Ito's colours are distinct to colour-blind readers; markers distinguish the curves in grey. Each picture
# draws those of its walls. An explicit and an implicit method of one package share a hue, never a marker.
STYLES = {
    OURS: ("#D55E00", "*"),
    VMAP: ("#CC79A7", "P"),
    BY_SOLVER: ("#CC79A7", "X"),
    YARDSTICK: ("#000000", "X"),
    "heyoka, batch": ("#0072B2", "o"),
    "heyoka, scalar": ("#56B4E9", "v"),
    "paper's RK4": ("#009E73", "s"),
    "diffrax Tsit5": ("#E69F00", "D"),
    "diffrax Dopri8": ("#8C6000", "h"),
    "diffrax Kvaerno5": ("#8C6000", "d"),
    "SciPy DOP853": ("#7F7F7F", "^"),
    "SciPy RK45": ("#009E73", "^"),
    "SciPy LSODA": ("#CC79A7", "s"),
    PLAIN: ("#7F7F7F", "X"),
    "SciPy Radau": ("#000000", "p"),
}
# This value, below the rounding error of 1, stands for an error of 0 on a logarithmic axis.
LEAST = 1e-17
SPAN = 1e-16, 1e-1  # range of the errors in panels
TIME = "time per map on one core (ns)"
ERROR = "error of x and x' after one period (dimensionless)\nmedian; line up to the 99th percentile"


def draw(axes, rows):
    """Draw rows (side, timing, verdict) on axes."""
    for method, (colour, marker) in STYLES.items():
        points = [(timing.cost[0], verdict) for side, timing, verdict in rows if side.method == method]
        if points:
            draw_method(axes, method, points, colour, marker)
    axes.scatter([], [], s=190, facecolors="none", edgecolors="k", label="ring: fraction of wrong itineraries")
    axes.set(xscale="log", yscale="log")
    axes.grid(True, which="major", alpha=0.3)


def draw_method(axes, method, points, colour, marker):
    """Draw the points (cost in ns, verdict) of one method, joined in the order of its settings."""
    costs = [cost for cost, _ in points]
    medians = [max(verdict.median, LEAST) for _, verdict in points]
    highs = [max(verdict.high, LEAST) for _, verdict in points]
    size = 13 if marker == "*" else 7
    axes.plot(costs, medians, color=colour, marker=marker, markersize=size, linewidth=1.2, label=method)
    axes.vlines(costs, medians, highs, color=colour, linewidth=1.0, alpha=0.7)
    for cost, median, (_, verdict) in zip(costs, medians, points, strict=True):
        if verdict.wrong:
            axes.scatter(cost, median, s=190, facecolors="none", edgecolors="k", linewidths=1.0, zorder=3)
            words = f"{100 * verdict.wrong / verdict.judged:.2g} %"
            place = {"xytext": (-9, -3), "textcoords": "offset points", "ha": "right", "zorder": 4}
            told = axes.annotate(words, (cost, median), fontsize=7, **place)
            told.set_path_effects([patheffects.withStroke(linewidth=2.0, foreground="w")])


def save(path, rows, title):
    """Write the chart to a PNG."""
    figure, axes = plt.subplots(figsize=(9.5, 5.2), layout="constrained")
    draw(axes, rows)
    axes.set(xlabel=TIME, ylabel=ERROR)
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    write(figure, path)


def save_panels(path, panels, title):
    """Write the chart of panels {stiffness: rows (side, timing, verdict)} to a PNG."""
    figure, axes = plt.subplots(1, len(panels), figsize=(13.5, 5.4), sharex=True, sharey=True, layout="constrained")
    for place, (stiffness, rows) in zip(axes, panels.items(), strict=True):
        draw(place, rows)
        place.set_title(f"k2 = {words(stiffness)}", fontsize=10)
    axes[0].set_ylim(*SPAN)
    axes[0].set_ylabel(ERROR)
    figure.supxlabel(TIME, fontsize=10)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside right center")
    figure.suptitle(title, fontsize=10)
    write(figure, path)


def write(figure, path):
    """Write a figure to a PNG under a temporary name and rename it."""
    beside = pathlib.Path(path).with_suffix(".part.png")
    figure.savefig(beside, dpi=150)
    plt.close(figure)
    os.replace(beside, path)
