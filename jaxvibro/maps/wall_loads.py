"""What walls bear: how fast the mass meets them, how hard they push, the energy that they take."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.polynomial import legendre

from continuation.persistent_jit import SOON, persistent_jit

from ..flight.coefficients import framed
from ..flight.wall_positions import SIGNS, places
from ..output.units import FORCE, POWER, SPEED, scales_in
from ..scene import check
from ..scene.codes import Contact, Status
from ..scene.scene import SIDES, Scene
from ..scene.state import State, real_state
from .contact_duration import duration
from .sample import sample
from .strobe import strobe

SLOTS, MOST = 32, 1024  # impacts of a lane that are looked at first, and at most
NODES = 32  # of Gauss and Legendre in a stay within a soft wall
GRID, NEWTON = 129, 4  # points of a stay from which Newton's steps to the largest force begin, and these
ROWS = 4096  # stays that are looked at together
LEAST = 3  # power of two of the stays that are looked at together
AWAY = np.finfo(float).eps  # of a stay: how far from its ends the mass is looked at
COLUMNS = {
    "largest_speed": (SPEED, "largest speed before an impact, relative to the wall"),
    "largest_force": (FORCE, "largest force of the wall on the mass"),
    "work_rate": (POWER, "energy that the wall takes in its own frame, over time"),
}


@check.host("use strobe and sample")
def wall_loads(scene: Scene, state: State | xr.Dataset, periods: int = 1) -> xr.Dataset:
    """What the walls bear within drive periods from a state on: an xarray.Dataset.

    scene: a `Scene`; state: a `State` at its phase; their numbers broadcast together; or a Dataset of `sweep` from this
    scene, whose dimensions and coordinates stay: of all states that it recorded, each at its value. periods: whole
    number >= 1. Of an orbit `wall_loads(orbit.scene, orbit.state, orbit.periods)`.

    Along the lanes, named lane or lane_0, lane_1, ..., or as those of the sweep, and "wall", those that there are:
    largest_speed, before an impact and relative to the wall, 0 where there is none; largest_force, K length: of a
    soft wall what it adds to the spring and the damper of a free mass, k2 depth + 2 (gamma2 - gamma) x', beside a
    `Force` k2 depth + 2 gamma2 x', or its `Push`, 0 where it is not met, nan of a rigid wall; work_rate, K length^2 w0:
    the energy that the wall takes in its own frame, over the time, at a rigid one (1 - R^2) u^2 / 2 an impact of speed
    u, all of it at the last before a rest, at a soft one the integral of its force times the speed into it. status: of
    each lane, as of `strobe`; from CAP on there are no numbers. Impacts and stays are those of `strobe`; within a stay
    the force is taken at 32 points of Gauss and Legendre and the ends, and is right to 1e-9 of itself where the wall's
    law is smooth.

    Raises ArgumentError as `strobe` does.
    """
    periods = check.whole("periods", periods, 1)
    if isinstance(state, xr.Dataset):
        return _of_sweep(scene, state, periods)
    return _of_states(scene, real_state(scene, state), periods)


def _of_sweep(scene, swept, periods):
    """The Dataset of the states that a sweep recorded, with its dimensions and coordinates."""
    if "swept" not in swept.attrs or not {"x", "v"} <= set(swept.variables):
        raise check.ArgumentError("state", "must be a State, or a Dataset of sweep", f"with {', '.join(swept)}")
    check.require_single(scene)
    name, recorded = swept.attrs["swept"], swept["x"]
    values = swept[name].broadcast_like(recorded).transpose(*recorded.dims)
    state = State(recorded.values, swept["v"].transpose(*recorded.dims).values, swept.attrs["phase"])
    there = scene.replace(**{name: values.values})
    found = _of_states(there, real_state(there, state), periods)
    named = dict(zip(found["status"].dims, recorded.dims, strict=True))
    return found.rename(named).assign_coords(recorded.coords)


def _of_states(scene, state, periods):
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    scales, scene, state = scales_in(scene), _in_lanes(scene, shape), _in_lanes(state, shape)
    status, found = np.zeros(math.prod(shape), int), np.zeros((len(COLUMNS), math.prod(shape), len(scene.walls)))
    for _ in range(periods):
        given, (state, impacts) = state, _strobe(scene, state)
        for k, side in enumerate(scene.walls):
            speed, force, work = _of_wall(scene, given, impacts, side)
            found[:2, :, k] = np.maximum(found[:2, :, k], [speed, force])
            found[2, :, k] += work
        status = np.maximum(status, np.where(impacts.status >= Status.CAP, impacts.status, Status.OK))
    found[2] /= (2.0 * np.pi * periods / np.asarray(scene.frequency))[:, None]
    found = np.where((status >= Status.CAP)[:, None], np.nan, found)
    return _dataset(scene, shape, found, status).assign_attrs(scales)


def _strobe(scene, state):
    """One period on, with slots for all impacts, where these are not too many."""
    end, impacts = strobe(scene, state, 1, SLOTS)
    most = int(np.max(np.where(impacts.status < Status.CAP, impacts.count, 0), initial=0))
    return (end, impacts) if most <= SLOTS else strobe(scene, state, 1, min(MOST, 1 << (most - 1).bit_length()))


def _in_lanes(tree, shape):
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).reshape(-1), tree)


def _of_wall(scene, state, impacts, side):
    """(largest speed, 0 without one, largest force, work) of one wall within a period, each (lanes,)."""
    met = np.asarray(impacts.side) == SIGNS[SIDES.index(side)]
    met &= (np.asarray(impacts.status) < Status.CAP)[:, None]
    speeds = np.where(met, impacts.speed, 0.0).max(axis=1)
    if getattr(scene, side).soft:
        return speeds, *_within(scene, state, impacts, met, side)
    return speeds, np.full(len(met), np.nan), _at_impacts(scene, impacts, met, side)


def _at_impacts(scene, impacts, met, side):
    """The energy that the impacts on a rigid wall take. The slowest before a rest is taken for the last."""
    speeds, rebound = np.asarray(impacts.speed), np.asarray(scene.bounce(side))[:, None]
    rests = np.asarray(impacts.least_speed) == 0.0
    slowest = np.argmin(np.where(impacts.side != 0, speeds, np.inf), axis=1)[:, None] == np.arange(speeds.shape[1])
    return np.where(met, taken(speeds, rebound, slowest & rests[:, None]), 0.0).sum(axis=1)


def taken(speed, restitution, last):
    """The energy that an impact takes in the wall's frame; last: before a rest, whose hops take what is left."""
    return 0.5 * np.where(last, 1.0, 1.0 - restitution**2) * speed**2


def _within(scene, state, impacts, met, side):
    """(largest force, work) of the stays within a soft wall, (lanes,)."""
    sign = SIGNS[SIDES.index(side)]
    wall, pace = _wall(scene, np.asarray(state.phase), side)
    contact, depth = np.asarray(state.contact) * sign, sign * (np.asarray(state.x) - wall)
    begun = (contact == Contact.WITHIN) | ((contact != Contact.LANDED) & (depth > 0))
    entries, speeds = (np.where(met, each, 0.0) for each in (impacts.time, impacts.speed))
    begin, depth, rate = (
        np.concatenate([first[:, None], rest], 1)
        for first, rest in (
            (0.0 * depth, entries),
            (np.maximum(depth, 0.0), 0.0 * entries),
            (sign * (np.asarray(state.v) - pace), speeds),
        )
    )
    lanes, rows = np.nonzero(np.concatenate([begun[:, None], met], 1))
    force, work = np.zeros(len(met)), np.zeros(len(met))
    if not len(lanes):
        return force, work
    spare = (1 << max(LEAST, (len(lanes) - 1).bit_length())) - len(lanes)
    padded, rows = (np.pad(each, (0, spare), mode="edge") for each in (lanes, rows))
    begin, depth, rate = (each[padded, rows] for each in (begin, depth, rate))
    here, phase = _picked(scene, padded), np.asarray(state.phase)[padded]
    phase = phase + here.frequency * begin
    left = 2.0 * np.pi / here.frequency - begin
    last = np.asarray(_durations(here, sign + 0.0 * depth, depth, rate, phase, left))
    where, pace = _wall(here, phase, side)
    entered = State(where + sign * depth, pace + sign * rate, phase, np.full(phase.shape, sign * Contact.WITHIN))
    nodes, weights = legendre.leggauss(NODES)
    spread = np.concatenate([[AWAY - 1.0], nodes, [1.0 - AWAY]])
    one, _ = sample(here, entered, 0.5 * last[:, None] * (1.0 + spread))
    where, pace = _wall(here, np.asarray(one.phase), side)
    push, rate = _push(here, sign * (np.asarray(one.x) - where), np.asarray(one.v), pace, side)
    gained = 0.5 * last * ((push * rate)[:, 1:-1] @ weights)
    np.maximum.at(force, lanes, _largest(push[: len(lanes)]))
    np.add.at(work, lanes, gained[: len(lanes)])
    return force, work


def _picked(tree, lanes):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], tree)


def _wall(scene, phase, side):
    """Where a wall is at phases (lanes, ...), and how fast."""
    more = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *[1] * (phase.ndim - 1)), scene)
    return [np.asarray(each) + 0.0 * phase for each in places(more, phase)[SIDES.index(side)]]


@persistent_jit(compiler_options=SOON)
def _durations(scene, sign, depth, rate, phase, longest):
    """How long stays last that begin so deep within the wall on a side, going so fast into it; at most the longest."""
    frame = framed(scene)
    touch = sign * jnp.where(depth > 0, 1.0 * Contact.WITHIN, 1.0 * Contact.ENTERED)
    return duration(frame, touch, sign * depth, sign * rate, jnp.cos(phase), jnp.sin(phase), longest)


def _push(scene, depth, v, pace, side):
    """(the force of a soft wall against the mass, how fast that goes into it), at depths (lanes, points)."""
    wall, sign = getattr(scene, side), SIGNS[SIDES.index(side)]
    rate = sign * (v - pace)
    if wall.law is not None:
        numbers = {name: np.asarray(each)[:, None] for name, each in wall.law.numbers.items()}
        return np.asarray(wall.law.function(np.maximum(depth, 0.0), rate, numbers)), rate
    damping = np.asarray(scene.parameter(f"{side}.damping"))
    if scene.force is None:
        damping = damping - np.asarray(scene.damping)
    stiffness = np.asarray(scene.parameter(f"{side}.stiffness"))
    return stiffness[:, None] * depth + 2.0 * damping[:, None] * sign * v, rate


def _largest(push):
    """The largest of the polynomial through each row's values at Gauss and Legendre's points, and of its end values:
    the largest on a grid, then Newton's steps to where the slope is zero."""
    nodes, _ = legendre.leggauss(NODES)
    grid = np.cos(np.linspace(0.0, np.pi, GRID))
    found = []
    for rows in np.array_split(push, max(1, len(push) // ROWS)):
        series = [legendre.legfit(nodes, rows[:, 1:-1].T, NODES - 1)]
        series += [legendre.legder(series[0], order) for order in (1, 2)]
        best = grid[np.argmax(legendre.legval(grid, series[0]), axis=1)]
        for _ in range(NEWTON):
            slope, bend = (legendre.legval(best, one, tensor=False) for one in series[1:])
            step = -slope / np.where(bend < 0.0, bend, -np.inf)
            best = np.clip(best + np.clip(step, -np.pi / GRID, np.pi / GRID), -1.0, 1.0)
        found.append(np.maximum(rows.max(axis=1), legendre.legval(best, series[0], tensor=False)))
    return np.concatenate(found)


def _dataset(scene, shape, found, status):
    lanes = ["lane"] if len(shape) == 1 else [f"lane_{axis}" for axis in range(len(shape))]
    variables = {
        name: ([*lanes, "wall"], one.reshape(*shape, -1), {"long_name": told, "units": unit})
        for (name, (unit, told)), one in zip(COLUMNS.items(), found, strict=True)
    }
    variables["status"] = (lanes, status.reshape(shape), {"long_name": "worst status, as of strobe"})
    return xr.Dataset(variables, {"wall": ("wall", list(scene.walls))})
