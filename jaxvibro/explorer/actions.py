"""Translate clicks, sliders and menu entries into lines of calls."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ..branches.branch import Branch, Special
from ..maps.initial_conditions import initial_box
from ..orbits.orbit import Orbit
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies.schema import ViewTable
from .calls import SCENE_NAME, parent_name, resolve
from .messages import RunAction
from .page_state import PageState, slider_range

MOTION_PERIODS = 64  # drive periods of a motion that is not periodic
FIRST_GRID_SIZE = 16  # cells per side of the first grid
MAX_BOUND = 1e100  # bound of axes and parameters, whose squares and sums remain finite
MARGIN_UNIT = 0.1  # unit of distances in a margin, relative to the value
RESULT_STEMS = {
    "find_orbit": "orbit",
    "special": "orbit",
    "switch": "branches",
    "explore": "diagram",
    "follow": "branch",
}

AllocateName = Callable[[str], str]


def name_stem(call: str) -> str:
    """Return the stem of the names of results of a call."""
    return RESULT_STEMS.get(call, call)


def scene_changes(page: PageState) -> dict[str, float]:
    """Return the parameters that differ from the scene of the file, {name: value}."""
    return next((dict(line.arguments["changes"]) for line in page.lines if line.name == page.scene), {})


def change_scene(
    page: PageState, results: Mapping[str, Any], changes: Mapping[str, float], name: str
) -> tuple[Scene, ViewTable]:
    """Return (scene with changed parameters, line that makes it). Raises SceneError for inadmissible values."""
    file_scene = results[SCENE_NAME]
    for parameter in changes:
        if parameter not in file_scene.names:
            raise ArgumentError("name", "must be a parameter of the scene", parameter)
    total_changes = {**scene_changes(page), **{parameter: float(value) for parameter, value in changes.items()}}
    return file_scene.replace(**total_changes), ViewTable(
        name=name, call="replace", of=SCENE_NAME, arguments={"changes": total_changes}
    )


def orbit_line(reference: str, point_index: int | None, value: Any, name: str) -> ViewTable:
    """Return the line of the orbit at a special point or at a point of a branch.

    Raises ArgumentError for other values.
    """
    if isinstance(value, Special):
        return ViewTable(name=name, call="special", of=reference)
    if isinstance(value, Branch):
        return ViewTable(name=name, call="orbit", of=reference, arguments={"place": int(point_index or 0)})
    raise ArgumentError("choose", "must be a special point, a branch or an orbit", reference)


def action_lines(
    message: RunAction, page: PageState, results: Mapping[str, Any], allocate_name: AllocateName
) -> Iterator[list[ViewTable]]:
    """Yield rounds of lines of an action; each round replaces the previous one at a finer resolution.

    Raises ArgumentError if the selection does not permit the action.
    """
    scene, (lower, upper) = results[page.scene], page.bounds
    range_arguments = {"parameter": page.parameter, "low": lower, "high": upper}

    def make_line(receiver, **arguments):
        return ViewTable(
            name=allocate_name(name_stem(message.call)), call=message.call, of=receiver, arguments=arguments
        )

    if message.call in ("switch", "locus"):
        selection = resolve(page.chosen, results) if page.chosen else None
        if not isinstance(selection, Special):
            raise ArgumentError(message.call, "requires a special point. Select one first", page.chosen)
        yield [
            make_line(page.chosen)
            if message.call == "switch"
            else make_line(page.chosen, bounds=_extend_bounds(page.plane_bounds, selection.scene))
        ]
    elif message.call in ("follow", "margin"):
        orbit = results.get(page.current)
        if not isinstance(orbit, Orbit):
            raise ArgumentError(
                message.call, "requires a periodic orbit; the current motion is not periodic", page.current
            )
        if message.call == "follow":
            _require_new_branch(page, results)
            lower, upper = _extend_bounds({page.parameter: page.bounds}, orbit.scene)[page.parameter]
            yield [make_line(page.current, **range_arguments | {"low": lower, "high": upper})]
        else:
            yield [
                make_line(
                    page.current,
                    free={
                        parameter: _distance_unit(orbit.scene, parameter) for parameter in (page.parameter, page.second)
                    },
                )
            ]
    elif message.call == "explore":
        yield [make_line(page.scene, **range_arguments, max_period=message.max_period)]
    elif message.call == "sweep":
        start = {"x": 0.0, "v": 0.0}
        ranges = ((upper, lower), (lower, upper))
        yield [
            make_line(page.scene, parameter=page.parameter, first=first, last=last, count=message.count, **start)
            for first, last in ranges
        ]
    elif message.call == "attractors":
        yield [make_line(page.scene)]
    else:
        yield from _grid_rounds(message, page, scene, make_line)


def _require_new_branch(page, results):
    """Raise ArgumentError for a point of a branch that is already followed along this parameter."""
    selection = resolve(page.chosen, results) if page.chosen else None
    if isinstance(selection, Branch) and selection.name == page.parameter and selection.bounds == page.bounds:
        raise ArgumentError("follow", "requires an orbit that is not on a branch along this parameter", page.chosen)


def _grid_rounds(message, page, scene, make_line):
    """Yield rounds of a grid, each with twice as many cells per side."""
    count = min(FIRST_GRID_SIZE, message.count)
    while True:
        if message.call == "map":
            bounds = {page.second: list(page.second_bounds), page.parameter: list(page.bounds)}
            yield [make_line(page.scene, bounds=bounds, count=count)]
        else:
            x_lower, x_upper, max_speed = (float(limit) for limit in initial_box(scene))
            yield [make_line(page.scene, x=[x_lower, x_upper], v=[-max_speed, max_speed], count=count)]
        if count >= message.count:
            return
        count = min(2 * count, message.count)


def _extend_bounds(bounds, scene):
    """Return bounds that contain the values of a scene, as lists, the form of scene files."""
    values = {name: float(scene.parameter(name)) for name in bounds}
    return {name: [min(lower, values[name]), max(upper, values[name])] for name, (lower, upper) in bounds.items()}


def _distance_unit(scene, name):
    """Return a unit of distances along a parameter: a fraction of its value, or of its slider range if that is 0."""
    lower, upper = slider_range(scene, name)
    return MARGIN_UNIT * (abs(float(scene.parameter(name))) or upper - lower)


def require_increasing(key: str, bounds: Sequence[float] | None) -> None:
    """Require finite, increasing bounds of a size that can be drawn, or None. Raises ArgumentError otherwise."""
    if bounds is not None and not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise ArgumentError(key, "must be finite and increasing", bounds)
    if bounds is not None and not max(map(abs, bounds)) <= MAX_BOUND:
        raise ArgumentError(key, f"must lie between -{MAX_BOUND:g} and {MAX_BOUND:g}", bounds)


def ancestor_lines(line: ViewTable, lines: Mapping[str, ViewTable]) -> list[ViewTable]:
    """Return the lines to which a line refers, directly or indirectly, in order."""
    ancestors: list[ViewTable] = []
    parent = parent_name(line)
    while parent in lines:
        ancestors.insert(0, lines[parent])
        parent = parent_name(lines[parent])
    return ancestors


def last_state(motion: Orbit | xr.Dataset | None) -> State:
    """Return a state of the current motion, free of contact; the state at rest before there is any motion."""
    if motion is None:
        return State(0.0, 0.0)
    if isinstance(motion, Orbit):
        return State(
            *(float(np.asarray(coordinate)) for coordinate in (motion.state.x, motion.state.v, motion.state.phase))
        )
    return State(float(motion["x"][-1]), float(motion["v"][-1]), float(motion["phase"][-1]) % (2.0 * np.pi))


def add_lines(
    page: PageState, lines: Sequence[ViewTable], superseded: Sequence[ViewTable], page_before: PageState
) -> PageState:
    """Add lines to a page that may have changed since they were requested.

    `superseded` are lines that the new ones replace. Lines to which the new ones refer, and which the page has dropped,
    are restored from `page_before`.
    """
    present_names, earlier_lines = {line.name for line in page.lines}, {line.name: line for line in page_before.lines}
    missing_lines = {
        ancestor.name: ancestor
        for line in lines
        for ancestor in ancestor_lines(line, earlier_lines)
        if ancestor.name not in present_names
    }
    remaining = [line for line in page.lines if line not in superseded]
    return replace(page, lines=(*missing_lines.values(), *remaining, *lines))
