"""Compute the loads on the walls: impact speeds, contact forces and dissipated energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.polynomial import legendre

from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..flight.flight_coefficients import flow_coefficients
from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..output.units import FORCE, POWER, SPEED, scales_attributes
from ..scene import check
from ..scene.codes import Contact, Status
from ..scene.scene import SIDES, Scene
from ..scene.state import State, make_state_arrays
from .contact_duration import contact_duration_of
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
        Initial state at its phase, whose fields broadcast with the fields of `scene`. Alternatively a Dataset of
        `sweep` for this scene: the loads are computed for each recorded state at its value of the parameter.
    periods : int, optional
        Number of drive periods, at least 1.

    Returns
    -------
    xarray.Dataset
        Variables along the dimensions of the lanes and along "wall", whose coordinate holds the sides of the existing
        walls. The dimensions of the lanes are "lane", or "lane_0", "lane_1", ..., or the dimensions of the sweep, with
        its coordinates. The variables are listed in the Notes.

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
      rigid wall. The force is the addition of the wall to the spring and damper of the free mass, ``k2 depth + 2
      (gamma2 - gamma) x'``. With a `Force` it is ``k2 depth + 2 gamma2 x'``, and with a `Push` it is the value of this
      contact law.
    - ``work_rate``, in K length^2 w0: energy that the wall takes in its own frame, divided by the time. An impact on a
      rigid wall with the speed u takes ``(1 - R^2) u^2 / 2``. The last impact before the mass sticks takes
      ``u^2 / 2``. A soft wall takes the integral of the contact force times the speed into the wall.
    - ``status``: worst status of each lane, as for `strobe`, with OK in place of FULL. If the status is CAP or worse,
      the loads are nan.

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
    periods = check.check_whole_number("periods", periods, 1)
    if isinstance(state, xr.Dataset):
        return _loads_of_sweep(scene, state, periods)
    return _loads_of_states(scene, make_state_arrays(scene, state), periods)


def _loads_of_sweep(scene, sweep_data, periods):
    """Compute the loads for the recorded states of a sweep, with the dimensions and coordinates of the sweep."""
    if "swept" not in sweep_data.attrs or not {"x", "v"} <= set(sweep_data.variables):
        raise check.ArgumentError(
            "state", "must be a State, or a Dataset of sweep", f"a Dataset with {', '.join(sweep_data)}"
        )
    check.require_single_scene(scene)
    swept_parameter, sweep_x = sweep_data.attrs["swept"], sweep_data["x"]
    swept_values = sweep_data[swept_parameter].broadcast_like(sweep_x).transpose(*sweep_x.dims)
    state = State(sweep_x.values, sweep_data["v"].transpose(*sweep_x.dims).values, sweep_data.attrs["phase"])
    swept_scene = scene.replace(**{swept_parameter: swept_values.values})
    loads = _loads_of_states(swept_scene, make_state_arrays(swept_scene, state), periods)
    sweep_dim_by_lane_dim = dict(zip(loads["status"].dims, sweep_x.dims, strict=True))
    return loads.rename(sweep_dim_by_lane_dim).assign_coords(sweep_x.coords)


def _loads_of_states(scene, state, periods):
    """Compute the loads of states that broadcast with the scene."""
    shape = np.broadcast_shapes(scene.shape, *map(np.shape, jax.tree.leaves(state)))
    scale_attributes, scene, state = (
        scales_attributes(scene),
        _flatten_lanes(scene, shape),
        _flatten_lanes(state, shape),
    )
    status, loads = np.zeros(math.prod(shape), int), np.zeros((len(LOAD_COLUMNS), math.prod(shape), len(scene.walls)))
    for _ in range(periods):
        start_state, (state, impacts) = state, _strobe_all_impacts(scene, state)
        for wall_index, side in enumerate(scene.walls):
            largest_speed_by_lane, largest_force_by_lane, work_by_lane = _loads_of_wall(
                scene, start_state, impacts, side
            )
            loads[:2, :, wall_index] = np.maximum(
                loads[:2, :, wall_index], [largest_speed_by_lane, largest_force_by_lane]
            )
            loads[2, :, wall_index] += work_by_lane
        status = np.maximum(status, np.where(impacts.status >= Status.CAP, impacts.status, Status.OK))
    loads[2] /= (2.0 * np.pi * periods / np.asarray(scene.frequency))[:, None]
    loads = np.where((status >= Status.CAP)[:, None], np.nan, loads)
    return _loads_dataset(scene, shape, loads, status).assign_attrs(scale_attributes)


def _strobe_all_impacts(scene, state):
    """Advance one period with slots for all impacts, up to `MAX_SLOTS`."""
    end_state, impacts = strobe(scene, state, 1, FIRST_SLOTS)
    max_impact_count = int(np.max(np.where(impacts.status < Status.CAP, impacts.count, 0), initial=0))
    return (
        (end_state, impacts)
        if max_impact_count <= FIRST_SLOTS
        else strobe(scene, state, 1, min(MAX_SLOTS, 1 << (max_impact_count - 1).bit_length()))
    )


def _flatten_lanes(tree, shape):
    """Broadcast all leaves to a shape and flatten them."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).reshape(-1), tree)


def _loads_of_wall(scene, state, impacts, side):
    """Return (largest speed, largest force, work) of one wall within a period, arrays of shape (lanes,)."""
    is_impact = np.asarray(impacts.side) == WALL_SIGNS[SIDES.index(side)]
    is_impact &= (np.asarray(impacts.status) < Status.CAP)[:, None]
    largest_speed_by_lane = np.where(is_impact, impacts.speed, 0.0).max(axis=1)
    if getattr(scene, side).soft:
        return largest_speed_by_lane, *_contact_loads(scene, state, impacts, is_impact, side)
    return largest_speed_by_lane, np.full(len(is_impact), np.nan), _impact_work(scene, impacts, is_impact, side)


def _impact_work(scene, impacts, is_impact, side):
    """Sum the energy that a rigid wall takes at impacts; the slowest impact is the last one before sticking."""
    speeds, restitution = np.asarray(impacts.speed), np.asarray(scene.bounce(side))[:, None]
    has_chatter = np.asarray(impacts.least_speed) == 0.0
    is_slowest_impact = np.argmin(np.where(impacts.side != 0, speeds, np.inf), axis=1)[:, None] == np.arange(
        speeds.shape[1]
    )
    return np.where(
        is_impact, impact_energy_loss(speeds, restitution, is_slowest_impact & has_chatter[:, None]), 0.0
    ).sum(axis=1)


def impact_energy_loss(speed, restitution, is_last_before_sticking):
    """Compute the energy that an impact takes in the frame of the wall.

    Parameters
    ----------
    speed : array
        Speed before the impact relative to the wall, in lengths per t.
    restitution : array
        Coefficient of restitution R.
    is_last_before_sticking : array of bool
        True for the last recorded impact before the mass sticks. The later bounces take the remaining energy.

    Returns
    -------
    array
        Energy per mass, ``(1 - R^2) speed^2 / 2``, or ``speed^2 / 2`` for the last impact.
    """
    return 0.5 * np.where(is_last_before_sticking, 1.0, 1.0 - restitution**2) * speed**2


def _contact_loads(scene, state, impacts, is_impact, side):
    """Return (largest force, work) of the contact phases within a soft wall, arrays of shape (lanes,)."""
    wall_sign = WALL_SIGNS[SIDES.index(side)]
    initial_wall_position, wall_velocity = _wall_motion(scene, np.asarray(state.phase), side)
    contact_code, depth = (
        np.asarray(state.contact) * wall_sign,
        wall_sign * (np.asarray(state.x) - initial_wall_position),
    )
    starts_inside = (contact_code == Contact.WITHIN) | ((contact_code != Contact.LANDED) & (depth > 0))
    entry_times, entry_speeds = (np.where(is_impact, array, 0.0) for array in (impacts.time, impacts.speed))
    start_times, depth, depth_rate = (
        np.concatenate([initial_values[:, None], entry_values], 1)
        for initial_values, entry_values in (
            (0.0 * depth, entry_times),
            (np.maximum(depth, 0.0), 0.0 * entry_times),
            (wall_sign * (np.asarray(state.v) - wall_velocity), entry_speeds),
        )
    )
    contact_lanes, contact_columns = np.nonzero(np.concatenate([starts_inside[:, None], is_impact], 1))
    largest_force_by_lane, work_by_lane = np.zeros(len(is_impact)), np.zeros(len(is_impact))
    if not len(contact_lanes):
        return largest_force_by_lane, work_by_lane
    n_padding = (1 << max(MIN_LOG2_ROWS, (len(contact_lanes) - 1).bit_length())) - len(contact_lanes)
    padded_lanes, contact_columns = (
        np.pad(array, (0, n_padding), mode="edge") for array in (contact_lanes, contact_columns)
    )
    start_times, depth, depth_rate = (
        array[padded_lanes, contact_columns] for array in (start_times, depth, depth_rate)
    )
    lane_scene, phase = _select_lanes(scene, padded_lanes), np.asarray(state.phase)[padded_lanes]
    phase = phase + lane_scene.frequency * start_times
    time_remaining = 2.0 * np.pi / lane_scene.frequency - start_times
    contact_durations = np.asarray(
        _contact_durations(lane_scene, wall_sign + 0.0 * depth, depth, depth_rate, phase, time_remaining)
    )
    wall_position, wall_velocity = _wall_motion(lane_scene, phase, side)
    entry_state = State(
        wall_position + wall_sign * depth,
        wall_velocity + wall_sign * depth_rate,
        phase,
        np.full(phase.shape, wall_sign * Contact.WITHIN),
    )
    gauss_nodes, gauss_weights = legendre.leggauss(N_NODES)
    sample_nodes = np.concatenate([[END_OFFSET - 1.0], gauss_nodes, [1.0 - END_OFFSET]])
    sampled_states, _ = sample(lane_scene, entry_state, 0.5 * contact_durations[:, None] * (1.0 + sample_nodes))
    wall_position, wall_velocity = _wall_motion(lane_scene, np.asarray(sampled_states.phase), side)
    contact_force, depth_rate = _wall_contact_force(
        lane_scene,
        wall_sign * (np.asarray(sampled_states.x) - wall_position),
        np.asarray(sampled_states.v),
        wall_velocity,
        side,
    )
    contact_work = 0.5 * contact_durations * ((contact_force * depth_rate)[:, 1:-1] @ gauss_weights)
    np.maximum.at(largest_force_by_lane, contact_lanes, _largest_contact_forces(contact_force[: len(contact_lanes)]))
    np.add.at(work_by_lane, contact_lanes, contact_work[: len(contact_lanes)])
    return largest_force_by_lane, work_by_lane


def _select_lanes(tree, lanes):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], tree)


def _wall_motion(scene, phase, side):
    """Return position and velocity of a wall at phases of shape (lanes, ...)."""
    broadcastable_scene = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *[1] * (phase.ndim - 1)), scene)
    return [np.asarray(array) + 0.0 * phase for array in wall_states(broadcastable_scene, phase)[SIDES.index(side)]]


@persistent_jit(compiler_options=FAST_COMPILE)
def _contact_durations(scene, wall_sign, depth, depth_rate, phase, max_duration):
    """Compute the durations of contact phases from their initial depths and rates, at most `max_duration`."""
    coeffs = flow_coefficients(scene)
    contact_code = wall_sign * jnp.where(depth > 0, 1.0 * Contact.WITHIN, 1.0 * Contact.ENTERED)
    return contact_duration_of(
        coeffs, contact_code, wall_sign * depth, wall_sign * depth_rate, jnp.cos(phase), jnp.sin(phase), max_duration
    )


def _wall_contact_force(scene, depth, v, wall_velocity, side):
    """Return (force of a soft wall against the mass, speed into the wall) at depths of shape (lanes, points)."""
    wall, wall_sign = getattr(scene, side), WALL_SIGNS[SIDES.index(side)]
    depth_rate = wall_sign * (v - wall_velocity)
    if wall.law is not None:
        law_params = {name: np.asarray(value)[:, None] for name, value in wall.law.numbers.items()}
        return np.asarray(wall.law.function(np.maximum(depth, 0.0), depth_rate, law_params)), depth_rate
    damping = np.asarray(scene.parameter(f"{side}.damping"))
    if scene.force is None:
        damping = damping - np.asarray(scene.damping)
    stiffness = np.asarray(scene.parameter(f"{side}.stiffness"))
    return stiffness[:, None] * depth + 2.0 * damping[:, None] * wall_sign * v, depth_rate


def _largest_contact_forces(contact_force):
    """Maximise the interpolating polynomial of each row on a grid, then by Newton steps; include the end values."""
    gauss_nodes, _ = legendre.leggauss(N_NODES)
    chebyshev_grid = np.cos(np.linspace(0.0, np.pi, N_GRID))
    row_maxima = []
    for force_rows in np.array_split(contact_force, max(1, len(contact_force) // ROWS_PER_CHUNK)):
        force_legendre_series = [legendre.legfit(gauss_nodes, force_rows[:, 1:-1].T, N_NODES - 1)]
        force_legendre_series += [legendre.legder(force_legendre_series[0], order) for order in (1, 2)]
        force_maximiser = chebyshev_grid[np.argmax(legendre.legval(chebyshev_grid, force_legendre_series[0]), axis=1)]
        for _ in range(NEWTON_STEPS):
            force_slope, force_curvature = (
                legendre.legval(force_maximiser, derivative_series, tensor=False)
                for derivative_series in force_legendre_series[1:]
            )
            newton_step = -force_slope / np.where(force_curvature < 0.0, force_curvature, -np.inf)
            force_maximiser = np.clip(
                force_maximiser + np.clip(newton_step, -np.pi / N_GRID, np.pi / N_GRID), -1.0, 1.0
            )
        row_maxima.append(
            np.maximum(force_rows.max(axis=1), legendre.legval(force_maximiser, force_legendre_series[0], tensor=False))
        )
    return np.concatenate(row_maxima)


def _loads_dataset(scene, shape, load_arrays, status):
    """Assemble the Dataset of the loads and the status."""
    lane_dims = ["lane"] if len(shape) == 1 else [f"lane_{axis}" for axis in range(len(shape))]
    dataset_variables = {
        name: ([*lane_dims, "wall"], values.reshape(*shape, -1), {"long_name": long_name, "units": unit})
        for (name, (unit, long_name)), values in zip(LOAD_COLUMNS.items(), load_arrays, strict=True)
    }
    dataset_variables["status"] = (lane_dims, status.reshape(shape), {"long_name": "worst status, as of strobe"})
    return xr.Dataset(dataset_variables, {"wall": ("wall", list(scene.walls))})
