"""Define and draw curves of a picture, one line per method."""

from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

from benchmarks import chart

from .methods import OURS

# As in the charts of the benchmarks: one marker per method, filled for the finer of two settings.
STYLES = {
    OURS: ("#D55E00", "*"),
    "heyoka": ("#0072B2", "o"),
    "diffrax Tsit5": ("#E69F00", "D"),
    "diffrax Kvaerno5": ("#8C6000", "h"),
    "SciPy DOP853": ("#7F7F7F", "^"),
    "SciPy RK45": ("#7F7F7F", "^"),
    "SciPy LSODA": ("#CC79A7", "s"),
    "paper": ("#009E73", "s"),
}


ABOVE = 1e3


class Curves(NamedTuple):
    """Curves of a picture.

    `what` is the title; `lines` are {method: (x, y)} with nan for no value; `log` makes y logarithmic; y below `least`
    is drawn there; `endless` is the meaning of infinite values, which are drawn above all.
    """

    what: str
    x_label: str
    y_label: str
    lines: dict[str, tuple[np.ndarray, np.ndarray]]
    log: bool = True
    least: float = 0.0
    log_x: bool = True
    endless: str = ""
    failed: str = ""


def styled(name, lines):
    """Return colour, marker and line of a method; of two settings the first is dashed and hollow."""
    method = next(each for each in STYLES if name.startswith(each))
    colour, marker = STYLES[method]
    alike = [other for other in lines if other.startswith(method)]
    first = len(alike) > 1 and name == alike[0]
    return {
        "color": colour,
        "marker": marker,
        "markersize": 15 if method == OURS else 9 if first else 5,
        "linewidth": 3.0 if method == OURS else 1.3,
        "linestyle": "--" if first else "-",
        "markerfacecolor": "none" if first else colour,
        "zorder": 2 if method == OURS else 3,
    }


def draw(axes, curves):
    """Draw curves on axes."""
    axes.set(xscale="log" if curves.log_x else "linear", yscale="log" if curves.log else "linear")
    for k, (name, (x, y)) in enumerate(curves.lines.items()):
        y = np.where(np.isnan(y), ABOVE * 4.0**k, y) if curves.endless else y
        axes.plot(x, np.maximum(y, curves.least), label=name, **styled(name, curves.lines))
    if curves.endless:
        axes.axhspan(0.3 * ABOVE, 0.3 * ABOVE * 4.0 ** (len(curves.lines) + 1), color="0.92", zorder=0)
        axes.text(0.02, 0.97, curves.endless, transform=axes.transAxes, fontsize=9, va="top")
        axes.set_ylim(top=ABOVE * 4.0 ** (len(curves.lines) + 3))
    if curves.failed:
        axes.text(0.02, 0.97, curves.failed, transform=axes.transAxes, fontsize=9, va="top")
        axes.set_ylim(top=30.0)
    axes.set(xlabel=curves.x_label, ylabel=curves.y_label)
    axes.set_title(curves.what, fontsize=10)
    if curves.endless:
        axes.set_yticks(10.0 ** np.arange(-15, 1, 3))
    axes.grid(True, which="major", alpha=0.3)


def save(path, curves):
    """Write the picture to a PNG."""
    figure, axes = plt.subplots(figsize=(9.5, 5.0), layout="constrained")
    draw(axes, curves)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    chart.write(figure, path)


def by_decade(x, values, low, high, of=np.median):
    """Return (centres, statistic of each decade's values) between two powers of ten; nan for fewer than 5 values."""
    decades = np.arange(low, high)
    place = np.floor(np.log10(x))
    found = [of(values[place == each]) if (place == each).sum() >= 5 else np.nan for each in decades]
    return 10.0 ** (decades + 0.5), np.array(found, float)
