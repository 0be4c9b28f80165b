"""Compute the Lyapunov exponents of many periodic orbits, ``ln abs(multiplier) / n``.

The determinant of M is known without error from impacts and damping, ``ln det M = 2 sum ln R - 2 gamma n T`` (paper,
(38)). It gives the second multiplier, however much smaller than the first. Inside a soft wall gamma2 replaces gamma.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from ..scene.codes import Contact, Status
from ..scene.scene import SIDES
from ..scene.state import State
from .tangent import run_tangents, start_tangents

NEUTRAL_RATE = 1e-5  # growth per period that rounding may produce
NEWTON_STEPS = 5  # Newton steps on the stroboscopic map: the last two differ by rounding


class ExponentEstimate(NamedTuple):
    """Lyapunov exponents of one motion, or of many, lanes first.

    Attributes
    ----------
    exponent : ndarray
        Exponents per period, the larger first. Array of shape (2,).
    error : ndarray
        Their errors. Array of shape (2,).
    impacts : ndarray
        Impacts per period: all, left, right. Array of shape (3,).
    within : ndarray
        Time inside each wall per period: left, right. Array of shape (2,).
    periods : int
        Periods of the orbit; 0 for none.
    status : int
        Status, as in `tangent.run_tangents`.
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
        """True if motions near it certainly leave it."""
        return self.exponent[..., 0] > NEUTRAL_RATE


def undefined_estimate(status):
    """Return the `ExponentEstimate` of a motion that has none."""
    undefined = np.full(2, np.nan)
    return ExponentEstimate(undefined, undefined, np.full(3, np.nan), undefined, *np.array([0, status, 0]))


def measured_area_growth(scene, records):
    """Return the part of ``ln abs det M`` of each recorded period that `log_determinant` cannot derive.

    For a user-defined force it is all of it, from the matrices; else the part of the damping of soft walls in the time
    inside them.
    """
    if scene.force is None:
        area_growth = np.zeros_like(records.growth)
        for side in scene.soft_sides:
            extra_damping = np.asarray(scene.parameter(f"{side}.damping")) - np.asarray(scene.damping)
            area_growth -= 2.0 * extra_damping * records.time_within[..., SIDES.index(side)]
        return area_growth
    a, b, c, d = np.moveaxis(records.matrix, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(abs(a * d - b * c))


def log_determinant(scene, left_impacts, right_impacts, n_periods, area_growth):
    """Return ``ln abs det M`` of `n_periods` periods with these impacts on each wall (numbers that broadcast).

    area_growth: sum of `measured_area_growth`.
    """
    if scene.force is not None:
        return area_growth
    period = 2.0 * np.pi / np.asarray(scene.frequency)
    log_det = area_growth - 2.0 * np.asarray(scene.damping) * period * n_periods
    for side, n_impacts in (("left", left_impacts), ("right", right_impacts)):
        if side in scene.walls and side not in scene.soft_sides:
            with np.errstate(divide="ignore", invalid="ignore"):
                log_det = log_det + np.where(
                    n_impacts > 0, 2.0 * n_impacts * np.log(np.asarray(scene.bounce(side))), 0.0
                )
    return log_det


def compute_orbit_exponents(scene, state, periods):
    """Compute the exponents of the periodic orbits near some states.

    Newton's method on the stroboscopic map brings the states to rounding.

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
        Exponents of the best Newton step. The errors are the distances to those of the second best.
    """
    newton_steps = []
    for _ in range(NEWTON_STEPS):
        _, records = run_tangents(scene, start_tangents(state), int(periods.max()))
        residual = records.points[periods - 1, np.arange(len(periods))] - np.stack([state.x, state.v], -1)
        quantities = (
            records.left_impacts,
            records.right_impacts,
            records.n_impacts,
            measured_area_growth(scene, records),
            *np.moveaxis(records.time_within, -1, 0),
        )
        left_impacts, right_impacts, all_impacts, area_growth, *time_within = (
            _sum_periods(quantity, periods) for quantity in quantities
        )
        matrix, log_scale = _matrix_product(records.matrix, periods)
        log_multipliers = _log_multipliers(
            matrix, log_scale, log_determinant(scene, left_impacts, right_impacts, periods, area_growth)
        )
        residual_norm = np.nan_to_num(abs(residual).max(axis=1), nan=np.inf)
        newton_steps.append(
            (
                residual_norm,
                log_multipliers / periods[:, None],
                np.stack([all_impacts, left_impacts, right_impacts, *time_within], -1),
                records.status,
            )
        )
        state = _newton_update(state, matrix, log_scale, residual)
    residual_norm, log_multipliers, all_impacts, status = map(np.stack, zip(*newton_steps, strict=True))
    best_step, second_step = np.argsort(residual_norm, axis=0, kind="stable")[:2]
    lanes = np.arange(len(periods))
    return _combine_estimates(
        log_multipliers[best_step, lanes],
        log_multipliers[second_step, lanes],
        all_impacts[best_step, lanes],
        status[best_step, lanes],
        periods,
    )


def _sum_periods(values, periods):
    """Return the sum of the first `periods` rows of each lane."""
    return np.where(np.arange(len(values))[:, None] < periods, values, 0.0).sum(axis=0)


def _matrix_product(matrices, periods):
    """Return (normalised product, logarithm of its scale) of the matrices of each period, (periods, lanes, 4)."""
    n_lanes = len(periods)
    product, log_scale = np.tile(np.eye(2, dtype=matrices.dtype), (n_lanes, 1, 1)), np.zeros(n_lanes, matrices.dtype)
    for period in range(periods.max()):
        is_active = (period < periods)[:, None, None]
        product = np.where(is_active, matrices[period].reshape(n_lanes, 2, 2) @ product, product)
        largest = abs(product).max(axis=(1, 2))
        product = product / np.where(largest > 0, largest, 1.0)[:, None, None]
        with np.errstate(divide="ignore"):
            log_scale = log_scale + np.log(largest)
    return product, log_scale


def _log_multipliers(matrix, log_scale, log_det):
    """Return ``ln abs`` of the two multipliers, the larger first, (lanes, 2); log_det: ``ln abs det M``."""
    half_trace = 0.5 * abs(matrix[:, 0, 0] + matrix[:, 1, 1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        discriminant = half_trace * half_trace - np.exp(log_det - 2.0 * log_scale)
        larger = np.where(
            discriminant < 0,
            0.5 * log_det,
            log_scale + np.log(half_trace + np.sqrt(np.where(discriminant < 0, 0.0, discriminant))),
        )
        smaller = np.where(np.isneginf(log_det), -np.inf, log_det - larger)
    return np.where(np.isneginf(log_scale)[:, None], -np.inf, np.stack([larger, smaller], -1))


def _newton_update(state, matrix, log_scale, residual):
    """Return the states after Newton's next step, unchanged for a mass that is on a wall.

    A mass inside a soft wall may come out of it; it is then free.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        jacobian = np.eye(2) - matrix * np.exp(log_scale)[:, None, None]
        (a, b), (c, d) = np.moveaxis(jacobian, 0, -1)
        step = np.stack([d * residual[:, 0] - b * residual[:, 1], a * residual[:, 1] - c * residual[:, 0]]) / (
            a * d - b * c
        )
    is_within = abs(state.contact) == Contact.WITHIN
    is_valid = np.isfinite(step).all(axis=0) & np.isfinite(log_scale) & (is_within | (state.contact == 0))
    x, v = np.where(is_valid, step, 0.0).astype(residual.dtype)
    return State(state.x + x, state.v + v, state.phase, np.where(is_valid, 0.0, state.contact).astype(residual.dtype))


def _combine_estimates(exponents, second_exponents, impacts, status, periods):
    """Return the `ExponentEstimate` from the exponents of the best and of the second best step."""
    invalid = (np.isnan(exponents) | np.isposinf(exponents)).any(axis=1) | (status >= Status.CAP)
    with np.errstate(invalid="ignore"):
        difference = abs(exponents - second_exponents) + 4.0 * np.finfo(exponents.dtype).eps * abs(exponents)
    error = np.where(np.isneginf(exponents), 0.0, np.where(np.isnan(difference), np.inf, difference))
    exponents, error, impacts = (
        np.where(invalid[:, None], np.nan, array) for array in (exponents, error, impacts / periods[:, None])
    )
    periods, status = np.where(invalid, 0, periods), np.where(invalid & (status == 0), Status.NONFINITE, status)
    return ExponentEstimate(exponents, error, impacts[:, :3], impacts[:, 3:], periods, status, periods)
