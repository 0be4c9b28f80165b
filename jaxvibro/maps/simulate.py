"""A trajectory at even samples, with its impacts: for pictures."""

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
    """The trajectory of one state over whole drive periods, as an xarray.Dataset.

    scene, state: one of each, no batch. samples: of a period, evenly spaced; the first is the given state, the last the
    one at the end. Dataset: x(time), v(time), phase(time) in radians, counted on from the start's; and of the impacts,
    in order, side, speed and position over the coordinate impact_time. Times in t since the start.

    Of a mass that comes to rest by complete chatter the hops are recorded until rest before the next sample is certain:
    with more samples there are more of them, and always at least as many as `strobe` records.

    Raises ArgumentError for a batch, for a start beyond a wall or not finite, and where an impact cap ends the
    trajectory.
    """
    periods, samples = check.whole_number("periods", periods, 1), check.whole_number("samples", samples, 1)
    state = state_arrays(scene, state)
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    if shape:
        raise check.ArgumentError("state", "must be one state in one scene, no batch", f"shape {shape}")
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
    # number by number: a cosine of many angles at once differs by roundings from those of one
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
    """Where the walls were that were hit."""
    positions = np.zeros_like(time)
    for sign, wall in ((-1, scene.left), (1, scene.right)):
        if wall is not None:
            motion = wall.motion
            angle = 0.0 if motion is None else motion.harmonic * (phase + scene.frequency * time) + motion.phase
            displacement = 0.0 if motion is None else motion.amplitude * np.cos(angle)
            positions = np.where(side == sign, wall.position + displacement, positions)
    return positions
