"""Draw the time series of a trajectory between its walls."""

import xarray as xr
from matplotlib.axes import Axes

from ..scene.scene import Scene
from .impact_insertion import insert_impacts, wall_position_velocity
from .style import (
    COLOURS,
    WALL_COLOUR,
    axes_or_new,
    check_plot_options,
    require_dataset,
    require_record,
    scales_of,
    time_axis,
    variable_axis,
)


@check_plot_options
def trace(trajectory: xr.Dataset, scene: Scene, ax: Axes | None = None, units: str = "scene") -> Axes:
    """Draw position against time, with walls and impacts.

    Parameters
    ----------
    trajectory : xarray.Dataset
        Dataset of `jaxvibro.simulate`.
    scene : Scene
        Scene of the trajectory.
    ax : Axes, optional
        Axes to draw into. None makes a new figure.
    units : {"scene", "physical"}, optional
        Units of the axes. ``"scene"`` has time in drive periods, ``"physical"`` in seconds and requires a scene with
        scales.

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
    portrait : Draw a trajectory in the phase plane.

    Examples
    --------
    >>> ax = jv.plot.trace(jv.simulate(scene, state, 3), scene)
    >>> ax.get_xlabel()[:15]
    'time in drive p'
    """
    require_dataset("trace", "simulate", ("x", "v", "phase", "impact_time"), trajectory)
    require_record("trace", Scene, scene)
    scales, drive_frequency = scales_of(trajectory, units), float(scene.frequency)
    x_axis, y_axis, ax = time_axis(scales, drive_frequency), variable_axis(scales, "x"), axes_or_new(ax)
    for wall in scene.walls.values():
        wall_positions, _ = wall_position_velocity(wall, drive_frequency, trajectory["phase"].values)
        ax.plot(
            x_axis.factor * trajectory["time"].values, y_axis.factor * wall_positions, color=WALL_COLOUR, linewidth=1.5
        )
    time, x, _, _ = insert_impacts(trajectory, scene)
    ax.plot(x_axis.factor * time, y_axis.factor * x, color=COLOURS[0], linewidth=1.0)
    ax.plot(
        x_axis.factor * trajectory["impact_time"].values,
        y_axis.factor * trajectory["position"].values,
        linestyle="none",
        marker="o",
        markersize=3.5,
        color=COLOURS[1],
        zorder=3,
    )
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    return ax
