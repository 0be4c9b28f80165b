"""The lines of Python that a click, a slider or a choice from the menu means."""

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

MOTION_PERIODS = 64  # periods of a motion that is no orbit
FIRST_GRID_SIZE = 16  # cells of a side of a grid that is drawn first
MAX_BOUND = 1e100  # bound of axes and parameters: squares and sums of such numbers are still finite
MARGIN_UNIT = 0.1  # of a number: the unit of a margin's distances
RESULT_STEMS = {
    "find_orbit": "orbit",
    "special": "orbit",
    "switch": "branches",
    "explore": "diagram",
    "follow": "branch",
}

AllocateName = Callable[[str], str]


def name_stem(call: str) -> str:
    """What results of a call are called."""
    return RESULT_STEMS.get(call, call)


def scene_changes(page: PageState) -> dict[str, float]:
    """What of the scene is other than in the file."""
    return next((dict(line.arguments["changes"]) for line in page.lines if line.name == page.scene), {})


def change_scene(
    page: PageState, results: Mapping[str, Any], changes: Mapping[str, float], name: str
) -> tuple[Scene, ViewTable]:
    """(the scene with other numbers, the line that makes it). Raises SceneError for numbers that cannot be."""
    file_scene = results[SCENE_NAME]
    for parameter in changes:
        if parameter not in file_scene.names:
            raise ArgumentError("name", "must be that of a parameter of the scene", parameter)
    total_changes = {**scene_changes(page), **{parameter: float(value) for parameter, value in changes.items()}}
    return file_scene.replace(**total_changes), ViewTable(
        name=name, call="replace", of=SCENE_NAME, arguments={"changes": total_changes}
    )


def orbit_line(reference: str, point_index: int | None, value: Any, name: str) -> ViewTable:
    """The line of the orbit at a special point, or at a branch's point. Raises ArgumentError for other things."""
    if isinstance(value, Special):
        return ViewTable(name=name, call="special", of=reference)
    if isinstance(value, Branch):
        return ViewTable(name=name, call="orbit", of=reference, arguments={"place": int(point_index or 0)})
    raise ArgumentError("choose", "must be a special point, a branch or an orbit", reference)


def action_lines(
    message: RunAction, page: PageState, results: Mapping[str, Any], allocate_name: AllocateName
) -> Iterator[list[ViewTable]]:
    """The lines that a choice from the menu means, in rounds: each replaces the one before, and is finer.

    Raises ArgumentError for a choice that what is chosen does not allow.
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
            raise ArgumentError(message.call, "must be asked of a special point: choose one first", page.chosen)
        yield [
            make_line(page.chosen)
            if message.call == "switch"
            else make_line(page.chosen, bounds=_extend_bounds(page.plane_bounds, selection.scene))
        ]
    elif message.call in ("follow", "margin"):
        orbit = results.get(page.current)
        if not isinstance(orbit, Orbit):
            raise ArgumentError(message.call, "must be asked of an orbit: this motion is none", page.current)
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
    """Refuses to follow a point of a branch along the parameter that it is along already."""
    selection = resolve(page.chosen, results) if page.chosen else None
    if isinstance(selection, Branch) and selection.name == page.parameter and selection.bounds == page.bounds:
        raise ArgumentError("follow", "must be asked of an orbit that is on no branch yet", page.chosen)


def _grid_rounds(message, page, scene, make_line):
    """Rounds of a grid, each with twice as many cells a side."""
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
    """Bounds that hold a scene's numbers, a list each, as a scene file has them."""
    values = {name: float(scene.parameter(name)) for name in bounds}
    return {name: [min(lower, values[name]), max(upper, values[name])] for name, (lower, upper) in bounds.items()}


def _distance_unit(scene, name):
    """A unit for distances along a parameter: a part of its number, or of its slider where that is 0."""
    lower, upper = slider_range(scene, name)
    return MARGIN_UNIT * (abs(float(scene.parameter(name))) or upper - lower)


def require_increasing(key: str, bounds: Sequence[float] | None) -> None:
    """Raises ArgumentError for bounds that do not go from a smaller number to a larger one, or are too far apart to be
    drawn; there may be none."""
    if bounds is not None and not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise ArgumentError(key, "must go from a smaller number to a larger one", bounds)
    if bounds is not None and not max(map(abs, bounds)) <= MAX_BOUND:
        raise ArgumentError(key, f"must lie within -{MAX_BOUND:g} and {MAX_BOUND:g}", bounds)


def ancestor_lines(line: ViewTable, lines: Mapping[str, ViewTable]) -> list[ViewTable]:
    """The lines that a line refers to, directly or not, in order."""
    ancestors: list[ViewTable] = []
    parent = parent_name(line)
    while parent in lines:
        ancestors.insert(0, lines[parent])
        parent = parent_name(lines[parent])
    return ancestors


def last_state(motion: Orbit | xr.Dataset | None) -> State:
    """A state of what is shown, free of contact; rest before there is any."""
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
    """What there is now, with lines that were asked when there was something else; superseded: lines in whose place
    they are. What they refer to, and is no more there, is there again."""
    present_names, earlier_lines = {line.name for line in page.lines}, {line.name: line for line in page_before.lines}
    missing_lines = {
        ancestor.name: ancestor
        for line in lines
        for ancestor in ancestor_lines(line, earlier_lines)
        if ancestor.name not in present_names
    }
    remaining = [line for line in page.lines if line not in superseded]
    return replace(page, lines=(*missing_lines.values(), *remaining, *lines))
