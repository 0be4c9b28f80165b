"""Compute the loads on the walls: impact speeds, contact forces and dissipated energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.polynomial import legendre

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..contact.kinds import contact_of_wall, flow_coefficients
from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..output.units import FORCE, POWER, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import SIDES, Scene
from ..scene.state import Contact, State, Status, make_state_arrays
from .iterate import take_lanes
from .sample import sample
from .strobe import strobe

FIRST_SLOTS, MAX_SLOTS = 32, 1024  # recorded impacts of a lane: first attempt and limit
N_NODES = 32  # Gauss-Legendre points in a panel: a contact phase or, where the force varies more, a part of one
N_TAIL = 4  # number of last Legendre coefficients that are small if a panel resolves the force
RESOLUTION = 1e-10  # bound on these coefficients, relative to the largest force in the contact phase
ROUNDING_ERRORS = 16.0  # rounding errors in the distance from the wall; smaller changes of the force are not resolved
MAX_BISECTIONS = 16  # of a contact phase
N_GRID, NEWTON_STEPS = 129, 4  # grid for the largest force in a panel, and Newton steps from it
ROWS_PER_CHUNK = 4096  # panels that are evaluated together
LOG2_OF_SIZES = 3  # contact phases and panels are padded to 8, 64, 512, ... rows
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
    points and at both ends. If a polynomial through these values does not represent the force to 1e-10 of its largest
    value, the contact phase is bisected, up to 16 times.

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
    start_times, depth, depth_rate = (
        array[contact_lanes, contact_columns] for array in (start_times, depth, depth_rate)
    )
    lane_scene, phase = take_lanes(scene, contact_lanes), np.asarray(state.phase)[contact_lanes]
    phase = phase + lane_scene.frequency * start_times
    time_remaining = 2.0 * np.pi / lane_scene.frequency - start_times
    duration_arguments = lane_scene, wall_sign + 0.0 * depth, depth, depth_rate, phase, time_remaining
    contact_durations = _contact_durations(*take_lanes(duration_arguments, _padded_rows(len(phase))))
    wall_position, wall_velocity = _wall_motion(lane_scene, phase, side)
    entry_state = State(
        wall_position + wall_sign * depth,
        wall_velocity + wall_sign * depth_rate,
        phase,
        np.full(phase.shape, wall_sign * Contact.WITHIN),
    )

    def forces_in_panels(contact_rows, times):
        return _panel_forces(*take_lanes((lane_scene, entry_state), contact_rows), times, side)

    largest_forces, works = integrate_contacts(forces_in_panels, np.asarray(contact_durations)[: len(phase)])
    np.maximum.at(largest_force_by_lane, contact_lanes, largest_forces)
    np.add.at(work_by_lane, contact_lanes, works)
    return largest_force_by_lane, work_by_lane


def integrate_contacts(forces_in_panels, contact_durations):
    """Compute the largest force and the work of contact phases.

    Panels in which a polynomial does not represent the force are bisected. The error of the polynomial at the ends of a
    panel may be `N_NODES` times the bound on its last coefficients.

    Parameters
    ----------
    forces_in_panels : callable
        Function of (contact_rows, times): the contact phase of each panel, of shape (panels,), and times since its
        beginning, of shape (panels, points). It returns the force and the speed into the wall, of shape (panels,
        points), and the rounding error of the force, of shape (panels,).
    contact_durations : ndarray
        Array of shape (contact phases,).

    Returns
    -------
    largest_forces, works : ndarray
        Arrays of shape (contact phases,).
    """
    gauss_nodes, gauss_weights = legendre.leggauss(N_NODES)
    nodes = np.concatenate([[END_OFFSET - 1.0], gauss_nodes, [1.0 - END_OFFSET]])
    contact_rows = np.arange(len(contact_durations))
    panel_starts, panel_lengths = np.zeros(len(contact_rows)), np.ones(len(contact_rows))  # of the contact phases
    largest_forces, works, force_scales = np.zeros((3, len(contact_rows)))
    for n_bisections in range(MAX_BISECTIONS + 1):
        half_durations = 0.5 * panel_lengths * contact_durations[contact_rows]
        times = (panel_starts * contact_durations[contact_rows])[:, None] + half_durations[:, None] * (1.0 + nodes)
        force, depth_rate, rounding_error = forces_in_panels(contact_rows, times)
        np.maximum.at(force_scales, contact_rows, abs(force).max(axis=1, initial=0.0))
        coefficients = legendre.legfit(gauss_nodes, force[:, 1:-1].T, N_NODES - 1)
        tolerances = np.maximum(RESOLUTION * force_scales[contact_rows], rounding_error)
        end_errors = abs(legendre.legval([-1.0, 1.0], coefficients) - force[:, [0, -1]]).max(axis=1)
        is_resolved = (abs(coefficients[-N_TAIL:]).max(axis=0) <= tolerances) & (end_errors <= N_NODES * tolerances)
        is_done = is_resolved | (n_bisections == MAX_BISECTIONS)
        panel_works = half_durations * ((force * depth_rate)[:, 1:-1] @ gauss_weights)
        np.add.at(works, contact_rows[is_done], panel_works[is_done])
        panel_maxima = force.max(axis=1)
        panel_maxima[is_resolved] = _largest_forces_of_panels(force[is_resolved], coefficients[:, is_resolved])
        np.maximum.at(largest_forces, contact_rows[is_done], panel_maxima[is_done])
        if is_done.all():
            break
        contact_rows = np.repeat(contact_rows[~is_done], 2)
        panel_lengths = np.repeat(0.5 * panel_lengths[~is_done], 2)
        panel_starts = np.repeat(panel_starts[~is_done], 2)
        panel_starts[1::2] += panel_lengths[1::2]
    return largest_forces, works


def _panel_forces(scene, entry_state, times, side):
    """Return forces, speeds into the wall, and rounding errors of the forces at times since the entry into the wall."""
    chunks = []
    for first_row in range(0, len(times), ROWS_PER_CHUNK):
        rows = slice(first_row, first_row + ROWS_PER_CHUNK)
        chunks.append(_forces_at_times(*take_lanes((scene, entry_state, times), rows), side))
    return [np.concatenate(arrays) for arrays in zip(*chunks, strict=True)]


def _forces_at_times(scene, entry_state, times, side):
    """Return the result of `_panel_forces` for one chunk."""
    wall_sign, padded_rows = WALL_SIGNS[SIDES.index(side)], _padded_rows(len(times))
    sampled_states, _ = sample(*take_lanes((scene, entry_state, times), padded_rows))
    x, v, phase = (
        np.asarray(array)[: len(times)] for array in (sampled_states.x, sampled_states.v, sampled_states.phase)
    )
    wall_position, wall_velocity = _wall_motion(scene, phase, side)
    rounding = ROUNDING_ERRORS * np.finfo(x.dtype).eps * (abs(x) + abs(wall_position))
    depth = wall_sign * (x - wall_position)
    force, depth_rate = _wall_contact_force(scene, depth, v, wall_velocity, side)
    rounded_force, _ = _wall_contact_force(scene, depth + rounding, v, wall_velocity, side)
    return force, depth_rate, abs(rounded_force - force).max(axis=1)


def _padded_rows(n_rows):
    """Return the indices of rows, filled up with the last one to a power of 8, so that few shapes are compiled."""
    n_padded = 1 << LOG2_OF_SIZES * max(1, -(-(n_rows - 1).bit_length() // LOG2_OF_SIZES))
    return np.minimum(np.arange(n_padded), n_rows - 1)


def _wall_motion(scene, phase, side):
    """Return position and velocity of a wall at phases of shape (lanes, ...)."""
    broadcastable_scene = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *[1] * (phase.ndim - 1)), scene)
    return [np.asarray(array) + 0.0 * phase for array in wall_states(broadcastable_scene, phase)[SIDES.index(side)]]


@persistent_jit(compiler_options=FAST_COMPILE)
def _contact_durations(scene, wall_sign, depth, depth_rate, phase, max_duration):
    """Compute the durations of contact phases from their initial depths and rates, at most `max_duration`."""
    coeffs = flow_coefficients(scene)
    contact_code = wall_sign * jnp.where(depth > 0, 1.0 * Contact.WITHIN, 1.0 * Contact.ENTERED)
    return coeffs.contact.contact_duration(
        coeffs, contact_code, wall_sign * depth, wall_sign * depth_rate, jnp.cos(phase), jnp.sin(phase), max_duration
    )


def _wall_contact_force(scene, depth, v, wall_velocity, side):
    """Return (force of a soft wall against the mass, speed into the wall) at depths of shape (lanes, points)."""
    depth_rate = WALL_SIGNS[SIDES.index(side)] * (v - wall_velocity)
    return contact_of_wall(scene, side).wall_force(scene, side, depth, depth_rate, v), depth_rate


def _largest_forces_of_panels(force, force_coefficients):
    """Maximise the interpolating polynomial of each row on a grid, then by Newton steps; include the end values."""
    force_series = [force_coefficients, *(legendre.legder(force_coefficients, order) for order in (1, 2))]
    chebyshev_grid = np.cos(np.linspace(0.0, np.pi, N_GRID))
    force_maximiser = chebyshev_grid[np.argmax(legendre.legval(chebyshev_grid, force_coefficients), axis=1)]
    for _ in range(NEWTON_STEPS):
        force_slope, force_curvature = (
            legendre.legval(force_maximiser, derivative_series, tensor=False) for derivative_series in force_series[1:]
        )
        newton_step = -force_slope / np.where(force_curvature < 0.0, force_curvature, -np.inf)
        force_maximiser = np.clip(force_maximiser + np.clip(newton_step, -np.pi / N_GRID, np.pi / N_GRID), -1.0, 1.0)
    return np.maximum(force.max(axis=1), legendre.legval(force_maximiser, force_coefficients, tensor=False))


def _loads_dataset(scene, shape, load_arrays, status):
    """Assemble the Dataset of the loads and the status."""
    lane_dims = ["lane"] if len(shape) == 1 else [f"lane_{axis}" for axis in range(len(shape))]
    dataset_variables = {
        name: ([*lane_dims, "wall"], values.reshape(*shape, -1), {"long_name": long_name, "units": unit})
        for (name, (unit, long_name)), values in zip(LOAD_COLUMNS.items(), load_arrays, strict=True)
    }
    dataset_variables["status"] = (lane_dims, status.reshape(shape), {"long_name": "worst status, as of strobe"})
    return xr.Dataset(dataset_variables, {"wall": ("wall", list(scene.walls))})
