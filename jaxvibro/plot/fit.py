"""Draw the residuals of a fit to a record of impacts or samples."""

import numpy as np
from matplotlib.axes import Axes

from ..design.fitted import Fit
from ..design.records import ImpactRecord, SampleRecord
from ..scene.check import ArgumentError
from .style import COLOURS, axes_or_new, checked_picture, require_record


@checked_picture
def fit(found: Fit, record: ImpactRecord | SampleRecord, ax: Axes | None = None) -> Axes:
    """Draw the residuals of a fit against time.

    Residuals are measured minus fitted values, in multiples of the standard error of a measurement.

    Parameters
    ----------
    found : Fit
        Result of `jaxvibro.fit`.
    record : ImpactRecord or SampleRecord
        Record to which the scene was fitted.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `found` is not a `Fit`, or if `record` is neither an `ImpactRecord` nor a `SampleRecord`.

    See Also
    --------
    jaxvibro.fit : Fit parameters of a scene to a record.

    Notes
    -----
    Markers of impacts point to the wall that is hit. Dashed lines are impacts that are missing from the record, crosses
    are spurious ones. Dots are residuals of positions, circles those of velocities.

    Examples
    --------
    >>> motion = jv.simulate(scene, orbit.state, 5)
    >>> record = jv.ImpactRecord(motion["impact_time"].values, motion["side"].values, 1e-3)
    >>> ax = jv.plot.fit(jv.fit(scene.replace(restitution=0.69), record, {"restitution": 0.02}), record)
    >>> ax.get_legend_handles_labels()[1]
    ['left wall', 'right wall']
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
