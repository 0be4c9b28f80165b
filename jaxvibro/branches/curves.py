"""Convert a branch to lines for plotting, with stability and breaks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..flight.wall_positions import wall_states
from ..output.equal_runs import find_equal_runs
from ..problem.impact_loads import largest_speed
from ..scene import check
from ..scene.scene import SIDES
from .largest_position import branch_peak_positions

VARIABLES = ("x", "v", "clearance", "speed", "least_speed", "peak")

STABILITY_MARGIN = 1e-6  # allowed excess of a multiplier over 1 at a special point
JUMP_TOLERANCE = 1e-6  # relative to the largest value; jumps between itineraries below this are ignored


class Piece(NamedTuple):
    """Part of a branch whose orbits are all stable, or all unstable.

    A row of nan breaks the line.

    Attributes
    ----------
    values : ndarray
        Parameter values, array of shape (rows,).
    columns : ndarray
        Values of the variable, array of shape (rows, columns).
    stable : bool
        Whether the orbits are stable.
    """

    values: Float[np.ndarray, " rows"]
    columns: Float[np.ndarray, "rows columns"]
    stable: bool


class Marks(NamedTuple):
    """Special points of one kind.

    Attributes
    ----------
    values : ndarray
        Parameter values, array of shape (count,).
    columns : ndarray
        Values of the variable, array of shape (count, columns).
    """

    values: Float[np.ndarray, " count"]
    columns: Float[np.ndarray, "count columns"]


class Curves(NamedTuple):
    """Branch as arrays for plotting.

    Attributes
    ----------
    pieces : tuple of Piece
        Pieces in order. Each begins where the previous one ends.
    points : dict of str to Marks
        Special points by kind, without the ends.
    """

    pieces: tuple[Piece, ...]
    points: dict[str, Marks]


def make_curves(branch, variable):
    """Return the `Curves` of one variable of a branch. Raises ArgumentError if the variable is unknown."""
    if not isinstance(variable, str) or variable not in VARIABLES:
        raise check.ArgumentError("variable", f"must be one of {', '.join(VARIABLES)}", variable)
    columns = variable_columns(branch, variable)
    values, rows, stable = _broken_lines(branch, variable, columns)
    pieces = tuple(
        Piece(values[start : stop + 1], rows[start : stop + 1], bool(stable[start]))
        for start, stop in find_equal_runs(stable)
    )
    kinds = dict.fromkeys(special.kind for special in branch.special if special.kind != "EP")
    points_by_kind = {kind: branch.points(kind) for kind in kinds}
    points = {
        kind: Marks(
            np.array([special.value for special in special_points]),
            columns[[special.place for special in special_points]],
        )
        for kind, special_points in points_by_kind.items()
    }
    return Curves(pieces, points)


def _broken_lines(branch, variable, columns):
    """Return the values, columns and stability of the lines of one variable.

    Their shapes are (rows,), (rows, columns) and (rows - 1,). The variables "x" and "v" have one column per drive
    period, the others have one column. `stable` refers to the step from a row to the next. Each row is a point of the
    branch. Where a line breaks, three rows are inserted between two points: the end of the old line, nan, and the
    beginning of the new line.
    """
    is_in_circle = abs(branch.multipliers).max(axis=1) < 1.0 + STABILITY_MARGIN
    stable = is_in_circle[:-1] & is_in_circle[1:]
    breaks = _itinerary_breaks(branch, columns)
    if variable in ("x", "v"):
        breaks |= _phase_crossings(branch, variable, columns)
    break_rows = np.repeat(np.array(sorted(breaks), int), 3)
    break_values = [value for row_before in sorted(breaks) for value in breaks[row_before][0]]
    break_columns = [row for row_before in sorted(breaks) for row in breaks[row_before][1]]
    return (
        np.insert(branch.values, break_rows + 1, break_values),
        np.insert(columns, break_rows + 1, np.reshape(break_columns, (-1, columns.shape[1])), axis=0),
        np.insert(stable, break_rows, stable[break_rows]),
    )


def variable_columns(branch, variable):
    """Return one variable at each point of a branch.

    Parameters
    ----------
    branch : Branch
        Branch.
    variable : str
        Variable, as in `Branch.curves`.

    Returns
    -------
    ndarray
        Array of shape (points, columns), nan where the variable is undefined.
    """
    data = branch.data
    if variable in ("x", "v"):
        return data[variable].values
    if variable == "peak":
        return branch_peak_positions(branch)[:, None]
    if variable == "speed":
        return largest_speed(data["side"].values, data["speed"].values)[:, None]
    minima = data["least_speed" if variable == "least_speed" else "least_clearance"].values[:, None]
    return np.where(np.isfinite(minima), minima, np.nan)


def _itinerary_breaks(branch, columns):
    """Return ``{index: (values, rows)}`` where the itinerary changes and a column jumps."""
    segment_numbers, largest_value = branch.data["segment"].values, np.nanmax(abs(columns), initial=0.0)
    is_jump = (abs(np.diff(columns, axis=0)) > JUMP_TOLERANCE * largest_value) & (np.diff(segment_numbers) != 0)[
        :, None
    ]
    return {
        int(row_before): _break_rows(branch.values, columns, row_before, is_jump[row_before])
        for row_before in np.flatnonzero(is_jump.any(axis=1))
    }


def _break_rows(values, columns, row_before, is_broken):
    """Return the three rows of a break of the columns marked in `is_broken`, between a point and the next."""
    middle_row = np.where(is_broken, np.nan, columns[row_before])
    return values[[row_before, row_before, row_before + 1]], np.stack(
        [columns[row_before], middle_row, columns[row_before + 1]]
    )


def _phase_crossings(branch, variable, columns):
    """Return ``{index: (values, rows)}`` where an impact crosses phase 0."""
    values, segment_numbers = branch.values, branch.data["segment"].values
    frequency = values if branch.name == "frequency" else float(branch.scene.frequency)
    impact_phases = (branch.data["time"].values.T * frequency).T / (2.0 * np.pi)
    period_numbers = np.floor(impact_phases)
    is_crossing = (
        (np.diff(period_numbers, axis=0) != 0)
        & np.isfinite(impact_phases[:-1])
        & (np.diff(segment_numbers) == 0)[:, None]
    )
    breaks = {}
    for row_before in np.flatnonzero(is_crossing.any(axis=1)):
        (crossing_impacts,) = np.nonzero(is_crossing[row_before])
        phase_before, phase_after = (
            impact_phases[row_before, crossing_impacts[0]],
            impact_phases[row_before + 1, crossing_impacts[0]],
        )
        if (
            len(crossing_impacts) == 1
            and abs(
                period_numbers[row_before + 1, crossing_impacts[0]] - period_numbers[row_before, crossing_impacts[0]]
            )
            == 1
        ):
            fraction = (np.round(0.5 * (phase_before + phase_after)) - phase_before) / (phase_after - phase_before)
            breaks[int(row_before)] = _crossing_rows(
                branch, variable, columns, row_before, crossing_impacts[0], fraction, phase_after > phase_before
            )
        else:
            breaks[int(row_before)] = _break_rows(values, columns, row_before, True)
    return breaks


def _crossing_rows(branch, variable, columns, row_before, impact_index, fraction, is_later):
    """Return the three rows where one impact crosses phase 0, at a fraction of the step to the next point.

    The mass is then on the wall. If the impact moves to later phases, the velocity at phase 0 changes from that after
    the impact to that before it. The state at phase 0 is the one after an impact at phase 0.
    """

    def interpolate(point_values):
        return (1.0 - fraction) * point_values[row_before] + fraction * point_values[row_before + 1]

    value, row = interpolate(branch.values), interpolate(columns)
    scene = branch.scene.replace(**{branch.name: value})
    side, speed = (
        int(branch.data["side"].values[row_before, impact_index]),
        interpolate(branch.data["speed"].values[:, impact_index]),
    )
    name = SIDES[int(side > 0)]
    wall_position, wall_velocity = (float(coordinate) for coordinate in wall_states(scene, 0.0)[int(side > 0)])
    one_sided_values = (wall_velocity - float(scene.bounce(name)) * side * speed, wall_velocity + side * speed)
    if variable == "x":
        one_sided_values = 2 * (wall_position,)
    n_periods = branch.data.sizes["period"]
    impact_phase = interpolate(branch.data["time"].values[:, impact_index]) * float(scene.frequency) / (2.0 * np.pi)
    rows = np.stack([row, row, row])
    rows[:, round(impact_phase) % n_periods] = (one_sided_values[0], np.nan, one_sided_values[1])[
        :: 1 if is_later else -1
    ]
    return np.full(3, value), rows
