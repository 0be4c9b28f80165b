"""Simulate a trajectory at evenly spaced samples, with its impacts, for plots."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax

from continuation.hostcall import persistent_jit

from ..compiled.lane_arithmetic import choose
from ..contact.kinds import make_flow_coefficients
from ..flight import integration_loop
from ..flight.flight_state import absolute_state
from ..flight.path_start import start_path
from ..output.units import ANGLE, LENGTH, SPEED, TIME, scales_attributes
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, Status, check_start_within_walls, make_state_arrays
from .flight_stops import FlightStops, fly_to_stops
from .reference_strobe import state_and_impacts

MAX_IMPACTS = 1024


@check.host_only("use strobe")
def simulate(scene: Scene, state: State, periods: int = 1, samples: int = 200) -> xr.Dataset:
    """Simulate the trajectory of one state over whole drive periods.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene.
    state : State
        Initial state at its phase. A single state.
    periods : int, optional
        Number of drive periods, at least 1.
    samples : int, optional
        Number of evenly spaced samples per period, at least 1.

    Returns
    -------
    xarray.Dataset
        Variables ``x`` and ``v`` along "time", with the coordinate ``phase`` in rad, which continues from the phase of
        `state`. The first sample is the initial state, and the last sample is the final state. Variables ``side``,
        ``speed`` (before the impact, relative to the wall) and ``position`` along "impact", with the coordinate
        ``impact_time``. Times are counted from the start.

    Raises
    ------
    ArgumentError
        If `scene` or `state` is a batch, if the state is not finite or lies beyond a wall, or if a limit on the number
        of impacts or steps ends the trajectory.

    See Also
    --------
    sample : States at given times, with derivatives.
    strobe : State after whole periods.

    Notes
    -----
    If the mass sticks after complete chatter, bounces are recorded until it is certain that the mass sticks before the
    next sample. More samples therefore record more bounces, and always at least as many as `strobe`.

    Examples
    --------
    >>> trajectory = jv.simulate(scene, state, periods=2, samples=100)
    >>> trajectory.sizes["time"], trajectory["side"].values.tolist()
    (201, [-1, 1, -1])
    """
    periods, samples = check.check_whole_number("periods", periods, 1), check.check_whole_number("samples", samples, 1)
    state = make_state_arrays(scene, state)
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    if shape:
        raise check.ArgumentError("state", "must be a single state in a single scene, not a batch", f"shape {shape}")
    check_start_within_walls(scene, state)
    x, v, drive_phases, impacts = jax.device_get(_compiled_trajectory(scene, state, periods, samples))
    if impacts.status >= Status.CAP or impacts.count > MAX_IMPACTS:
        failure_reason = Status(int(impacts.status)).word if impacts.status else f"more than {MAX_IMPACTS} impacts"
        raise check.ArgumentError(
            "state", f"must have a trajectory ({failure_reason})", f"x {float(x[0])}, v {float(v[0])}"
        )
    return _trajectory_dataset(scene, x, v, drive_phases, impacts)


def _sample_trajectory(scene, state, periods, samples_per_period):
    coeffs = make_flow_coefficients(scene)
    path, start_status = start_path(coeffs, state)
    sample_interval = choose(start_status == Status.OK, coeffs.period / samples_per_period, 0.0)
    drive_phases = state.phase + 2.0 * jnp.pi * jnp.arange(periods * samples_per_period + 1) / samples_per_period
    stop_times = sample_interval * jnp.arange(1, periods * samples_per_period + 1)
    # one angle at a time: a vectorised cosine differs by rounding from that of one angle
    drive_cosines, drive_sines = (lax.map(cosine_or_sine, drive_phases[1:]) for cosine_or_sine in (jnp.cos, jnp.sin))
    stops = FlightStops(sample_interval + 0.0 * stop_times, 0.0 * stop_times, drive_cosines, drive_sines, stop_times)
    loop_state = integration_loop.initial_loop_state(coeffs, path, MAX_IMPACTS, stop_times[0])
    loop_limits = integration_loop.loop_limits(coeffs, periods * samples_per_period)
    (loop_state, _), (x, v) = fly_to_stops(
        coeffs, loop_state, (), stops, loop_limits, _keep_loop_state, partial(_position_and_velocity, coeffs)
    )
    start_xv = absolute_state(coeffs, path)
    x, v = (
        jnp.append(start_x_or_v, later_samples) for start_x_or_v, later_samples in zip(start_xv, (x, v), strict=True)
    )
    return x, v, drive_phases, state_and_impacts(coeffs, loop_state, state, start_status)[1]


def _keep_loop_state(piece, loop_state, extra_state):
    return loop_state, extra_state


def _position_and_velocity(coeffs, loop_state, extra_state):
    return absolute_state(coeffs, loop_state.path)


_compiled_trajectory = persistent_jit(static_argnums=(2, 3))(_sample_trajectory)


def _trajectory_dataset(scene, x, v, drive_phases, impacts):
    time = (drive_phases - drive_phases[0]) / float(scene.frequency)
    is_impact = impacts.side != 0
    length_attrs, speed_attrs = {"units": LENGTH}, {"units": SPEED}
    impact_coords = {"impact_time": ("impact", impacts.time[is_impact], {"units": TIME})}
    impact_position = _wall_positions_at(scene, impacts.time[is_impact], impacts.side[is_impact], drive_phases[0])
    return xr.Dataset(
        {
            "x": ("time", x, {"long_name": "displacement", **length_attrs}),
            "v": ("time", v, {"long_name": "velocity", **speed_attrs}),
            "side": ("impact", impacts.side[is_impact], {"long_name": "wall, -1 left, +1 right"}),
            "speed": (
                "impact",
                impacts.speed[is_impact],
                {"long_name": "relative speed before the impact", **speed_attrs},
            ),
            "position": ("impact", impact_position, {"long_name": "displacement at the impact", **length_attrs}),
        },
        coords={
            "time": ("time", time, {"units": TIME}),
            "phase": ("time", drive_phases, {"units": ANGLE}),
            **impact_coords,
        },
        attrs=scene.numbers | scales_attributes(scene),
    )


def _wall_positions_at(scene, impact_times, impact_sides, start_phase):
    """Compute the position of the wall at each impact."""
    wall_positions = np.zeros_like(impact_times)
    for wall_sign, wall in ((-1, scene.left), (1, scene.right)):
        if wall is not None:
            motion = wall.motion
            motion_angle = (
                0.0
                if motion is None
                else motion.harmonic * (start_phase + scene.frequency * impact_times) + motion.phase
            )
            wall_displacement = 0.0 if motion is None else motion.amplitude * np.cos(motion_angle)
            wall_positions = np.where(impact_sides == wall_sign, wall.position + wall_displacement, wall_positions)
    return wall_positions
