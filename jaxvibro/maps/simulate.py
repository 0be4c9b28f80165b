"""Simulate a trajectory at evenly spaced samples, with its impacts, for plots."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import choose
from ..flight import integrate
from ..flight.coefficients import compute_coefficients
from ..flight.entry import start_path
from ..flight.flight_state import absolute_state
from ..output.units import ANGLE, LENGTH, SPEED, TIME, scales_attributes
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State, check_start, state_arrays
from .one_period import state_and_impacts
from .stops import Stops, fly_to_stops

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
        Variables ``x`` and ``v`` over "time", with the coordinate ``phase`` in rad, which continues from the phase of
        `state`. The first sample is the initial state, the last is the state at the end. Variables ``side``, ``speed``
        (before the impact, relative to the wall) and ``position`` belong to the impacts, in order of the coordinate
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
    periods, samples = check.whole_number("periods", periods, 1), check.whole_number("samples", samples, 1)
    state = state_arrays(scene, state)
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    if shape:
        raise check.ArgumentError("state", "must be a single state in a single scene, not a batch", f"shape {shape}")
    check_start(scene, state)
    x, v, phases, impacts = jax.device_get(_compiled_trajectory(scene, state, periods, samples))
    if impacts.status >= Status.CAP or impacts.count > MAX_IMPACTS:
        reason = Status(int(impacts.status)).word if impacts.status else f"more than {MAX_IMPACTS} impacts"
        raise check.ArgumentError("state", f"must have a trajectory ({reason})", f"x {float(x[0])}, v {float(v[0])}")
    return _trajectory_dataset(scene, x, v, phases, impacts)


def _sample_trajectory(scene, state, periods, samples):
    coeffs = compute_coefficients(scene)
    path, entry_status = start_path(coeffs, state)
    sample_time = choose(entry_status == Status.OK, coeffs.period / samples, 0.0)
    phases = state.phase + 2.0 * jnp.pi * jnp.arange(periods * samples + 1) / samples
    stop_times = sample_time * jnp.arange(1, periods * samples + 1)
    # one angle at a time: a vectorised cosine differs by rounding from that of one angle
    cosine, sine = (lax.map(function, phases[1:]) for function in (jnp.cos, jnp.sin))
    stops = Stops(sample_time + 0.0 * stop_times, 0.0 * stop_times, cosine, sine, stop_times)
    loop = integrate.initial_loop_state(coeffs, path, MAX_IMPACTS, stop_times[0])
    limits = integrate.loop_limits(coeffs, periods * samples)
    (loop, _), (x, v) = fly_to_stops(
        coeffs, loop, (), stops, limits, _keep_loop, partial(_position_and_velocity, coeffs)
    )
    start_xv = absolute_state(coeffs, path)
    x, v = (jnp.append(start, samples_after) for start, samples_after in zip(start_xv, (x, v), strict=True))
    return x, v, phases, state_and_impacts(coeffs, loop, state, entry_status)[1]


def _keep_loop(piece, loop, extra):
    return loop, extra


def _position_and_velocity(coeffs, loop, extra):
    return absolute_state(coeffs, loop.path)


_compiled_trajectory = persistent_jit(_sample_trajectory, static_argnums=(2, 3))


def _trajectory_dataset(scene, x, v, phases, impacts):
    time = (phases - phases[0]) / float(scene.frequency)
    is_impact = impacts.side != 0
    length_attrs, speed_attrs = {"units": LENGTH}, {"units": SPEED}
    impact_coords = {"impact_time": ("impact", impacts.time[is_impact], {"units": TIME})}
    impact_position = _wall_positions(scene, impacts.time[is_impact], impacts.side[is_impact], phases[0])
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
        coords={"time": ("time", time, {"units": TIME}), "phase": ("time", phases, {"units": ANGLE}), **impact_coords},
        attrs=scene.numbers | scales_attributes(scene),
    )


def _wall_positions(scene, time, side, phase):
    """Compute the positions of the walls at the impacts."""
    positions = np.zeros_like(time)
    for sign, wall in ((-1, scene.left), (1, scene.right)):
        if wall is not None:
            motion = wall.motion
            angle = 0.0 if motion is None else motion.harmonic * (phase + scene.frequency * time) + motion.phase
            displacement = 0.0 if motion is None else motion.amplitude * np.cos(angle)
            positions = np.where(side == sign, wall.position + displacement, positions)
    return positions
