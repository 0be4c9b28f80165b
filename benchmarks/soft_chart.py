"""Error against cost between soft walls, a panel a stiffness, drawn as in `chart`."""

from matplotlib import pyplot as plt

from benchmarks import chart
from benchmarks.soft_sides import PLAIN
from benchmarks.soft_work import words

# Okabe and Ito's colours; an explicit and an implicit method of one package share a hue, never a marker
STYLES = {
    "jaxvibro": ("#D55E00", "*"),
    "heyoka, batch": ("#0072B2", "o"),
    "heyoka, scalar": ("#56B4E9", "v"),
    "diffrax Tsit5": ("#E69F00", "D"),
    "diffrax Kvaerno5": ("#8C6000", "d"),
    "SciPy RK45": ("#009E73", "^"),
    "SciPy LSODA": ("#CC79A7", "s"),
    PLAIN: ("#7F7F7F", "X"),
    "SciPy Radau": ("#000000", "p"),
}
BELOW, ABOVE = 1e-16, 1e-1


def save(path, panels, title):
    """Write the chart of panels {stiffness: rows (side, timing, verdict)} to a PNG."""
    figure, axes = plt.subplots(1, len(panels), figsize=(13.5, 5.4), sharex=True, sharey=True, layout="constrained")
    for place, (stiffness, rows) in zip(axes, panels.items(), strict=True):
        chart.draw(place, rows, STYLES)
        place.set_title(f"k2 = {words(stiffness)}", fontsize=10)
    axes[0].set_ylim(BELOW, ABOVE)
    axes[0].set_ylabel(chart.ERROR)
    figure.supxlabel(chart.TIME, fontsize=10)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside right center")
    figure.suptitle(title, fontsize=10)
    chart.write(figure, path)
