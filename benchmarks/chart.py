"""Error against cost: one marker a method, one point a setting, wrong itineraries ringed and counted."""

import os
import pathlib

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt

# Okabe and Ito's colours, told apart by colour-blind readers; markers tell them apart in grey
STYLES = {
    "jaxvibro": ("#D55E00", "*"),
    "jaxvibro, user's vmap": ("#CC79A7", "P"),
    "yardstick": ("#000000", "X"),
    "heyoka, batch": ("#0072B2", "o"),
    "heyoka, scalar": ("#56B4E9", "v"),
    "paper's RK4": ("#009E73", "s"),
    "diffrax Tsit5": ("#E69F00", "D"),
    "SciPy DOP853": ("#7F7F7F", "^"),
}
# an error of 0 has no place on a logarithmic axis; this is below the rounding of 1
LEAST = 1e-17


def draw(axes, rows):
    """Draw rows (side, timing, verdict) on axes, which are returned."""
    for method, (colour, marker) in STYLES.items():
        points = [(timing.cost[0], verdict) for side, timing, verdict in rows if side.method == method]
        if points:
            draw_method(axes, method, points, colour, marker)
    axes.scatter([], [], s=190, facecolors="none", edgecolors="k", label="ringed: wrong itineraries, of those judged")
    axes.set(xscale="log", yscale="log", xlabel="time per map on one core (ns)")
    axes.set_ylabel("error of x and x' after one period (dimensionless)\nmedian; line up to the 99th percentile")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    return axes


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
            words = f"{verdict.wrong} of {verdict.judged}"
            axes.annotate(words, (cost, median), xytext=(9, -3), textcoords="offset points", fontsize=7)


def save(path, rows, title):
    """Write the chart to a PNG: beside it first, then renamed."""
    figure, axes = plt.subplots(figsize=(9.5, 5.2), layout="constrained")
    draw(axes, rows).set_title(title, fontsize=10)
    beside = pathlib.Path(path).with_suffix(".part.png")
    figure.savefig(beside, dpi=150)
    plt.close(figure)
    os.replace(beside, path)
