"""Compute the loads on the walls: impact speeds, contact forces and dissipated energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.polynomial import legendre

from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..flight.coefficients import flow_coefficients
from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..output.units import FORCE, POWER, SPEED, scales_attributes
from ..scene import check
from ..scene.codes import Contact, Status
from ..scene.scene import SIDES, Scene
from ..scene.state import State, state_arrays
from .contact_duration import contact_time_of
from .sample import sample
from .strobe import strobe

FIRST_SLOTS, MAX_SLOTS = 32, 1024  # recorded impacts of a lane: first attempt and limit
N_NODES = 32  # Gauss-Legendre points in a contact phase
N_GRID, NEWTON_STEPS = 129, 4  # grid for the largest force in a contact phase, and Newton steps from it
ROWS_PER_CHUNK = 4096  # contact phases that are evaluated together
MIN_LOG2_ROWS = 3  # contact phases are padded to a power of two, at least 2**3
END_OFFSET = np.finfo(float).eps  # relative distance of the end samples from the ends of a contact phase
LOAD_COLUMNS = {
    "largest_speed": (SPEED, "largest speed before an impact, relative to the wall"),
    "largest_force": (FORCE, "largest force of the wall on the mass"),
    "work_rate": (POWER, "energy that the wall takes in its own frame, over time"),
}


@check.host_only("use strobe and sample")
def wall_loads(scene: Scene, state: State | xr.Dataset, periods: int = 1) -> xr.Dataset:
    """Compute the largest impact speed, the largest force and the work rate on each wall.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    state : State or xarray.Dataset
        Initial state at its phase; its numbers broadcast with those of `scene`. Or a Dataset of `sweep` for this scene:
        the loads are computed for all recorded states, each at its value of the parameter.
    periods : int, optional
        Number of drive periods, at least 1.

    Returns
    -------
    xarray.Dataset
        Variables along the lanes and along "wall", which holds the sides of the existing walls. The dimensions of the
        lanes are named "lane", or "lane_0", "lane_1", ..., or as in the sweep, whose coordinates are kept. The
        variables are listed in the Notes.

    Raises
    ------
    ArgumentError
        If the arguments are invalid, as for `strobe`, or if a Dataset is not one of `sweep`.

    See Also
    --------
    strobe : The impacts themselves.
    sweep : States along a parameter.

    Notes
    -----
    The Dataset has four variables:

    - ``largest_speed``, in lengths per t: largest speed before an impact relative to the wall, 0 without an impact.
    - ``largest_force``, in K length: largest force of a soft wall on the mass, 0 if the wall is not reached, nan for a
      rigid wall. The force is the one that the wall adds to the spring and damper of the free mass, ``k2 depth + 2
      (gamma2 - gamma) x'``. With a `Force` it is ``k2 depth + 2 gamma2 x'``, and with a `Push` it is that law.
    - ``work_rate``, in K length^2 w0: energy that the wall takes in its own frame, divided by the time. An impact on a
      rigid wall with the speed u takes ``(1 - R^2) u^2 / 2``; the last impact before the mass sticks takes all of its
      energy. A soft wall takes the integral of its force times the speed into it.
    - ``status``: worst status of each lane, as for `strobe`. From CAP on the loads are nan.

    Impacts and contact phases are those of `strobe`. The force within a contact phase is evaluated at 32 Gauss-Legendre
    points and at both ends. Its relative error is 1e-9 where the law of the wall is smooth.

    For an orbit call ``wall_loads(orbit.scene, orbit.state, orbit.periods)``.

    Examples
    --------
    >>> loads = jv.wall_loads(orbit.scene, orbit.state, orbit.periods)
    >>> loads["largest_speed"].values.round(6)
    array([1.956105, 1.956105])
    >>> loads["wall"].values.tolist()
    ['left', 'right']
    """
    periods = check.whole_number("periods", periods, 1)
    if isinstance(state, xr.Dataset):
        return _loads_of_sweep(scene, state, periods)
    return _loads_of_states(scene, state_arrays(scene, state), periods)


def _loads_of_sweep(scene, sweep_data, periods):
    """Compute the loads for the states that a sweep recorded, with its dimensions and coordinates."""
    if "swept" not in sweep_data.attrs or not {"x", "v"} <= set(sweep_data.variables):
        raise check.ArgumentError(
            "state", "must be a State, or a Dataset of sweep", f"a Dataset with {', '.join(sweep_data)}"
        )
    check.require_single(scene)
    name, sweep_x = sweep_data.attrs["swept"], sweep_data["x"]
    values = sweep_data[name].broadcast_like(sweep_x).transpose(*sweep_x.dims)
    state = State(sweep_x.values, sweep_data["v"].transpose(*sweep_x.dims).values, sweep_data.attrs["phase"])
    swept_scene = scene.replace(**{name: values.values})
    loads = _loads_of_states(swept_scene, state_arrays(swept_scene, state), periods)
    dimension_names = dict(zip(loads["status"].dims, sweep_x.dims, strict=True))
    return loads.rename(dimension_names).assign_coords(sweep_x.coords)


def _loads_of_states(scene, state, periods):
    """Compute the loads of states that broadcast with the scene."""
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    scales, scene, state = scales_attributes(scene), _flatten_lanes(scene, shape), _flatten_lanes(state, shape)
    status, loads = np.zeros(math.prod(shape), int), np.zeros((len(LOAD_COLUMNS), math.prod(shape), len(scene.walls)))
    for _ in range(periods):
        start, (state, impacts) = state, _strobe_all_impacts(scene, state)
        for wall_index, side in enumerate(scene.walls):
            speed, force, work = _loads_of_wall(scene, start, impacts, side)
            loads[:2, :, wall_index] = np.maximum(loads[:2, :, wall_index], [speed, force])
            loads[2, :, wall_index] += work
        status = np.maximum(status, np.where(impacts.status >= Status.CAP, impacts.status, Status.OK))
    loads[2] /= (2.0 * np.pi * periods / np.asarray(scene.frequency))[:, None]
    loads = np.where((status >= Status.CAP)[:, None], np.nan, loads)
    return _loads_dataset(scene, shape, loads, status).assign_attrs(scales)


def _strobe_all_impacts(scene, state):
    """Advance one period with slots for all impacts, up to `MAX_SLOTS`."""
    end, impacts = strobe(scene, state, 1, FIRST_SLOTS)
    max_count = int(np.max(np.where(impacts.status < Status.CAP, impacts.count, 0), initial=0))
    return (
        (end, impacts)
        if max_count <= FIRST_SLOTS
        else strobe(scene, state, 1, min(MAX_SLOTS, 1 << (max_count - 1).bit_length()))
    )


def _flatten_lanes(tree, shape):
    """Broadcast all leaves to a shape and flatten them."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).reshape(-1), tree)


def _loads_of_wall(scene, state, impacts, side):
    """Return (largest speed, largest force, work) of one wall within a period, each (lanes,)."""
    is_impact = np.asarray(impacts.side) == WALL_SIGNS[SIDES.index(side)]
    is_impact &= (np.asarray(impacts.status) < Status.CAP)[:, None]
    speeds = np.where(is_impact, impacts.speed, 0.0).max(axis=1)
    if getattr(scene, side).soft:
        return speeds, *_contact_loads(scene, state, impacts, is_impact, side)
    return speeds, np.full(len(is_impact), np.nan), _impact_work(scene, impacts, is_impact, side)


def _impact_work(scene, impacts, is_impact, side):
    """Sum the energy that impacts on a rigid wall take; the slowest impact before sticking counts as the last."""
    speeds, restitution = np.asarray(impacts.speed), np.asarray(scene.bounce(side))[:, None]
    has_chatter = np.asarray(impacts.least_speed) == 0.0
    is_slowest = np.argmin(np.where(impacts.side != 0, speeds, np.inf), axis=1)[:, None] == np.arange(speeds.shape[1])
    return np.where(is_impact, impact_energy_loss(speeds, restitution, is_slowest & has_chatter[:, None]), 0.0).sum(
        axis=1
    )


def impact_energy_loss(speed, restitution, is_last):
    """Compute the energy that an impact takes in the frame of the wall.

    Parameters
    ----------
    speed : array
        Speed before the impact relative to the wall, in lengths per t.
    restitution : array
        Coefficient of restitution R.
    is_last : array of bool
        True for the last impact before the mass sticks, whose bounces take the remaining energy.

    Returns
    -------
    array
        Energy per mass, ``(1 - R^2) speed^2 / 2``, or ``speed^2 / 2`` for the last impact.
    """
    return 0.5 * np.where(is_last, 1.0, 1.0 - restitution**2) * speed**2


def _contact_loads(scene, state, impacts, is_impact, side):
    """Return (largest force, work) of the contact phases within a soft wall, each (lanes,)."""
    sign = WALL_SIGNS[SIDES.index(side)]
    initial_wall_position, wall_velocity = _wall_motion(scene, np.asarray(state.phase), side)
    contact, depth = np.asarray(state.contact) * sign, sign * (np.asarray(state.x) - initial_wall_position)
    starts_inside = (contact == Contact.WITHIN) | ((contact != Contact.LANDED) & (depth > 0))
    entry_times, speeds = (np.where(is_impact, array, 0.0) for array in (impacts.time, impacts.speed))
    start_times, depth, rate = (
        np.concatenate([initial[:, None], entries], 1)
        for initial, entries in (
            (0.0 * depth, entry_times),
            (np.maximum(depth, 0.0), 0.0 * entry_times),
            (sign * (np.asarray(state.v) - wall_velocity), speeds),
        )
    )
    lanes, rows = np.nonzero(np.concatenate([starts_inside[:, None], is_impact], 1))
    largest_force, work = np.zeros(len(is_impact)), np.zeros(len(is_impact))
    if not len(lanes):
        return largest_force, work
    n_padding = (1 << max(MIN_LOG2_ROWS, (len(lanes) - 1).bit_length())) - len(lanes)
    padded_lanes, rows = (np.pad(array, (0, n_padding), mode="edge") for array in (lanes, rows))
    start_times, depth, rate = (array[padded_lanes, rows] for array in (start_times, depth, rate))
    lane_scene, phase = _select_lanes(scene, padded_lanes), np.asarray(state.phase)[padded_lanes]
    phase = phase + lane_scene.frequency * start_times
    time_remaining = 2.0 * np.pi / lane_scene.frequency - start_times
    contact_times = np.asarray(_contact_times(lane_scene, sign + 0.0 * depth, depth, rate, phase, time_remaining))
    wall_position, wall_velocity = _wall_motion(lane_scene, phase, side)
    entry_state = State(
        wall_position + sign * depth, wall_velocity + sign * rate, phase, np.full(phase.shape, sign * Contact.WITHIN)
    )
    nodes, weights = legendre.leggauss(N_NODES)
    points = np.concatenate([[END_OFFSET - 1.0], nodes, [1.0 - END_OFFSET]])
    samples, _ = sample(lane_scene, entry_state, 0.5 * contact_times[:, None] * (1.0 + points))
    wall_position, wall_velocity = _wall_motion(lane_scene, np.asarray(samples.phase), side)
    contact_force, rate = _contact_force(
        lane_scene, sign * (np.asarray(samples.x) - wall_position), np.asarray(samples.v), wall_velocity, side
    )
    contact_work = 0.5 * contact_times * ((contact_force * rate)[:, 1:-1] @ weights)
    np.maximum.at(largest_force, lanes, _largest_force(contact_force[: len(lanes)]))
    np.add.at(work, lanes, contact_work[: len(lanes)])
    return largest_force, work


def _select_lanes(tree, lanes):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], tree)


def _wall_motion(scene, phase, side):
    """Return position and velocity of a wall at phases of shape (lanes, ...)."""
    expanded_scene = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *[1] * (phase.ndim - 1)), scene)
    return [np.asarray(array) + 0.0 * phase for array in wall_states(expanded_scene, phase)[SIDES.index(side)]]


@persistent_jit(compiler_options=FAST_COMPILE)
def _contact_times(scene, sign, depth, rate, phase, max_time):
    """Compute the durations of contact phases from their initial depths and rates, at most `max_time`."""
    coeffs = flow_coefficients(scene)
    contact = sign * jnp.where(depth > 0, 1.0 * Contact.WITHIN, 1.0 * Contact.ENTERED)
    return contact_time_of(coeffs, contact, sign * depth, sign * rate, jnp.cos(phase), jnp.sin(phase), max_time)


def _contact_force(scene, depth, v, wall_velocity, side):
    """Return (force of a soft wall against the mass, speed into the wall) at depths of shape (lanes, points)."""
    wall, sign = getattr(scene, side), WALL_SIGNS[SIDES.index(side)]
    rate = sign * (v - wall_velocity)
    if wall.law is not None:
        params = {name: np.asarray(value)[:, None] for name, value in wall.law.numbers.items()}
        return np.asarray(wall.law.function(np.maximum(depth, 0.0), rate, params)), rate
    damping = np.asarray(scene.parameter(f"{side}.damping"))
    if scene.force is None:
        damping = damping - np.asarray(scene.damping)
    stiffness = np.asarray(scene.parameter(f"{side}.stiffness"))
    return stiffness[:, None] * depth + 2.0 * damping[:, None] * sign * v, rate


def _largest_force(contact_force):
    """Maximise the interpolating polynomial of each row, end values included: on a grid, then by Newton steps."""
    nodes, _ = legendre.leggauss(N_NODES)
    grid = np.cos(np.linspace(0.0, np.pi, N_GRID))
    maxima = []
    for chunk in np.array_split(contact_force, max(1, len(contact_force) // ROWS_PER_CHUNK)):
        legendre_series = [legendre.legfit(nodes, chunk[:, 1:-1].T, N_NODES - 1)]
        legendre_series += [legendre.legder(legendre_series[0], order) for order in (1, 2)]
        maximiser = grid[np.argmax(legendre.legval(grid, legendre_series[0]), axis=1)]
        for _ in range(NEWTON_STEPS):
            slope, curvature = (legendre.legval(maximiser, series, tensor=False) for series in legendre_series[1:])
            step = -slope / np.where(curvature < 0.0, curvature, -np.inf)
            maximiser = np.clip(maximiser + np.clip(step, -np.pi / N_GRID, np.pi / N_GRID), -1.0, 1.0)
        maxima.append(np.maximum(chunk.max(axis=1), legendre.legval(maximiser, legendre_series[0], tensor=False)))
    return np.concatenate(maxima)


def _loads_dataset(scene, shape, loads, status):
    """Assemble the Dataset of the loads."""
    lane_dims = ["lane"] if len(shape) == 1 else [f"lane_{axis}" for axis in range(len(shape))]
    variables = {
        name: ([*lane_dims, "wall"], values.reshape(*shape, -1), {"long_name": long_name, "units": unit})
        for (name, (unit, long_name)), values in zip(LOAD_COLUMNS.items(), loads, strict=True)
    }
    variables["status"] = (lane_dims, status.reshape(shape), {"long_name": "worst status, as of strobe"})
    return xr.Dataset(variables, {"wall": ("wall", list(scene.walls))})
