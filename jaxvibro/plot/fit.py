"""What a fit leaves of a record of impacts: measured less fitted times."""

import numpy as np
from matplotlib.axes import Axes

from ..design.fit import Fit
from ..design.records import ImpactRecord
from .style import COLOURS, axes, is_of


def fit(found: Fit, record: ImpactRecord, ax: Axes | None = None) -> Axes:
    """Draw what `fit` left of a record, in errors, over time: the Axes.

    Impacts on the left wall point to the left; dashed lines are impacts that the record lacks, crosses such as are
    none.

    Raises ArgumentError where it is given anything else.
    """
    is_of("fit", Fit, found)
    is_of("fit", ImpactRecord, record)
    ax = axes(ax)
    times, sides = np.asarray(record.times), np.asarray(record.sides)
    real = np.setdiff1d(np.arange(len(times)), found.spurious)
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    if len(found.residuals):
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
    ax.set(xlabel=r"time $\omega_0 t$", ylabel="measured less fitted (errors)")
    ax.legend(fontsize="small")
    return ax
