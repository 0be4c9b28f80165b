"""Define the record of a periodic orbit and its error, compute multipliers, and compare orbits.

Compare orbits by their impacts, as points (wall, phase, speed). An impact determines all motion that follows. Therefore
two orbits are the same if their impacts are the same, whichever impact or period comes first and however often the
orbit is traversed. The impacts of the mirror image are on the other walls, half a drive period later, with the same
speeds.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex

from ..maps import itinerary as words
from ..maps.sticking_phase_intervals import NO_STICKING
from ..output.table_text import align_columns, column_header, multipliers_text
from ..output.units import LENGTH, SPEED, TIME, unit_in_system
from ..scene.scene import SIDES, Scene
from ..scene.state import Impacts, State, Status

WALL_OFFSET = 10.0  # separates the points of the walls by more than the distance of any two on one wall
MAX_QUERIES = 200  # impacts of one set that are compared with another


def impacts_as_points(frequency, time, side, speed, speed_scale):
    """Convert impacts to points.

    Parameters
    ----------
    frequency : float
        Frequency of the drive.
    time, side, speed : numpy.ndarray
        Impacts in arrays of one shape, with side 0 in empty slots. `time` is the time since phase 0, up to
        multiples of the drive period.
    speed_scale : float
        Large speed of the scene, in lengths per t.

    Returns
    -------
    numpy.ndarray
        Points (side * WALL_OFFSET, cos phase, sin phase, speed / speed_scale) in order, of shape (impacts, 4).
    """
    is_impact = side != 0
    phase = frequency * time[is_impact]
    return np.stack([side[is_impact] * WALL_OFFSET, np.cos(phase), np.sin(phase), speed[is_impact] / speed_scale], -1)


def mirror_points(points):
    """Compute the points of the mirror image: impacts on the other walls, half a drive period later.

    Parameters
    ----------
    points : numpy.ndarray
        Points of shape (impacts, 4).

    Returns
    -------
    numpy.ndarray
        Points of the mirror image.
    """
    return points * np.array([-1.0, -1.0, -1.0, 1.0])


def is_same_orbit(points, other_points, tolerance=None):
    """Test whether two periodic orbits of a scene are the same, possibly traversed several times.

    Each impact must be near an impact of the other orbit. Impacts whose scaled speed is at most the tolerance are
    ignored. Orbits without further impacts are the same.

    Parameters
    ----------
    points, other_points : numpy.ndarray
        Impacts of the orbits as points.
    tolerance : float, optional
        Largest distance of two points. By default it is eps^(1/4), for orbits on which states have settled.

    Returns
    -------
    bool
        True if they are the same.
    """
    tolerance = np.finfo(points.dtype).eps ** 0.25 if tolerance is None else tolerance
    points, other_points = (
        _weight_phases_by_speed(impact_points[impact_points[:, -1] > tolerance])
        for impact_points in (points, other_points)
    )
    if not len(points) or not len(other_points):
        return len(points) == len(other_points)
    pair_distances = abs(points[:, None] - other_points).max(axis=-1)
    return bool(max(pair_distances.min(axis=0).max(), pair_distances.min(axis=1).max()) <= tolerance)


def repetition_count(points, periods, tolerance):
    """Count how many times an orbit traverses a shorter one.

    Parameters
    ----------
    points : numpy.ndarray
        Impacts as points, in order of time. Impacts whose scaled speed is at most `tolerance` are ignored.
    periods : int
        Number of drive periods.
    tolerance : float
        Largest distance of two equal points.

    Returns
    -------
    int
        Number of repetitions. Without impacts the motion is the response to the drive, which repeats every period.
    """
    points = _weight_phases_by_speed(points[points[:, -1] > tolerance])
    n_impacts = len(points)
    if not n_impacts:
        return periods
    common_divisors = (
        divisor for divisor in range(periods, 0, -1) if periods % divisor == 0 and n_impacts % divisor == 0
    )
    return next(
        (
            divisor
            for divisor in common_divisors
            if abs(np.roll(points, n_impacts // divisor, axis=0) - points).max() <= tolerance
        ),
        1,
    )


def _weight_phases_by_speed(points):
    """Weight the phases by the speed where it is small: the times of slow impacts are less accurate."""
    return np.concatenate([points[:, :1], points[:, 1:3] * np.minimum(points[:, 3:], 1.0), points[:, 3:]], axis=1)


def samples_fill_same_set(points, other_points):
    """Test whether two long samples of impacts, in order of time, fill the same set.

    The median distance from the points of one sample to the other sample must be at most three times the median
    distance between the halves of the other sample. One direction is sufficient, because an orbit may still explore
    part of a set.

    Parameters
    ----------
    points, other_points : numpy.ndarray
        Samples as points, of shape (impacts, 4).

    Returns
    -------
    bool
        True if they fill the same set.
    """
    return bool(
        _median_distance(points, other_points) <= 3.0 * _sample_half_distance(other_points)
        or _median_distance(other_points, points) <= 3.0 * _sample_half_distance(points)
    )


def _sample_half_distance(points):
    n_half = len(points) // 2
    return _median_distance(points[n_half:], points[:n_half])


def _median_distance(points, other_points):
    """Return the median distance from a subset of the points to the other points; inf without points."""
    distances = _nearest_distances(points[:: max(1, len(points) // MAX_QUERIES)], other_points)
    return np.median(distances) if len(distances) else np.inf


def _nearest_distances(points, other_points):
    """Return the distance of each point to the nearest other point, accurate to the square root of rounding."""
    if not len(other_points):
        return np.full(len(points), np.inf)
    squared_distances = np.einsum(
        "ik,jk->ij", -2.0 * points, other_points
    )  # ten times as fast as a threaded matrix product for these shapes
    squared_distances += (other_points**2).sum(-1)
    return np.sqrt(np.maximum(squared_distances.min(axis=1) + (points**2).sum(-1), 0.0))


AREA_TOLERANCE = 1e-9  # relative to (1 + the trace)^2: a determinant this close to 1 counts as 1
STABILITY_MARGIN = 1e-9  # closer to modulus 1, at special points, rounding would decide the stability


class OrbitError(ValueError):
    """Failure to find a periodic orbit.

    Attributes
    ----------
    status : str
        Reason in a few words.
    residual : float
        Residual or return distance of the last iterate, in lengths of the scene; nan if there is none.
    advice : str
        Possible remedy.

    See Also
    --------
    find_orbit : Find the orbit near a state.

    Examples
    --------
    >>> try:
    ...     jv.find_orbit(scene, jv.State(x=0.9, v=-1.1), itinerary=("R",))
    ... except jv.OrbitError as error:
    ...     print(error.status)
    no guess leads to a solution with this itinerary
    """

    def __init__(self, status: str, residual: float, advice: str) -> None:
        super().__init__(status, residual, advice)
        self.status, self.residual, self.advice = status, residual, advice

    def __str__(self) -> str:
        residual_text = "" if np.isnan(self.residual) else f" (residual {self.residual:.1e})"
        return f"no orbit: {self.status}{residual_text}; {self.advice}"


@dataclass(frozen=True, eq=False)
class Orbit:
    """Periodic orbit of a scene.

    Attributes
    ----------
    label : str
        ``P n p q`` for n drive periods and p and q impacts on the left and right wall. A count is ``inf`` on a wall
        with complete chatter, as in ``P1-0-inf``.
    periods : int
        Smallest number n of drive periods after which the motion repeats.
    state : State
        State on the orbit at the phase of the section. The section lies at the requested phase, unless the phase of an
        impact differs from it by less than a thousandth of a period. In this case the section lies in the middle of the
        widest gap between the phases of impacts.
    impacts : Impacts
        Impacts in n periods from `state`, without empty slots.
    itinerary : tuple of str
        Walls that are hit: a word of "L" and "R" for each period.
    multipliers : array of complex
        Floquet multipliers, the larger first, of shape (2,).
    stable : bool
        True if both multipliers are smaller than 1 in modulus, by more than rounding.
    residual : float
        Largest residual of the equations that were solved, in lengths or lengths per t.
    least_speed : float
        Smallest impact speed, in lengths per t; inf without impacts.
    least_clearance : float
        Smallest distance to a wall at a turning point towards it, in lengths; inf without one.
    unknowns : {"impacts", "state"}
        Unknowns that were solved for: times and speeds of the impacts, or the state.
    scene : Scene
        Scene of the orbit.
    mirror_of : int or None
        Index of the mirror image in the result of `find`; its own index for a symmetric orbit. None otherwise.
    rests : bool
        True if the mass sticks to a wall during part of the orbit. Bounces of complete chatter are recorded until it is
        certain that the mass will stick.

    See Also
    --------
    find_orbit : Find the orbit near a state.
    follow : Continue an orbit in a parameter.

    Examples
    --------
    >>> orbit.label, orbit.itinerary, orbit.stable
    ('P111', ('RL',), True)
    >>> orbit.multipliers.round(6)
    array([-0.235309+0.350203j, -0.235309-0.350203j])
    """

    label: str
    periods: int
    state: State
    impacts: Impacts
    itinerary: tuple[str, ...]
    multipliers: Complex[np.ndarray, "2"]
    stable: bool
    residual: float
    least_speed: float
    least_clearance: float
    unknowns: str
    scene: Scene = field(repr=False)
    mirror_of: int | None = None
    rests: bool = False

    def table(self, units: str = "scene") -> str:
        """Format the orbit as a table: summary, state, and time, wall and speed of each impact.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the numbers. Physical units are s, mm and m/s, and need a scene with scales.

        Returns
        -------
        str
            Table with a line for each impact.

        Raises
        ------
        ArgumentError
            If the units are unknown, or if the scene has no scales.

        Examples
        --------
        >>> print(orbit.table())
        P111, stable, multipliers -0.235309 +- 0.350203i
        x 0.690524984655, v 1.80367847869 at phase 0
        time         wall   speed
        0.164095319  right  1.95610463
        1.66009182   left   1.95610463
        """
        (length_unit, length_scale), (speed_unit, speed_scale), (time_unit, time_scale) = (
            unit_in_system(self.scene, quantity, units) for quantity in (LENGTH, SPEED, TIME)
        )
        rows = [(column_header("time", time_unit, units), "wall", column_header("speed", speed_unit, units))]
        impacts = zip(self.impacts.time, self.impacts.side, self.impacts.speed, strict=True)
        rows += [
            (f"{time_scale * time:.9g}", SIDES[int(side > 0)], f"{speed_scale * speed:.9g}")
            for time, side, speed in impacts
        ]
        summary_line = (
            f"{self.label}, {'stable' if self.stable else 'unstable'}, multipliers {multipliers_text(self.multipliers)}"
        )
        x_text, v_text = f"{length_scale * self.state.x:.12g}", f"{speed_scale * self.state.v:.12g}"
        state_text = (
            f"{column_header('x', length_unit, units)} {x_text}, {column_header('v', speed_unit, units)}"
            f" {v_text} at phase {self.state.phase:.9g}"
        )
        return "\n".join([summary_line, state_text, align_columns(rows)])


def eigenvalue_pair(trace, determinant):
    """Compute the eigenvalues of a 2 by 2 matrix from trace and determinant.

    Parameters
    ----------
    trace, determinant : float
        Trace and determinant of the matrix.

    Returns
    -------
    array of complex
        Eigenvalues of shape (2,), as `eigenvalue_pairs` orders them.
    """
    return eigenvalue_pairs(np.reshape(trace, 1), np.reshape(determinant, 1))[0]


def eigenvalue_pairs(trace, determinant):
    """Compute the eigenvalues of 2 by 2 matrices from traces and determinants.

    The larger eigenvalue is computed without cancellation, the smaller one from the determinant.

    Parameters
    ----------
    trace, determinant : array
        Traces and determinants of shape (points,).

    Returns
    -------
    array of complex
        Eigenvalues of shape (points, 2), the larger first. Both are infinite if a number is not finite, as at an impact
        with zero speed.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        half_trace = 0.5 * trace
        discriminant = half_trace * half_trace - determinant
        larger_eigenvalue = half_trace + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), half_trace)
        real_pairs = np.stack(
            [larger_eigenvalue, np.where(larger_eigenvalue != 0, determinant / larger_eigenvalue, 0.0)], 1
        )
        complex_pairs = half_trace[:, None] + 1j * np.sqrt(np.maximum(-discriminant, 0.0))[:, None] * np.array(
            [1.0, -1.0]
        )
        eigenvalues = np.where((discriminant < 0)[:, None], complex_pairs, real_pairs)
    return np.where(np.isfinite(eigenvalues).all(axis=1)[:, None], eigenvalues, np.inf)


def make_orbit(scene, state, impacts, itinerary, multipliers, residual, unknowns, sticking_record=NO_STICKING):
    """Assemble an `Orbit`; derive its label and its stability.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    state : State
        State at the section.
    impacts : Impacts
        Impacts in all periods, without empty slots.
    itinerary : tuple of str
        A word for each period.
    multipliers : array of complex
        Floquet multipliers of shape (2,).
    residual : float
        Largest residual of the equations.
    unknowns : {"impacts", "state"}
        Unknowns that were solved for.
    sticking_record : StickingPhaseIntervals, optional
        Sticking phases of the orbit.

    Returns
    -------
    Orbit
        The orbit.
    """
    return Orbit(
        label=words.format_label(itinerary, sticking_record.chatter_walls),
        periods=len(itinerary),
        state=state,
        impacts=impacts,
        itinerary=itinerary,
        multipliers=multipliers,
        stable=bool(np.all(abs(multipliers) < 1.0 - STABILITY_MARGIN)),
        residual=residual,
        least_speed=impacts.least_speed,
        least_clearance=impacts.least_clearance,
        unknowns=unknowns,
        scene=scene,
        rests=sticking_record.has_sticking,
    )


def rotate_to_canonical_start(itinerary, section_points, times, speeds, sides, min_clearance, drive_period):
    """Move the section of an orbit to the drive period with which its canonical itinerary begins.

    Parameters
    ----------
    itinerary : tuple of str
        A word for each period.
    section_points : ndarray
        x and v at the section of each period, array of shape (periods, 2).
    times, speeds, sides : ndarray
        Impacts since the section, arrays of shape (impacts,).
    min_clearance : float
        Least clearance of the orbit.
    drive_period : float
        Length of a drive period, in t.

    Returns
    -------
    itinerary : tuple of str
        Canonical itinerary.
    section_state : list of float
        x and v at the new section.
    impacts : Impacts
        Impacts in order since the new section.
    """
    period_shift = words.canonical_start_period(itinerary, section_points)
    times_after_start = np.mod(times - period_shift * drive_period, len(itinerary) * drive_period)
    order = np.argsort(times_after_start)
    columns = times_after_start[order], sides[order].astype(np.int8), speeds[order]
    impacts = Impacts(*columns, len(order), float(speeds.min()), min_clearance, Status.OK)
    return words.rotate_periods(itinerary, period_shift), section_points[period_shift].tolist(), impacts


def has_unit_determinants(trace, determinant):
    """Test whether the product of the multipliers of each orbit is 1.

    Parameters
    ----------
    trace, determinant : array
        Traces and determinants of the monodromy matrices.

    Returns
    -------
    bool
        True if all determinants are 1 up to `AREA_TOLERANCE`.
    """
    return bool(np.all(abs(determinant - 1.0) <= AREA_TOLERANCE * (1.0 + abs(trace)) ** 2))
