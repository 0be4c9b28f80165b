"""Define records of measurements, and detect records of settled (periodic) motions."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from jaxtyping import ArrayLike, Float, Int, Real

from ..branches.branch import Special
from ..scene import check
from ..scene.scales import require_scales
from ..scene.scene import SIDES, Scene


@dataclass(frozen=True, eq=False)
class ImpactRecord:
    """Record of the impacts of one motion.

    Parameters
    ----------
    times : array_like
        Times of the impacts in order, since the drive was at `phase`. Array of shape (impacts,).
    sides : array_like
        Side of each impact, -1 left, 1 right. Array of shape (impacts,).
    sigma : float
        Standard error of a time, the same for all.
    phase : float or None, optional
        Phase of the drive at time 0, in rad. None if it is unknown.
    flawed : bool, optional
        True if impacts may be missing from the record or spurious.

    Raises
    ------
    ArgumentError
        If an array is not finite, if the times are not in order, or if the lengths differ.

    See Also
    --------
    fit : Fit parameters of a scene to a record.
    record_from_physical : Convert a record from physical units.

    Examples
    --------
    >>> record = jv.ImpactRecord(times=[0.16, 1.66, 3.16], sides=[1, -1, 1], sigma=0.01)
    >>> record.times.shape, record.flawed
    ((3,), True)
    """

    times: Float[np.ndarray, " impacts"] | Real[ArrayLike, " impacts"]
    sides: Int[np.ndarray, " impacts"] | Real[ArrayLike, " impacts"]
    sigma: float
    phase: float | None = 0.0
    flawed: bool = True

    def __post_init__(self) -> None:
        times = _parse_vector("times", self.times)
        sides = _parse_vector_per_time("sides", self.sides, times)
        if not np.all(np.isin(sides, (-1.0, 1.0))):
            raise check.ArgumentError("sides", "must be -1 (left) or 1 (right)", float(sides[abs(sides) != 1.0][0]))
        _require_time_order(times, np.diff(times) < 0)
        sigma, phase = require_positive_number("sigma", self.sigma), _parse_phase(self.phase)
        check.set_fields(self, times=times, sides=sides.astype(int), sigma=sigma, phase=phase)
        if not isinstance(self.flawed, bool):
            raise check.ArgumentError("flawed", "must be True or False", self.flawed)


@dataclass(frozen=True, eq=False)
class SampleRecord:
    """Record of samples of one motion: a time series of x(t), or a Poincaré section.

    A section has `v`, and times that are one period apart.

    Parameters
    ----------
    times : array_like
        Increasing times of the samples, since the drive was at `phase`. Array of shape (samples,).
    x : array_like
        Positions in lengths of the scene. Array of shape (samples,).
    sigma : float
        Standard error of a position, the same for all.
    v : array_like, optional
        Velocities. Array of shape (samples,). None if they are not measured.
    sigma_v : float, optional
        Standard error of a velocity. By default `sigma`.
    phase : float or None, optional
        Phase of the drive at time 0, in rad. None if it is unknown.

    Raises
    ------
    ArgumentError
        If an array is not finite, if the times are not in order, or if the lengths differ.

    See Also
    --------
    fit : Fit parameters of a scene to a record.
    record_from_physical : Convert a record from physical units.

    Examples
    --------
    >>> record = jv.SampleRecord(times=[0.0, 0.1, 0.2], x=[0.9, 0.79, 0.68], sigma=0.01)
    >>> record.measured[0].shape
    (3, 1)
    """

    times: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"]
    x: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"]
    sigma: float
    v: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"] | None = None
    sigma_v: float | None = None
    phase: float | None = 0.0

    def __post_init__(self) -> None:
        times = _parse_vector("times", self.times)
        _require_time_order(times, np.diff(times) <= 0)
        columns = {key: getattr(self, key) for key in ("x", "v") if getattr(self, key) is not None}
        columns = {key: _parse_vector_per_time(key, column, times) for key, column in columns.items()}
        if self.v is None and self.sigma_v is not None:
            raise check.ArgumentError("sigma_v", "must be omitted if v is not given", self.sigma_v)
        sigma = require_positive_number("sigma", self.sigma)
        sigma_v = None if self.sigma_v is None else require_positive_number("sigma_v", self.sigma_v)
        check.set_fields(self, times=times, **columns, sigma=sigma, sigma_v=sigma_v, phase=_parse_phase(self.phase))

    @property
    def measured(self) -> tuple[Float[np.ndarray, "samples channels"], Float[np.ndarray, " channels"]]:
        """Measured values and their standard errors.

        Tuple of the values of ``x``, and of ``v`` if it is measured, of shape (samples, channels), and the standard
        errors of shape (channels,).
        """
        if self.v is None:
            return np.asarray(self.x)[:, None], np.array([self.sigma])
        return np.stack([self.x, self.v], 1), np.array([self.sigma, self.sigma_v or self.sigma])


@check.host_only("multiply by what `scene.scales` says")
def record_from_physical(record: ImpactRecord | SampleRecord, scene: Scene) -> ImpactRecord | SampleRecord:
    """Convert a record in seconds, metres and metres per second to the units of a scene.

    Parameters
    ----------
    record : ImpactRecord or SampleRecord
        Record in s, m and m/s. The errors have the same units.
    scene : Scene
        Scene with scales.

    Returns
    -------
    ImpactRecord or SampleRecord
        Record of the same kind, in units of the scene, for `fit`.

    Raises
    ------
    ArgumentError
        If `record` is of another type, or if the scene has no scales.

    See Also
    --------
    scene_from_physical : Make a scene with scales.

    Examples
    --------
    >>> rig = jv.scene_from_physical(
    ...     mass=1.0, stiffness=100.0, damping=1.0, force=2.0, frequency_hz=3.0, restitution=0.7, walls=(-0.01, 0.01)
    ... )
    >>> record = jv.ImpactRecord(times=[0.1, 0.25, 0.4], sides=[1, -1, 1], sigma=0.001)
    >>> jv.record_from_physical(record, rig).times
    array([1. , 2.5, 4. ])
    """
    scales = require_scales(scene)
    natural_frequency, length_scale = scales.natural_frequency, scales.length
    times = natural_frequency * np.asarray(record.times)
    if isinstance(record, ImpactRecord):
        return replace(record, times=times, sigma=natural_frequency * record.sigma)
    velocity_scale, v = length_scale * natural_frequency, record.v
    sigma_v = (record.sigma if record.sigma_v is None else record.sigma_v) / velocity_scale
    return replace(
        record,
        times=times,
        x=np.asarray(record.x) / length_scale,
        sigma=record.sigma / length_scale,
        v=None if v is None else np.asarray(v) / velocity_scale,
        sigma_v=None if v is None else sigma_v,
    )


def require_positive_number(argument_name, value):
    """Convert a value to a positive float.

    Parameters
    ----------
    argument_name : str
        Name of the argument, for the error message.
    value : float
        Value to convert.

    Returns
    -------
    float
        The value.

    Raises
    ------
    ArgumentError
        If the value is not a finite number greater than 0.
    """
    number = check.check_finite_array(argument_name, value, np.float64)
    if number.ndim or number <= 0:
        raise check.ArgumentError(argument_name, "must be a number greater than 0", value)
    return float(number)


def _parse_vector_per_time(argument_name, value, times):
    values_per_time = _parse_vector(argument_name, value)
    if len(values_per_time) != len(times):
        raise check.ArgumentError(
            argument_name, f"must have one entry for each time, {len(times)}", len(values_per_time)
        )
    return values_per_time


def _require_time_order(times, is_out_of_order):
    if np.any(is_out_of_order):
        first_wrong_index = int(np.flatnonzero(is_out_of_order)[0]) + 1
        raise check.ArgumentError("times", "must be in order", float(times[first_wrong_index]), (first_wrong_index,))


def _parse_phase(value):
    return None if value is None else float(check.check_finite_array("phase", value, np.float64))


def _parse_vector(argument_name, value):
    array = check.check_finite_array(argument_name, value, np.float64)
    if array.ndim != 1 or not len(array):
        raise check.ArgumentError(argument_name, "must be a one-dimensional array with at least one number", value)
    return array


@dataclass(frozen=True, eq=False)
class PointRecord:
    """Record of published values of special points.

    Parameters
    ----------
    points : tuple of Special
        Special points of branches, of kind SN, PD, SB or GR. The scene of each is the scene of the measurement, except
        for the free parameters.
    values : array_like
        Published parameter values. Array of shape (points,).
    sigma : float
        Standard error of the values, the same for all.
    walls : tuple of str or None, optional
        ``"left"`` or ``"right"`` for a GR that touches both walls at once, None for other points. By default None for
        all.

    Raises
    ------
    ArgumentError
        If an array is not finite, or if the lengths differ.

    See Also
    --------
    fit : Fit parameters of a scene to a record.

    Examples
    --------
    >>> record = jv.PointRecord(branch.points("SN"), [0.52], sigma=0.01)
    >>> record.walls
    (None,)
    """

    points: tuple[Special, ...]
    values: Float[np.ndarray, " points"] | Real[ArrayLike, " points"]
    sigma: float
    walls: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        points, values = tuple(self.points), _parse_vector("values", self.values)
        if len(points) != len(values):
            raise check.ArgumentError("values", f"must have one entry for each point, {len(points)}", len(values))
        for point in points:
            if not isinstance(point, Special):
                raise check.ArgumentError("points", "must be special points of branches", point)
        walls = tuple(self.walls) or (None,) * len(points)
        if len(walls) != len(points) or not set(walls) <= {None, *SIDES}:
            raise check.ArgumentError("walls", 'must be "left", "right" or None for each point', self.walls)
        sigma = require_positive_number("sigma", self.sigma)
        check.set_fields(self, walls=walls, points=points, values=values, sigma=sigma)


MAX_PERIODS = 8  # largest number of drive periods of a cycle
PHASE_DECIMALS = 6  # decimals of the fraction of a cycle to which equal times agree
MIN_ROUNDS = 3  # smallest number of cycles of a settled record
REJECTION_PROBABILITY = 1e-3  # probability that noise makes a settled record appear unsettled


def count_impact_information(data, drive_frequency, has_free_frequency):
    """Count the independent values of a settled record of impacts.

    Each impact in a cycle yields one value. A free frequency adds one value, the period. An unknown phase does not
    reduce the number, because the phase is counted as a free parameter. Returns None if the motion is not settled.
    """
    times, sides = np.asarray(data.times), np.asarray(data.sides)
    for impacts_per_cycle in range(1, len(times) // MIN_ROUNDS + 1):
        if np.any(sides[impacts_per_cycle:] != sides[:-impacts_per_cycle]):
            continue
        drive_period = 2.0 * np.pi / drive_frequency
        periods_per_cycle = (times[impacts_per_cycle:] - times[:-impacts_per_cycle]) / drive_period
        periods = np.round(np.mean(periods_per_cycle))
        if not 1 <= periods <= MAX_PERIODS:
            continue
        if _do_times_repeat(
            times, impacts_per_cycle, None if has_free_frequency else periods * drive_period, data.sigma
        ):
            return impacts_per_cycle + bool(has_free_frequency)
    return None


def count_sample_information(data: SampleRecord, drive_frequency: float) -> int | None:
    """Count the independent values of a settled record of samples: the values in one cycle.

    Returns None if the motion is not settled, or if the sampling phases do not repeat from cycle to cycle.
    """
    measurements, sigma = data.measured
    for periods in range(1, MAX_PERIODS + 1):
        elapsed_cycles = np.asarray(data.times) * drive_frequency / (2.0 * np.pi * periods)
        cycle_fractions = np.round((elapsed_cycles - elapsed_cycles[0]) % 1.0, PHASE_DECIMALS) % 1.0
        _, phase_indices, samples_per_phase = np.unique(cycle_fractions, return_inverse=True, return_counts=True)
        if np.min(samples_per_phase) < MIN_ROUNDS:
            continue
        phase_means = np.stack([np.bincount(phase_indices, column) / samples_per_phase for column in measurements.T], 1)
        residuals = (measurements - phase_means[phase_indices]) / sigma
        if np.sum(residuals**2) <= scipy.special.chdtri(residuals.size - phase_means.size, REJECTION_PROBABILITY):
            return int(phase_means.size)
    return None


def _do_times_repeat(times, impacts_per_cycle, cycle_time, sigma):
    """Check that impact times repeat within their errors after each `impacts_per_cycle` impacts.

    `cycle_time` is the duration of a cycle, or None if it is unknown.
    """
    index_in_cycle, cycle_indices = (
        np.arange(len(times)) % impacts_per_cycle,
        np.arange(len(times)) // impacts_per_cycle,
    )
    regression_matrix = (index_in_cycle[:, None] == np.arange(impacts_per_cycle)).astype(float)
    fit_targets = times if cycle_time is None else times - cycle_indices * cycle_time
    if cycle_time is None:
        regression_matrix = np.column_stack([regression_matrix, cycle_indices])
    solution = np.linalg.lstsq(regression_matrix, fit_targets, rcond=None)[0]
    residuals = (fit_targets - regression_matrix @ solution) / sigma
    return bool(
        residuals @ residuals
        <= scipy.special.chdtri(max(1, len(times) - regression_matrix.shape[1]), REJECTION_PROBABILITY)
    )
