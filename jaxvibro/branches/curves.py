"""A branch as the lines of a picture: which parts are stable, and where a line breaks though the branch goes on."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..flight.wall_positions import places
from ..output.runs import runs
from ..problem.loads import largest_speed
from ..scene import check
from ..scene.scene import SIDES
from .largest_position import largest_of

VARIABLES = ("x", "v", "clearance", "speed", "least_speed", "peak")

MARGIN = 1e-6  # of a multiplier beyond 1, at a special point
JUMP = 1e-6  # of the largest value, from one itinerary to the next


class Piece(NamedTuple):
    """A piece of a branch whose orbits are all stable, or none. values: of the parameter, (rows,); columns: of a
    variable, (rows, columns); in a row of nan the line breaks."""

    values: Float[np.ndarray, " rows"]
    columns: Float[np.ndarray, "rows columns"]
    stable: bool


class Marks(NamedTuple):
    """The special points of one kind. values: of the parameter, (count,); columns: of a variable, (count, columns)."""

    values: Float[np.ndarray, " count"]
    columns: Float[np.ndarray, "count columns"]


class Curves(NamedTuple):
    """A branch as arrays ready to plot. pieces: `Piece`s in order, each beginning where the one before ends; points:
    {kind: `Marks`} of the special points, without the ends."""

    pieces: tuple[Piece, ...]
    points: dict[str, Marks]


def curves(branch, variable):
    """The `Curves` of one variable of a branch. Raises ArgumentError for other variables."""
    if not isinstance(variable, str) or variable not in VARIABLES:
        raise check.ArgumentError("variable", f"must be one of {', '.join(VARIABLES)}", variable)
    columns = columns_of(branch, variable)
    values, rows, stable = _lines(branch, variable, columns)
    pieces = tuple(
        Piece(values[first : last + 1], rows[first : last + 1], bool(stable[first])) for first, last in runs(stable)
    )
    kinds = dict.fromkeys(one.kind for one in branch.special if one.kind != "EP")
    found = {kind: branch.points(kind) for kind in kinds}
    points = {
        kind: Marks(np.array([one.value for one in some]), columns[[one.place for one in some]])
        for kind, some in found.items()
    }
    return Curves(pieces, points)


def _lines(branch, variable, columns):
    """(values, columns, stable) of one variable of a branch: shapes (rows,), (rows, columns) and (rows - 1,).

    columns: a drive period each for "x" and "v", one for the others; stable: from a row to the next. A row
    is a point of the branch; where a line breaks three more stand between two points: its end, nan, its new beginning.
    """
    inside = abs(branch.multipliers).max(axis=1) < 1.0 + MARGIN
    stable = inside[:-1] & inside[1:]
    breaks = _changes(branch, columns)
    if variable in ("x", "v"):
        breaks |= _crossings(branch, variable, columns)
    places = np.repeat(np.array(sorted(breaks), int), 3)
    across = [value for place in sorted(breaks) for value in breaks[place][0]]
    rows = [row for place in sorted(breaks) for row in breaks[place][1]]
    return (
        np.insert(branch.values, places + 1, across),
        np.insert(columns, places + 1, np.reshape(rows, (-1, columns.shape[1])), axis=0),
        np.insert(stable, places, stable[places]),
    )


def columns_of(branch, variable):
    """One variable at each point, shape (points, columns); nan where there is none."""
    data = branch.data
    if variable in ("x", "v"):
        return data[variable].values
    if variable == "peak":
        return largest_of(branch)[:, None]
    if variable == "speed":
        return largest_speed(data["side"].values, data["speed"].values)[:, None]
    found = data["least_speed" if variable == "least_speed" else "least_clearance"].values[:, None]
    return np.where(np.isfinite(found), found, np.nan)


def _changes(branch, columns):
    """{place: (values, rows)} where the itinerary changes and a column jumps."""
    part, largest = branch.data["segment"].values, np.nanmax(abs(columns), initial=0.0)
    jumps = (abs(np.diff(columns, axis=0)) > JUMP * largest) & (np.diff(part) != 0)[:, None]
    return {
        int(place): _gap(branch.values, columns, place, jumps[place]) for place in np.flatnonzero(jumps.any(axis=1))
    }


def _gap(values, columns, place, where):
    """The three rows of a break in some of the columns, between a point and the next."""
    gap = np.where(where, np.nan, columns[place])
    return values[[place, place, place + 1]], np.stack([columns[place], gap, columns[place + 1]])


def _crossings(branch, variable, columns):
    """{place: (values, rows)} where an impact crosses phase 0."""
    values, part = branch.values, branch.data["segment"].values
    frequency = values if branch.name == "frequency" else float(branch.scene.frequency)
    late = (branch.data["time"].values.T * frequency).T / (2.0 * np.pi)
    turns = np.floor(late)
    crossed = (np.diff(turns, axis=0) != 0) & np.isfinite(late[:-1]) & (np.diff(part) == 0)[:, None]
    found = {}
    for place in np.flatnonzero(crossed.any(axis=1)):
        (hits,) = np.nonzero(crossed[place])
        before, after = late[place, hits[0]], late[place + 1, hits[0]]
        if len(hits) == 1 and abs(turns[place + 1, hits[0]] - turns[place, hits[0]]) == 1:
            share = (np.round(0.5 * (before + after)) - before) / (after - before)
            found[int(place)] = _crossing(branch, variable, columns, place, hits[0], share, after > before)
        else:
            found[int(place)] = _gap(values, columns, place, True)
    return found


def _crossing(branch, variable, columns, place, hit, share, is_later):
    """The three rows where one impact crosses phase 0, a share of the way to the next point.

    There the mass is on the wall, and the velocity after the impact becomes that before it where the impact grows later
    than phase 0; a state at phase 0 is the one after an impact at phase 0.
    """

    def between(rows):
        return (1.0 - share) * rows[place] + share * rows[place + 1]

    value, row = between(branch.values), between(columns)
    scene = branch.scene.replace(**{branch.name: value})
    side, speed = int(branch.data["side"].values[place, hit]), between(branch.data["speed"].values[:, hit])
    name = SIDES[int(side > 0)]
    where, pace = (float(each) for each in places(scene, 0.0)[int(side > 0)])
    ends = (pace - float(scene.bounce(name)) * side * speed, pace + side * speed)
    if variable == "x":
        ends = 2 * (where,)
    period = branch.data.sizes["period"]
    late = between(branch.data["time"].values[:, hit]) * float(scene.frequency) / (2.0 * np.pi)
    rows = np.stack([row, row, row])
    rows[:, round(late) % period] = (ends[0], np.nan, ends[1])[:: 1 if is_later else -1]
    return np.full(3, value), rows
