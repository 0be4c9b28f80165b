"""Record a motion on the three Poincaré sections, and advance states to another phase (paper, 1)."""

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from ..contact.kinds import make_flow_coefficients
from ..flight.path_start import start_path
from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..output.units import ANGLE, LENGTH, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import SIDES, Scene
from ..scene.state import State, Status, check_start_within_walls, make_state_arrays
from .iterate import MAX_RECORDED_PERIODS, final_states, iterate
from .reference_strobe import fly_once


def shift_phase(scene, state, phase):
    """Advance states to the next time at which the drive has a given phase.

    Parameters
    ----------
    scene : Scene
        A single scene.
    state : State
        States with leaves of shape (lanes,), all at one phase.
    phase : float
        New phase of the drive, in rad. The phase increases by an angle from 0 to less than 2 pi.

    Returns
    -------
    end : State
        States at the new phase. An impact at the new phase has already happened, as for `strobe`.
    status : numpy.ndarray of int
        Status of each lane, as in `Impacts`.
    """
    drive_angle = np.mod(phase - float(state.phase[0]), 2.0 * np.pi)
    if drive_angle == 0.0:
        return state, np.zeros(np.shape(state.x), np.int32)
    end_state, status = jax.device_get(_fly_through_angle(scene, state, drive_angle))
    return State(end_state.x, end_state.v, np.full_like(end_state.x, phase), end_state.contact), status


@jax.jit
def _fly_through_angle(scene, state, drive_angle):
    coeffs = make_flow_coefficients(scene)
    path, start_status = start_path(coeffs, state)
    end_state, impacts = fly_once(coeffs, state, path, start_status, drive_angle / coeffs.frequency)
    return end_state, jnp.asarray(impacts.status)


@check.host_only("use return_map or strobe")
def sections(
    scene: Scene, state: State, phase: Real[ArrayLike, ""] = 0.0, periods: int = 1000, settle: int = 300
) -> xr.Dataset:
    """Record the points of a motion on the three Poincaré sections.

    The sections are Sigma, a fixed phase of the drive, and the impacts on the left and right walls, L and R.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene.
    state : State
        Initial state at its phase. A single state.
    phase : float, optional
        Phase of the drive at which Sigma lies, in rad.
    periods : int, optional
        Number of drive periods to record, at least 1.
    settle : int, optional
        Number of drive periods to discard first, at least 0.

    Returns
    -------
    xarray.Dataset
        Variables ``x`` and ``v`` on Sigma along "period". Variables ``left_phase``, ``left_velocity``, ``right_phase``
        and ``right_velocity`` along the impacts on each wall: the phase of the drive in rad, from 0 to 2 pi, and the
        velocity after the impact. All are in order of time.

    Raises
    ------
    ArgumentError
        If `scene` or `state` is a batch, if a number is invalid, or if the status of the motion is CAP or worse.

    See Also
    --------
    return_map : The maps P2 and P3 on the walls.
    strobe : The map P1 on Sigma.

    Notes
    -----
    The map P1 leads from each point on Sigma to the next. P2 and P3 lead from each impact to the next impact on the
    same wall (`return_map`). On Sigma a mass within a soft wall has a position beyond the wall. At a soft wall an
    impact is an entry, at which the velocity does not change. At most 16 impacts per period are recorded.

    Examples
    --------
    >>> points = jv.sections(scene, state, periods=20)
    >>> dict(points.sizes)
    {'period': 20, 'left_impact': 20, 'right_impact': 20}
    >>> round(float(points["left_velocity"][-1]), 4)
    1.3693
    """
    check.require_single_scene(scene)
    settle, periods = check.check_whole_number("settle", settle, 0), check.check_whole_number("periods", periods, 1)
    state = make_state_arrays(scene, state)
    if np.shape(state.x + state.v + state.phase + state.contact):
        raise check.ArgumentError("state", "must be a single state, not a batch", f"shape {np.shape(state.x)}")
    check_start_within_walls(scene, state)
    phase_array = check.check_finite_array("phase", phase, np.float64)
    if phase_array.shape:
        raise check.ArgumentError("phase", "must be a number", phase_array)
    section_phase = float(phase_array)
    state = State(*(np.reshape(np.asarray(value), 1) for value in (state.x, state.v, state.phase, state.contact)))
    if settle:
        state = _require_valid_status(*final_states(scene, state, settle))
    state = _require_valid_status(*shift_phase(scene, state, section_phase))
    iterates_by_chunk = []
    for first_period in range(0, periods, MAX_RECORDED_PERIODS):
        iterates = iterate(scene, state, min(MAX_RECORDED_PERIODS, periods - first_period))
        state = _require_valid_status(iterates.state, iterates.status)
        iterates_by_chunk.append(iterates)
    return _sections_dataset(scene, section_phase, iterates_by_chunk)


def _require_valid_status(state, status):
    if status[0] >= Status.CAP:
        raise check.ArgumentError("state", "must start a motion that reaches the end", Status(status[0]).word)
    return state


def _sections_dataset(scene, phase, iterates_by_chunk):
    x, v, time, side, speed = (
        np.concatenate([getattr(iterates, field_name)[:, 0] for iterates in iterates_by_chunk])
        for field_name in ("x", "v", "time", "side", "speed")
    )
    dataset_variables = {"x": ("period", x, {"units": LENGTH}), "v": ("period", v, {"units": SPEED})}
    for side_name, wall_sign, wall_index in zip(SIDES, WALL_SIGNS, (0, 1), strict=True):
        is_impact_on_wall = side == wall_sign
        impact_phase = phase + float(scene.frequency) * time[is_impact_on_wall]
        velocity_after = np.empty(0)
        if getattr(scene, side_name) is not None:
            wall_velocity = np.asarray(wall_states(scene, impact_phase)[wall_index][1])
            velocity_after = wall_velocity - float(scene.bounce(side_name)) * wall_sign * speed[is_impact_on_wall]
        dataset_variables[f"{side_name}_phase"] = (
            f"{side_name}_impact",
            np.mod(impact_phase, 2.0 * np.pi),
            {"units": ANGLE},
        )
        dataset_variables[f"{side_name}_velocity"] = f"{side_name}_impact", velocity_after, {"units": SPEED}
    return xr.Dataset(dataset_variables, attrs=scene.numbers | {"phase": phase} | scales_attributes(scene))
