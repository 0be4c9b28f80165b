"""What was measured: small frozen records, checked as they are made."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import ArrayLike, Float, Int, Real

from ..branches.branch import Special
from ..scene import check
from ..scene.scales import require_scales
from ..scene.scene import SIDES, Scene


@dataclass(frozen=True, eq=False)
class ImpactRecord:
    """Impacts of one motion, in order. times: in t, since the drive was at `phase`, (impacts,); sides: -1 left, 1
    right; sigma: the error of a time, one for all; phase: rad, None where it is not known; flawed: whether impacts may
    be missing from the record, or be in it that are none.

    Raises ArgumentError for what is not finite, not in order, or of different lengths.
    """

    times: Float[np.ndarray, " impacts"] | Real[ArrayLike, " impacts"]
    sides: Int[np.ndarray, " impacts"] | Real[ArrayLike, " impacts"]
    sigma: float
    phase: float | None = 0.0
    flawed: bool = True

    def __post_init__(self) -> None:
        times = _parse_row("times", self.times)
        sides = _parse_matching_row("sides", self.sides, times)
        if not np.all(np.isin(sides, (-1.0, 1.0))):
            raise check.ArgumentError("sides", "must be -1 (left) or 1 (right)", float(sides[abs(sides) != 1.0][0]))
        _require_order(times, np.diff(times) < 0)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "sides", sides.astype(int))
        object.__setattr__(self, "sigma", positive_number("sigma", self.sigma))
        object.__setattr__(self, "phase", _parse_phase(self.phase))
        if not isinstance(self.flawed, bool):
            raise check.ArgumentError("flawed", "must be True or False", self.flawed)


@dataclass(frozen=True, eq=False)
class SampleRecord:
    """Samples of one motion, in order: a record of x(t), or a section. times: in t, since the drive was at `phase`,
    (samples,); x: positions; sigma: the error of a position, one for all; v: velocities, None where they are not
    measured; sigma_v: the error of a velocity, sigma where it is not given; phase: rad, None where it is not known. A
    section has v, and times that are a period apart.

    Raises ArgumentError for what is not finite, not in order, or of different lengths.
    """

    times: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"]
    x: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"]
    sigma: float
    v: Float[np.ndarray, " samples"] | Real[ArrayLike, " samples"] | None = None
    sigma_v: float | None = None
    phase: float | None = 0.0

    def __post_init__(self) -> None:
        times = _parse_row("times", self.times)
        _require_order(times, np.diff(times) <= 0)
        object.__setattr__(self, "times", times)
        for key in ("x", "v"):
            column = getattr(self, key)
            if column is not None:
                object.__setattr__(self, key, _parse_matching_row(key, column, times))
        if self.v is None and self.sigma_v is not None:
            raise check.ArgumentError("sigma_v", "must be left out where there is no v", self.sigma_v)
        object.__setattr__(self, "sigma", positive_number("sigma", self.sigma))
        if self.sigma_v is not None:
            object.__setattr__(self, "sigma_v", positive_number("sigma_v", self.sigma_v))
        object.__setattr__(self, "phase", _parse_phase(self.phase))

    @property
    def measured(self) -> tuple[Float[np.ndarray, "samples channels"], Float[np.ndarray, " channels"]]:
        """(what was measured, x first, (samples, 1) or (samples, 2); the errors of both)."""
        if self.v is None:
            return np.asarray(self.x)[:, None], np.array([self.sigma])
        return np.stack([self.x, self.v], 1), np.array([self.sigma, self.sigma_v or self.sigma])


@check.host_only("multiply by what `scene.scales` says")
def record_from_physical(record: ImpactRecord | SampleRecord, scene: Scene) -> ImpactRecord | SampleRecord:
    """A record in seconds, metres and m/s, errors included, as a scene with scales measures it: another record of its
    kind, for `fit`.

    Raises ArgumentError for what is no such record, and where the scene has no scales.
    """
    if not isinstance(record, ImpactRecord | SampleRecord):
        raise check.ArgumentError("record", "must be an ImpactRecord or a SampleRecord", record)
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


def positive_number(key, value):
    """A value as a plain number, refused where it is not finite and greater than 0."""
    number = check.finite_array(key, value, np.float64)
    if number.ndim or number <= 0:
        raise check.ArgumentError(key, "must be a number greater than 0", value)
    return float(number)


def _parse_matching_row(key, value, times):
    array = _parse_row(key, value)
    if len(array) != len(times):
        raise check.ArgumentError(key, f"must be one for each time, {len(times)}", len(array))
    return array


def _require_order(times, is_wrong):
    if np.any(is_wrong):
        bad_index = int(np.flatnonzero(is_wrong)[0]) + 1
        raise check.ArgumentError("times", "must be in order", float(times[bad_index]), (bad_index,))


def _parse_phase(value):
    return None if value is None else float(check.finite_array("phase", value, np.float64))


def _parse_row(key, value):
    array = check.finite_array(key, value, np.float64)
    if array.ndim != 1 or not len(array):
        raise check.ArgumentError(key, "must be a row of numbers, one at least", value)
    return array


@dataclass(frozen=True, eq=False)
class PointRecord:
    """Values of special points, as published. points: `Special`s of branches, SN, PD, SB or GR, each of the scene that
    it is in but for the free numbers; values: of their parameters, (points,); sigma: their error; walls: "left" or
    "right" of a GR that touches both at once, None of others, by default of all.

    Raises ArgumentError for what is not finite or of different lengths.
    """

    points: tuple[Special, ...]
    values: Float[np.ndarray, " points"] | Real[ArrayLike, " points"]
    sigma: float
    walls: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        points, values = tuple(self.points), _parse_row("values", self.values)
        if len(points) != len(values):
            raise check.ArgumentError("values", f"must be one for each point, {len(points)}", len(values))
        for point in points:
            if not isinstance(point, Special):
                raise check.ArgumentError("points", "must be Specials", point)
        walls = tuple(self.walls) or (None,) * len(points)
        if len(walls) != len(points) or not set(walls) <= {None, *SIDES}:
            raise check.ArgumentError("walls", 'must be "left", "right" or None for each point', self.walls)
        object.__setattr__(self, "walls", walls)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "sigma", positive_number("sigma", self.sigma))
