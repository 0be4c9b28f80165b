"""Compute the Lyapunov exponents of many periodic orbits, ``ln abs(multiplier) / n``.

M is the derivative of the stroboscopic map over the n periods of an orbit, and T is the drive period. For a spring and
a damper the determinant of M is known without error from impacts and damping, ``ln det M = 2 sum ln R - 2 gamma n T``
(paper, (38)). Inside a soft wall gamma2 replaces gamma. Under a user-defined force the determinant is computed from the
derivatives of the single periods. The determinant gives the second multiplier, even if this multiplier is much smaller
than the first.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from ..contact.kinds import flow_of_scene
from ..scene.scene import SIDES
from ..scene.state import Contact, State, Status
from .tangent_growth import run_tangents, start_tangents

NEUTRAL_RATE = 1e-5  # growth per period that rounding may produce
NEWTON_STEPS = 5  # Newton steps on the stroboscopic map: the last two differ by rounding


class ExponentEstimate(NamedTuple):
    """Lyapunov exponents of one motion, or of many motions with the lanes on the first axis.

    Attributes
    ----------
    exponent : ndarray
        Exponents per period, the larger first. Array of shape (..., 2).
    error : ndarray
        Errors of the exponents. Array of shape (..., 2).
    impacts : ndarray
        Impacts per period: all, left, right. Array of shape (..., 3).
    within : ndarray
        Time inside each wall per period: left, right. Array of shape (..., 2).
    periods : int
        Periods of the orbit; 0 for none.
    status : int
        Status, as in `tangent_growth.run_tangents`.
    count : int
        Periods averaged.
    """

    exponent: Float[np.ndarray, "*lanes 2"]
    error: Float[np.ndarray, "*lanes 2"]
    impacts: Float[np.ndarray, "*lanes 3"]
    within: Float[np.ndarray, "*lanes 2"]
    periods: Int[ArrayLike, " *lanes"]
    status: Int[ArrayLike, " *lanes"]
    count: Int[ArrayLike, " *lanes"]  # type: ignore[assignment]  # hides tuple's method

    @property
    def is_repelling(self) -> Bool[ArrayLike, " *lanes"]:
        """True if the largest exponent is positive beyond rounding."""
        return self.exponent[..., 0] > NEUTRAL_RATE


def undefined_estimate(status):
    """Return an `ExponentEstimate` of nan, for a motion without exponents."""
    undefined_pair = np.full(2, np.nan)
    return ExponentEstimate(
        undefined_pair, undefined_pair, np.full(3, np.nan), undefined_pair, *np.array([0, status, 0])
    )


def measured_area_growth(scene, period_records):
    """Return the part of ``ln abs det M`` of each recorded period that `log_determinant` does not compute.

    Under a user-defined force this part is all of ``ln abs det M``, computed from the recorded matrices. Otherwise it
    is the contribution of the difference between the damping of the soft walls and the damping of the scene.
    """
    if not flow_of_scene(scene).areas_may_grow():
        area_growth = np.zeros_like(period_records.log_growth)
        for side in scene.soft_sides:
            excess_wall_damping = np.asarray(scene.parameter(f"{side}.damping")) - np.asarray(scene.damping)
            area_growth -= 2.0 * excess_wall_damping * period_records.time_in_walls[..., SIDES.index(side)]
        return area_growth
    xx, xv, vx, vv = np.moveaxis(period_records.matrix, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(abs(xx * vv - xv * vx))


def log_determinant(scene, left_impacts, right_impacts, n_periods, area_growth):
    """Return ``ln abs det M`` over `n_periods` periods with given numbers of impacts on each wall.

    area_growth: sum of `measured_area_growth` over the periods. The numbers may be arrays that broadcast.
    """
    if flow_of_scene(scene).areas_may_grow():
        return area_growth
    drive_period = 2.0 * np.pi / np.asarray(scene.frequency)
    log_abs_det = area_growth - 2.0 * np.asarray(scene.damping) * drive_period * n_periods
    for side, n_impacts in (("left", left_impacts), ("right", right_impacts)):
        if side in scene.walls and side not in scene.soft_sides:
            with np.errstate(divide="ignore", invalid="ignore"):
                log_abs_det = log_abs_det + np.where(
                    n_impacts > 0, 2.0 * n_impacts * np.log(np.asarray(scene.bounce(side))), 0.0
                )
    return log_abs_det


def compute_orbit_exponents(scene, state, periods):
    """Compute the exponents of the periodic orbits near some states.

    Newton's method on the stroboscopic map converges to rounding.

    Parameters
    ----------
    scene : Scene
        Scene, without lanes or with one lane for each state.
    state : State
        States near the orbits. Leaves of shape (lanes,).
    periods : ndarray
        Periods of the orbits, at most `RECORDED_PERIODS`. Array of shape (lanes,).

    Returns
    -------
    ExponentEstimate
        Exponents at the Newton step with the smallest residual. The errors are the differences from the exponents at
        the step with the second smallest residual.
    """
    step_results = []
    for _ in range(NEWTON_STEPS):
        _, period_records = run_tangents(scene, start_tangents(state), int(periods.max()))
        return_residual = period_records.points[periods - 1, np.arange(len(periods))] - np.stack([state.x, state.v], -1)
        period_quantities = (
            period_records.left_impacts,
            period_records.right_impacts,
            period_records.n_impacts,
            measured_area_growth(scene, period_records),
            *np.moveaxis(period_records.time_in_walls, -1, 0),
        )
        left_impacts, right_impacts, all_impacts, area_growth, *time_within = (
            _sum_first_periods(period_values, periods) for period_values in period_quantities
        )
        normalised_product, log_scale = _multiply_period_matrices(period_records.matrix, periods)
        log_multipliers = _log_multipliers(
            normalised_product, log_scale, log_determinant(scene, left_impacts, right_impacts, periods, area_growth)
        )
        residual_norm = np.nan_to_num(abs(return_residual).max(axis=1), nan=np.inf)
        step_results.append(
            (
                residual_norm,
                log_multipliers / periods[:, None],
                np.stack([all_impacts, left_impacts, right_impacts, *time_within], -1),
                period_records.status,
            )
        )
        state = _newton_update(state, normalised_product, log_scale, return_residual)
    residual_norm, exponents_by_step, impacts_and_wall_times_by_step, status = map(
        np.stack, zip(*step_results, strict=True)
    )
    best_step_indices, second_best_indices = np.argsort(residual_norm, axis=0, kind="stable")[:2]
    lanes = np.arange(len(periods))
    return _estimate_with_errors(
        exponents_by_step[best_step_indices, lanes],
        exponents_by_step[second_best_indices, lanes],
        impacts_and_wall_times_by_step[best_step_indices, lanes],
        status[best_step_indices, lanes],
        periods,
    )


def _sum_first_periods(period_values, periods):
    """Return the sum of the first `periods` rows of each lane."""
    return np.where(np.arange(len(period_values))[:, None] < periods, period_values, 0.0).sum(axis=0)


def _multiply_period_matrices(period_matrices, periods):
    """Multiply the derivatives (periods, lanes, 4) of the periods of each orbit.

    Returns (product divided by its largest entry, logarithm of this entry).
    """
    n_lanes = len(periods)
    normalised_product, log_scale = (
        np.tile(np.eye(2, dtype=period_matrices.dtype), (n_lanes, 1, 1)),
        np.zeros(n_lanes, period_matrices.dtype),
    )
    for period_index in range(periods.max()):
        is_within_orbit = (period_index < periods)[:, None, None]
        normalised_product = np.where(
            is_within_orbit,
            period_matrices[period_index].reshape(n_lanes, 2, 2) @ normalised_product,
            normalised_product,
        )
        largest_entry = abs(normalised_product).max(axis=(1, 2))
        normalised_product = normalised_product / np.where(largest_entry > 0, largest_entry, 1.0)[:, None, None]
        with np.errstate(divide="ignore"):
            log_scale = log_scale + np.log(largest_entry)
    return normalised_product, log_scale


def _log_multipliers(normalised_product, log_scale, log_abs_det):
    """Return ``ln abs`` of the two multipliers, the larger first, (lanes, 2); log_abs_det: ``ln abs det M``."""
    half_trace = 0.5 * abs(normalised_product[:, 0, 0] + normalised_product[:, 1, 1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        discriminant = half_trace * half_trace - np.exp(log_abs_det - 2.0 * log_scale)
        larger_log_multiplier = np.where(
            discriminant < 0,
            0.5 * log_abs_det,
            log_scale + np.log(half_trace + np.sqrt(np.where(discriminant < 0, 0.0, discriminant))),
        )
        smaller_log_multiplier = np.where(np.isneginf(log_abs_det), -np.inf, log_abs_det - larger_log_multiplier)
    return np.where(
        np.isneginf(log_scale)[:, None], -np.inf, np.stack([larger_log_multiplier, smaller_log_multiplier], -1)
    )


def _newton_update(state, normalised_product, log_scale, return_residual):
    """Return the states after a Newton step; the state of a mass on a wall is unchanged.

    The contact code of a changed state is 0, because the step may move the mass out of a soft wall.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        jacobian = np.eye(2) - normalised_product * np.exp(log_scale)[:, None, None]
        (xx, xv), (vx, vv) = np.moveaxis(jacobian, 0, -1)
        newton_step = np.stack(
            [
                vv * return_residual[:, 0] - xv * return_residual[:, 1],
                xx * return_residual[:, 1] - vx * return_residual[:, 0],
            ]
        ) / (xx * vv - xv * vx)
    is_in_soft_wall = abs(state.contact) == Contact.WITHIN
    can_update = (
        np.isfinite(newton_step).all(axis=0) & np.isfinite(log_scale) & (is_in_soft_wall | (state.contact == 0))
    )
    dx, dv = np.where(can_update, newton_step, 0.0).astype(return_residual.dtype)
    return State(
        state.x + dx, state.v + dv, state.phase, np.where(can_update, 0.0, state.contact).astype(return_residual.dtype)
    )


def _estimate_with_errors(exponents, second_best_exponents, impacts_and_wall_times, status, periods):
    """Return the `ExponentEstimate` from the exponents of the best and of the second best step."""
    is_invalid = (np.isnan(exponents) | np.isposinf(exponents)).any(axis=1) | (status >= Status.CAP)
    with np.errstate(invalid="ignore"):
        exponent_difference = abs(exponents - second_best_exponents) + 4.0 * np.finfo(exponents.dtype).eps * abs(
            exponents
        )
    error = np.where(np.isneginf(exponents), 0.0, np.where(np.isnan(exponent_difference), np.inf, exponent_difference))
    exponents, error, impacts_and_wall_times = (
        np.where(is_invalid[:, None], np.nan, estimate_array)
        for estimate_array in (exponents, error, impacts_and_wall_times / periods[:, None])
    )
    periods, status = np.where(is_invalid, 0, periods), np.where(is_invalid & (status == 0), Status.NONFINITE, status)
    return ExponentEstimate(
        exponents, error, impacts_and_wall_times[:, :3], impacts_and_wall_times[:, 3:], periods, status, periods
    )
