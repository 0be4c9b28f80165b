"""Convert a branch to lines for plotting, with stability and breaks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..flight.wall_positions import wall_states
from ..output.equal_runs import find_equal_runs
from ..problem.orbit_curve import largest_speed
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
        True if the orbits are stable.
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
    values, line_rows, stable = _lines_with_breaks(branch, variable, columns)
    pieces = tuple(
        Piece(values[start_row : stop_row + 1], line_rows[start_row : stop_row + 1], bool(stable[start_row]))
        for start_row, stop_row in find_equal_runs(stable)
    )
    kinds = dict.fromkeys(special.kind for special in branch.special if special.kind != "EP")
    return Curves(pieces, {kind: _make_marks(branch, kind, variable, columns) for kind in kinds})


def _make_marks(branch, kind, variable, columns):
    """Return the `Marks` of the special points of one kind.

    A grazing has clearance 0. The row of its point has the clearance at other turning points if the touch is an impact.
    """
    special_points = branch.points(kind)
    mark_columns = columns[[special.place for special in special_points]]
    if kind == "GR" and variable == "clearance":
        mark_columns = np.zeros_like(mark_columns)
    return Marks(np.array([special.value for special in special_points]), mark_columns)


def _lines_with_breaks(branch, variable, columns):
    """Return the values, columns and stability of the lines of one variable.

    Their shapes are (rows,), (rows, columns) and (rows - 1,). The variables "x" and "v" have one column per drive
    period, the others have one column. The stability refers to the step from a row to the next row. Each row is a point
    of the branch. Where a line breaks, three rows are inserted between two points: the end of the old line, nan, and
    the beginning of the new line.
    """
    is_in_unit_circle = abs(branch.multipliers).max(axis=1) < 1.0 + STABILITY_MARGIN
    stable = is_in_unit_circle[:-1] & is_in_unit_circle[1:]
    breaks_by_row = _itinerary_breaks(branch, columns)
    if variable in ("x", "v"):
        breaks_by_row |= _phase_zero_breaks(branch, variable, columns)
    insertion_indices = np.repeat(np.array(sorted(breaks_by_row), int), 3)
    inserted_values = [value for row_before in sorted(breaks_by_row) for value in breaks_by_row[row_before][0]]
    inserted_rows = [row for row_before in sorted(breaks_by_row) for row in breaks_by_row[row_before][1]]
    return (
        np.insert(branch.values, insertion_indices + 1, inserted_values),
        np.insert(columns, insertion_indices + 1, np.reshape(inserted_rows, (-1, columns.shape[1])), axis=0),
        np.insert(stable, insertion_indices, stable[insertion_indices]),
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
    """Return ``{row before the break: (values, rows)}`` where the itinerary changes and a column jumps."""
    segment_numbers, largest_value = branch.data["segment"].values, np.nanmax(abs(columns), initial=0.0)
    is_jump = (abs(np.diff(columns, axis=0)) > JUMP_TOLERANCE * largest_value) & (np.diff(segment_numbers) != 0)[
        :, None
    ]
    return {
        int(row_before): _break_rows(branch.values, columns, row_before, is_jump[row_before])
        for row_before in np.flatnonzero(is_jump.any(axis=1))
    }


def _break_rows(values, columns, row_before, is_column_broken):
    """Return the three rows to insert between two points where the columns marked in `is_column_broken` jump."""
    nan_row = np.where(is_column_broken, np.nan, columns[row_before])
    return values[[row_before, row_before, row_before + 1]], np.stack(
        [columns[row_before], nan_row, columns[row_before + 1]]
    )


def _phase_zero_breaks(branch, variable, columns):
    """Return ``{row before the break: (values, rows)}`` where an impact crosses phase 0."""
    values, segment_numbers = branch.values, branch.data["segment"].values
    frequency = values if branch.name == "frequency" else float(branch.scene.frequency)
    impact_phases = (branch.data["time"].values.T * frequency).T / (2.0 * np.pi)
    period_numbers = np.floor(impact_phases)
    is_crossing = (
        (np.diff(period_numbers, axis=0) != 0)
        & np.isfinite(impact_phases[:-1])
        & (np.diff(segment_numbers) == 0)[:, None]
    )
    breaks_by_row = {}
    for row_before in np.flatnonzero(is_crossing.any(axis=1)):
        (crossing_indices,) = np.nonzero(is_crossing[row_before])
        phase_before, phase_after = (
            impact_phases[row_before, crossing_indices[0]],
            impact_phases[row_before + 1, crossing_indices[0]],
        )
        if (
            len(crossing_indices) == 1
            and abs(
                period_numbers[row_before + 1, crossing_indices[0]] - period_numbers[row_before, crossing_indices[0]]
            )
            == 1
        ):
            step_fraction = (np.round(0.5 * (phase_before + phase_after)) - phase_before) / (phase_after - phase_before)
            breaks_by_row[int(row_before)] = _phase_zero_rows(
                branch, variable, columns, row_before, crossing_indices[0], step_fraction, phase_after > phase_before
            )
        else:
            breaks_by_row[int(row_before)] = _break_rows(values, columns, row_before, True)
    return breaks_by_row


def _phase_zero_rows(branch, variable, columns, row_before, impact_index, step_fraction, moves_later):
    """Return the three rows to insert where one impact crosses phase 0, at a fraction of the step to the next point.

    The mass is then on the wall. If the impact moves to later phases, the velocity at phase 0 changes from the velocity
    after the impact to the velocity before the impact. For an impact at phase 0, the state at phase 0 is the state
    after the impact.
    """

    def interpolate_along_branch(point_values):
        return (1.0 - step_fraction) * point_values[row_before] + step_fraction * point_values[row_before + 1]

    value, row = interpolate_along_branch(branch.values), interpolate_along_branch(columns)
    scene = branch.scene.replace(**{branch.name: value})
    side, speed = (
        int(branch.data["side"].values[row_before, impact_index]),
        interpolate_along_branch(branch.data["speed"].values[:, impact_index]),
    )
    name = SIDES[int(side > 0)]
    wall_position, wall_velocity = (float(wall_component) for wall_component in wall_states(scene, 0.0)[int(side > 0)])
    values_across_impact = (wall_velocity - float(scene.bounce(name)) * side * speed, wall_velocity + side * speed)
    if variable == "x":
        values_across_impact = 2 * (wall_position,)
    n_periods = branch.data.sizes["period"]
    impact_phase = (
        interpolate_along_branch(branch.data["time"].values[:, impact_index]) * float(scene.frequency) / (2.0 * np.pi)
    )
    rows = np.stack([row, row, row])
    rows[:, round(impact_phase) % n_periods] = (values_across_impact[0], np.nan, values_across_impact[1])[
        :: 1 if moves_later else -1
    ]
    return np.full(3, value), rows
