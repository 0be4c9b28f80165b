"""Draw phase portraits: velocity against position along a trajectory, with its impacts."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from ..scene.scene import Scene
from .impact_insertion import insert_impacts
from .style import (
    COLOURS,
    WALL_COLOUR,
    axes_or_new,
    check_plot_options,
    phase_plane_axes,
    require_dataset,
    require_record,
    scales_of,
)


@check_plot_options
def portrait(
    trajectory: xr.Dataset, scene: Scene, ax: Axes | None = None, stable: bool = True, units: str = "scene"
) -> Axes:
    """Draw a trajectory in the phase plane.

    Impacts are dashed lines. Dots are the states on the section, at the end of each drive period.

    Parameters
    ----------
    trajectory : xarray.Dataset
        Dataset of `jaxvibro.simulate`.
    scene : Scene
        Scene of the trajectory.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    stable : bool, optional
        True if the motion is stable. An unstable motion has a dashed line of another colour, dotted impacts and open
        dots.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"physical"`` requires a scene with scales.

    Returns
    -------
    Axes
        Axes with the drawing.

    Raises
    ------
    ArgumentError
        If `trajectory` is not a Dataset of `jaxvibro.simulate`, if `scene` is not a `Scene`, or if `units` is unknown.

    See Also
    --------
    jaxvibro.simulate : Simulate a trajectory.
    orbit : Draw a periodic orbit.
    trace : Draw position against time.

    Notes
    -----
    Walls are grey. The width of a moving wall is the range of its motion.

    Examples
    --------
    >>> ax = jv.plot.portrait(jv.simulate(scene, state, 3), scene)
    >>> ax.get_ylabel()[:8]
    'velocity'
    """
    require_dataset("portrait", "simulate", ("x", "v", "phase", "impact_time"), trajectory)
    require_record("portrait", Scene, scene)
    x_axis, y_axis = phase_plane_axes(scales_of(trajectory, units))
    ax = axes_or_new(ax)
    _draw_walls(ax, scene, x_axis.factor)
    _, x, v, rows_before_impacts = insert_impacts(trajectory, scene)
    x, v = x_axis.factor * x, y_axis.factor * v
    line_dashes, impact_dashes = ("-", "--") if stable else ((0, (6, 2)), ":")
    ax.plot(x, v, color=COLOURS[0 if stable else 7], linewidth=1.0, linestyle=line_dashes)
    impact_line_rows = np.stack(
        [rows_before_impacts, rows_before_impacts + 2, rows_before_impacts + 1], -1
    ).ravel()  # before, after, nan
    ax.plot(x[impact_line_rows], v[impact_line_rows], color=COLOURS[1], linewidth=1.2, linestyle=impact_dashes)
    phase_in_periods = trajectory["phase"].values / (2 * np.pi)
    section_rows = np.flatnonzero(
        abs(phase_in_periods - phase_in_periods[0] - np.round(phase_in_periods - phase_in_periods[0])) < 1e-6
    )[1:]
    ax.plot(
        x_axis.factor * trajectory["x"].values[section_rows],
        y_axis.factor * trajectory["v"].values[section_rows],
        linestyle="none",
        marker="o",
        markersize=4,
        color=COLOURS[2],
        markerfacecolor=COLOURS[2] if stable else "white",
        zorder=3,
    )
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    ax.locator_params(axis="x", nbins=6)
    return ax


def _draw_walls(ax, scene, position_factor):
    for wall in (scene.left, scene.right):
        if wall is None:
            continue
        wall_amplitude = 0.0 if wall.motion is None else position_factor * abs(float(wall.motion.amplitude))
        wall_position = position_factor * float(wall.position)
        ax.axvspan(
            wall_position - wall_amplitude,
            wall_position + wall_amplitude,
            color=WALL_COLOUR,
            alpha=0.3,
            linewidth=0,
            zorder=0,
        )
        ax.axvline(wall_position, color=WALL_COLOUR, linewidth=1.0, zorder=0)
