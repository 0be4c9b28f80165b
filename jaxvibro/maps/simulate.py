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
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..flight.flight_state import absolute
from ..output.units import ANGLE, LENGTH, SPEED, TIME, scales_in
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State, check_start, real_state
from .one_period import finish
from .stops import Stops, walk

SLOTS = 1024


@check.host("use strobe")
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
    periods, samples = check.whole("periods", periods, 1), check.whole("samples", samples, 1)
    state = real_state(scene, state)
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    if shape:
        raise check.ArgumentError("state", "must be one state in one scene, no batch", f"shape {shape}")
    check_start(scene, state)
    x, v, angle, impacts = jax.device_get(_trace(scene, state, periods, samples))
    if impacts.status >= Status.CAP or impacts.count > SLOTS:
        told = Status(int(impacts.status)).word if impacts.status else f"more than {SLOTS} impacts"
        raise check.ArgumentError("state", f"must have a trajectory ({told})", f"x {float(x[0])}, v {float(v[0])}")
    return _dataset(scene, x, v, angle, impacts)


def _sampled(scene, state, periods, samples):
    built = frame(scene)
    path, fault = enter(built, state)
    span = choose(fault == Status.OK, built.period / samples, 0.0)
    angles = state.phase + 2.0 * jnp.pi * jnp.arange(periods * samples + 1) / samples
    ends = span * jnp.arange(1, periods * samples + 1)
    # number by number: a cosine of many angles at once differs by roundings from those of one
    cosine, sine = (lax.map(each, angles[1:]) for each in (jnp.cos, jnp.sin))
    stops = Stops(span + 0.0 * ends, 0.0 * ends, cosine, sine, ends)
    told = integrate.begin(built, path, SLOTS, ends[0])
    cap = integrate.cap(built, periods * samples)
    (told, _), (x, v) = walk(built, told, (), stops, cap, _kept, partial(_placed, built))
    first = absolute(built, path)
    x, v = (jnp.append(start, rest) for start, rest in zip(first, (x, v), strict=True))
    return x, v, angles, finish(built, told, state, fault)[1]


def _kept(piece, told, more):
    return told, more


def _placed(frame, told, more):
    return absolute(frame, told.path)


_trace = persistent_jit(_sampled, static_argnums=(2, 3))


def _dataset(scene, x, v, angle, impacts):
    time = (angle - angle[0]) / float(scene.frequency)
    hit = impacts.side != 0
    length, speed = {"units": LENGTH}, {"units": SPEED}
    at = {"impact_time": ("impact", impacts.time[hit], {"units": TIME})}
    place = _places(scene, impacts.time[hit], impacts.side[hit], angle[0])
    return xr.Dataset(
        {
            "x": ("time", x, {"long_name": "displacement", **length}),
            "v": ("time", v, {"long_name": "velocity", **speed}),
            "side": ("impact", impacts.side[hit], {"long_name": "wall, -1 left, +1 right"}),
            "speed": ("impact", impacts.speed[hit], {"long_name": "relative speed before the impact", **speed}),
            "position": ("impact", place, {"long_name": "displacement at the impact", **length}),
        },
        coords={"time": ("time", time, {"units": TIME}), "phase": ("time", angle, {"units": ANGLE}), **at},
        attrs=scene.numbers | scales_in(scene),
    )


def _places(scene, time, side, phase):
    """Where the walls were that were hit."""
    found = np.zeros_like(time)
    for sign, wall in ((-1, scene.left), (1, scene.right)):
        if wall is not None:
            motion = wall.motion
            angle = 0.0 if motion is None else motion.harmonic * (phase + scene.frequency * time) + motion.phase
            swing = 0.0 if motion is None else motion.amplitude * np.cos(angle)
            found = np.where(side == sign, wall.position + swing, found)
    return found
