"""Draw the residuals of a fit to a record of impacts or samples."""

import numpy as np
from matplotlib.axes import Axes

from ..design.fit_result import Fit
from ..design.records import ImpactRecord, SampleRecord
from ..scene.check import ArgumentError
from .style import COLOURS, axes_or_new, check_plot_options, require_record


@check_plot_options
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
    The markers of impacts point to the wall of the impact. Dashed lines are impacts that are missing from the record.
    Crosses are spurious impacts. Dots are residuals of positions, circles are residuals of velocities.

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
        (_draw_impact_residuals if isinstance(record, ImpactRecord) else _draw_sample_residuals)(ax, found, record)
    ax.set(xlabel=r"time $\omega_0 t$", ylabel="measured less fitted (errors)")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize="small")
    return ax


def _draw_impact_residuals(ax, fit_result, impact_record):
    impact_times, impact_sides = np.asarray(impact_record.times), np.asarray(impact_record.sides)
    non_spurious_indices = np.setdiff1d(np.arange(len(impact_times)), fit_result.spurious)
    for side, marker, colour in ((-1, "<", COLOURS[0]), (1, ">", COLOURS[1])):
        is_at_wall = impact_sides[non_spurious_indices] == side
        if is_at_wall.any():
            wall_label = f"{'left' if side < 0 else 'right'} wall"
            ax.plot(
                impact_times[non_spurious_indices][is_at_wall],
                fit_result.residuals[is_at_wall],
                marker,
                color=colour,
                label=wall_label,
                markersize=4.0,
            )
    for missing_index, (missing_time, _) in enumerate(fit_result.missed):
        ax.axvline(
            missing_time, color="0.3", linewidth=0.9, linestyle=(0, (4, 3)), label=None if missing_index else "missing"
        )
    if fit_result.spurious:
        spurious_times = impact_times[list(fit_result.spurious)]
        ax.plot(spurious_times, 0.0 * spurious_times, "x", color="black", label="spurious")


def _draw_sample_residuals(ax, fit_result, sample_record):
    n_channels = sample_record.measured[0].shape[1]
    position_residuals, *velocity_residuals_list = fit_result.residuals.reshape(-1, n_channels).T
    ax.plot(sample_record.times, position_residuals, ".", color=COLOURS[0], label="x", markersize=4.0)
    for velocity_residuals in velocity_residuals_list:
        ax.plot(
            sample_record.times, velocity_residuals, "o", color=COLOURS[1], fillstyle="none", label="v", markersize=4.0
        )
