"""What a fit leaves of a record of impacts or samples: measured less fitted."""

import numpy as np
from matplotlib.axes import Axes

from ..design.fitted import Fit
from ..design.records import ImpactRecord, SampleRecord
from ..scene.check import ArgumentError
from .style import COLOURS, axes_or_new, checked_picture, require_record


@checked_picture
def fit(found: Fit, record: ImpactRecord | SampleRecord, ax: Axes | None = None) -> Axes:
    """Draw what `fit` left of a record, in errors, over time: the Axes.

    Impacts on the left wall point to the left; dashed lines are impacts that the record lacks, crosses such as are
    none. Of samples dots are x, rings v.

    Raises ArgumentError where it is given anything else.
    """
    require_record("fit", Fit, found)
    if not isinstance(record, ImpactRecord | SampleRecord):
        raise ArgumentError("plot.fit", "must be given an ImpactRecord or a SampleRecord", record)
    ax = axes_or_new(ax)
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    if len(found.residuals):
        (_draw_impacts if isinstance(record, ImpactRecord) else _draw_samples)(ax, found, record)
    ax.set(xlabel=r"time $\omega_0 t$", ylabel="measured less fitted (errors)")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")
    return ax


def _draw_impacts(ax, fit_result, record):
    times, sides = np.asarray(record.times), np.asarray(record.sides)
    valid_impacts = np.setdiff1d(np.arange(len(times)), fit_result.spurious)
    for side, marker, colour in ((-1, "<", COLOURS[0]), (1, ">", COLOURS[1])):
        is_on_wall = sides[valid_impacts] == side
        if is_on_wall.any():
            wall_name = f"{'left' if side < 0 else 'right'} wall"
            ax.plot(
                times[valid_impacts][is_on_wall],
                fit_result.residuals[is_on_wall],
                marker,
                color=colour,
                label=wall_name,
                markersize=4.0,
            )
    for k, (time, _) in enumerate(fit_result.missed):
        ax.axvline(time, color="0.3", linewidth=0.9, linestyle=(0, (4, 3)), label=None if k else "missing")
    if fit_result.spurious:
        spurious_times = times[list(fit_result.spurious)]
        ax.plot(spurious_times, 0.0 * spurious_times, "x", color="black", label="spurious")


def _draw_samples(ax, fit_result, record):
    n_channels = record.measured[0].shape[1]
    x, *v = fit_result.residuals.reshape(-1, n_channels).T
    ax.plot(record.times, x, ".", color=COLOURS[0], label="x", markersize=4.0)
    for velocity in v:
        ax.plot(record.times, velocity, "o", color=COLOURS[1], fillstyle="none", label="v", markersize=4.0)
