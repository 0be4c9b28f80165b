"""What a fit leaves of a record of impacts or samples: measured less fitted."""

import numpy as np
from matplotlib.axes import Axes

from ..design.fitted import Fit
from ..design.records import ImpactRecord, SampleRecord
from ..scene.check import ArgumentError
from .style import COLOURS, axes, is_of, picture


@picture
def fit(found: Fit, record: ImpactRecord | SampleRecord, ax: Axes | None = None) -> Axes:
    """Draw what `fit` left of a record, in errors, over time: the Axes.

    Impacts on the left wall point to the left; dashed lines are impacts that the record lacks, crosses such as are
    none. Of samples dots are x, rings v.

    Raises ArgumentError where it is given anything else.
    """
    is_of("fit", Fit, found)
    if not isinstance(record, ImpactRecord | SampleRecord):
        raise ArgumentError("plot.fit", "must be given an ImpactRecord or a SampleRecord", record)
    ax = axes(ax)
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    if len(found.residuals):
        (_impacts if isinstance(record, ImpactRecord) else _samples)(ax, found, record)
    ax.set(xlabel=r"time $\omega_0 t$", ylabel="measured less fitted (errors)")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")
    return ax


def _impacts(ax, found, record):
    times, sides = np.asarray(record.times), np.asarray(record.sides)
    real = np.setdiff1d(np.arange(len(times)), found.spurious)
    for side, marker, colour in ((-1, "<", COLOURS[0]), (1, ">", COLOURS[1])):
        hit = sides[real] == side
        if hit.any():
            name = f"{'left' if side < 0 else 'right'} wall"
            ax.plot(times[real][hit], found.residuals[hit], marker, color=colour, label=name, markersize=4.0)
    for k, (time, _) in enumerate(found.missed):
        ax.axvline(time, color="0.3", linewidth=0.9, linestyle=(0, (4, 3)), label=None if k else "missing")
    if found.spurious:
        gone = times[list(found.spurious)]
        ax.plot(gone, 0.0 * gone, "x", color="black", label="spurious")


def _samples(ax, found, record):
    channels = record.measured[0].shape[1]
    x, *v = found.residuals.reshape(-1, channels).T
    ax.plot(record.times, x, ".", color=COLOURS[0], label="x", markersize=4.0)
    for one in v:
        ax.plot(record.times, one, "o", color=COLOURS[1], fillstyle="none", label="v", markersize=4.0)
