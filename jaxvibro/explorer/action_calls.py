"""Translate clicks, slider motions and menu entries of a page into lines: `ViewTable` records of calls."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ..branches.branch import Branch, Special
from ..maps.initial_conditions import initial_box
from ..orbits.orbit import Orbit, OrbitError
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies.schema import ViewTable
from .messages import MoveOnBranch, RunAction
from .page_calls import SCENE_NAME, evaluate_call_line, parent_line_name, resolve_reference
from .page_state import PageState, diagram_branches, scene_of, slider_range

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


def result_name_stem(call_name: str) -> str:
    """Return the stem of the names that the results of a call get, for example "orbit" for orbit_1."""
    return RESULT_STEMS.get(call_name, call_name)


def changes_from_file_scene(page: PageState) -> dict[str, float]:
    """Return {name: value} of the parameters in which the current scene differs from the scene of the file."""
    return next((dict(call_line.arguments["changes"]) for call_line in page.lines if call_line.name == page.scene), {})


def changed_scene_and_line(
    page: PageState, results: Mapping[str, Any], changes: Mapping[str, float], scene_name: str
) -> tuple[Scene, ViewTable]:
    """Return (scene with changed parameters, line that makes this scene).

    Raises ArgumentError for an unknown parameter and SceneError for an inadmissible value.
    """
    file_scene = results[SCENE_NAME]
    for parameter in changes:
        if parameter not in file_scene.names:
            raise ArgumentError("name", "must be a parameter of the scene", parameter)
    total_changes = {
        **changes_from_file_scene(page),
        **{parameter: float(value) for parameter, value in changes.items()},
    }
    return file_scene.replace(**total_changes), ViewTable(
        name=scene_name, call="replace", of=SCENE_NAME, arguments={"changes": total_changes}
    )


def orbit_call_line(selection_reference: str, point_index: int | None, selection: Any, orbit_name: str) -> ViewTable:
    """Return the line of the orbit at a special point or at a point of a branch.

    `selection` is the object that `selection_reference` denotes. Raises ArgumentError unless it is a `Special` or a
    `Branch`."""
    if isinstance(selection, Special):
        return ViewTable(name=orbit_name, call="special", of=selection_reference)
    if isinstance(selection, Branch):
        return ViewTable(
            name=orbit_name, call="orbit", of=selection_reference, arguments={"place": int(point_index or 0)}
        )
    raise ArgumentError("choose", "must be a special point, a branch or an orbit", selection_reference)


def moved_selection(message: MoveOnBranch, page: PageState, results: Mapping[str, Any]) -> tuple[str, int]:
    """Return (reference, row) of the point of a branch that is selected after a move from the selected point.

    Raises ArgumentError if the diagram has no branch.
    """
    branches = dict(diagram_branches(page, results))
    if not branches:
        raise ArgumentError("move", "requires a branch in the diagram. Follow an orbit first", message.by)
    references, reference, row = list(branches), page.chosen.partition(".special")[0], page.place
    if reference not in branches:
        reference, row = references[0], 0
    elif row is None:
        row = resolve_reference(page.chosen, results).place
    if message.branch:
        reference, row = references[(references.index(reference) + message.branch) % len(references)], 0
    return reference, max(0, min(len(branches[reference]) - 1, row + message.by))


def settle_motion(
    scene_name: str, state: State, result_names: Sequence[str], periods: int | None, results: dict[str, Any]
) -> ViewTable:
    """Return the line of the orbit that a state approaches, or of the motion without an orbit; add it to `results`.

    `result_names` are the names of a scene, an orbit and a motion. `periods` is the number of drive periods of a motion
    while a slider moves, else None.
    """
    x, v, phase = (float(np.asarray(coordinate)) for coordinate in (state.x, state.v, state.phase))
    arguments: dict[str, Any] = {"x": x, "v": v} | ({"phase": phase} if phase else {})
    call_name = "moved" if periods else "find_orbit"
    motion_line = ViewTable(name=result_names[1], call=call_name, of=scene_name, arguments=arguments)
    try:
        results[motion_line.name] = evaluate_call_line(motion_line, results)
    except OrbitError:
        arguments = arguments | {"periods": periods or MOTION_PERIODS}
        motion_line = ViewTable(name=result_names[2], call="motion", of=scene_name, arguments=arguments)
        results[motion_line.name] = evaluate_call_line(motion_line, results)
    return motion_line


def action_call_lines(
    message: RunAction, page: PageState, results: Mapping[str, Any], allocate_name: AllocateName
) -> Iterator[list[ViewTable]]:
    """Yield the lines of an action in rounds; the results of a round replace those of the previous round.

    Raises ArgumentError if the selection does not permit the action.
    """
    receiver_reference, receiver = _action_receiver(message.call, page, results)
    if message.call == "follow":
        _require_new_branch(page, results)
    for argument_sets in _argument_rounds(message, page, scene_of(receiver)):
        yield [
            ViewTable(
                name=allocate_name(result_name_stem(message.call)),
                call=message.call,
                of=receiver_reference,
                arguments=arguments,
            )
            for arguments in argument_sets
        ]


def _action_receiver(call_name, page, results):
    """Return (reference, value) of the object of an action: the selected point, the current orbit, or the scene."""
    if call_name in ("switch", "locus"):
        selection = resolve_reference(page.chosen, results) if page.chosen else None
        if not isinstance(selection, Special):
            raise ArgumentError(call_name, "requires a special point. Select one first", page.chosen)
        return page.chosen, selection
    if call_name in ("follow", "margin"):
        orbit = results.get(page.current)
        if not isinstance(orbit, Orbit):
            raise ArgumentError(
                call_name, "requires a periodic orbit; the current motion is not periodic", page.current
            )
        return page.current, orbit
    return page.scene, results[page.scene]


def _argument_rounds(message, page, scene):
    """Return the arguments of the calls of an action in rounds, each a list of {name: value}."""
    lower, upper = page.bounds
    match message.call:
        case "follow":
            extended_bounds = _extend_bounds_to_scene({page.parameter: page.bounds}, scene)
            low, high = extended_bounds[page.parameter]
            return [[{"parameter": page.parameter, "low": low, "high": high}]]
        case "explore":
            max_period = message.max_period
            return [[{"parameter": page.parameter, "low": lower, "high": upper, "max_period": max_period}]]
        case "locus":
            return [[{"bounds": _extend_bounds_to_scene(page.plane_bounds, scene)}]]
        case "margin":
            return [[{"free": {name: _margin_distance_unit(scene, name) for name in page.plane_bounds}}]]
        case "sweep":
            range_arguments = [{"first": upper, "last": lower}, {"first": lower, "last": upper}]
            start_arguments = {"count": message.count, "x": 0.0, "v": 0.0}
            return [[{"parameter": page.parameter, **ends, **start_arguments} for ends in range_arguments]]
        case "map":
            plane_bounds = {page.second: list(page.second_bounds), page.parameter: list(page.bounds)}
            return [[{"bounds": plane_bounds, "count": grid_size}] for grid_size in _grid_sizes(message.count)]
        case "basins":
            x_lower, x_upper, max_speed = map(float, initial_box(scene))
            ranges = {"x": [x_lower, x_upper], "v": [-max_speed, max_speed]}
            return [[{**ranges, "count": grid_size}] for grid_size in _grid_sizes(message.count)]
        case _:
            return [[{}]]


def _require_new_branch(page, results):
    """Raise ArgumentError if the selection is a branch along the parameter and within the bounds of the diagram."""
    selection = resolve_reference(page.chosen, results) if page.chosen else None
    if isinstance(selection, Branch) and selection.name == page.parameter and selection.bounds == page.bounds:
        raise ArgumentError("follow", "requires an orbit that is not on a branch along this parameter", page.chosen)


def _grid_sizes(final_size):
    """Yield the numbers of cells per side of a grid, each up to twice the previous one."""
    grid_size = FIRST_GRID_SIZE
    while grid_size < final_size:
        yield grid_size
        grid_size *= 2
    yield final_size


def _extend_bounds_to_scene(bounds, scene):
    """Return bounds, extended to contain the parameter values of a scene, as lists as in scene files."""
    scene_values = {name: float(scene.parameter(name)) for name in bounds}
    return {
        name: [min(lower, scene_values[name]), max(upper, scene_values[name])]
        for name, (lower, upper) in bounds.items()
    }


def _margin_distance_unit(scene, parameter):
    """Return the unit of distances along a parameter: a fraction of its value, or of its slider range for value 0."""
    lower, upper = slider_range(scene, parameter)
    return MARGIN_UNIT * (abs(float(scene.parameter(parameter))) or upper - lower)


def require_valid_bounds(argument_name: str, bounds: Sequence[float] | None) -> None:
    """Raise ArgumentError unless bounds are None, or finite, increasing and small enough to be drawn."""
    if bounds is not None and not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise ArgumentError(argument_name, "must be finite and increasing", bounds)
    if bounds is not None and not max(map(abs, bounds)) <= MAX_BOUND:
        raise ArgumentError(argument_name, f"must lie between -{MAX_BOUND:g} and {MAX_BOUND:g}", bounds)


def ancestor_call_lines(call_line: ViewTable, call_lines: Mapping[str, ViewTable]) -> list[ViewTable]:
    """Return the lines to which a line refers, directly or indirectly, in the order of their calls."""
    ancestors: list[ViewTable] = []
    parent_name = parent_line_name(call_line)
    while parent_name in call_lines:
        ancestors.insert(0, call_lines[parent_name])
        parent_name = parent_line_name(call_lines[parent_name])
    return ancestors


def current_motion_state(motion: Orbit | xr.Dataset | None) -> State:
    """Return position, velocity and phase of the current motion as a `State` that is not in contact with a wall.

    The result is the state of a periodic orbit, or the last state of another motion. If there is no motion, the result
    is x = 0, v = 0.
    """
    if motion is None:
        return State(0.0, 0.0)
    if isinstance(motion, Orbit):
        return State(
            *(float(np.asarray(coordinate)) for coordinate in (motion.state.x, motion.state.v, motion.state.phase))
        )
    return State(float(motion["x"][-1]), float(motion["v"][-1]), float(motion["phase"][-1]) % (2.0 * np.pi))


def add_call_lines(
    page: PageState, new_lines: Sequence[ViewTable], lines_to_replace: Sequence[ViewTable], page_at_start: PageState
) -> PageState:
    """Add lines to a page that may have changed since the lines were requested.

    `lines_to_replace` are the lines that the new lines replace. Lines to which the new lines refer, and which the page
    no longer has, are restored from `page_at_start`."""
    page_line_names, lines_at_start = (
        {call_line.name for call_line in page.lines},
        {call_line.name: call_line for call_line in page_at_start.lines},
    )
    missing_ancestors = {
        ancestor_line.name: ancestor_line
        for call_line in new_lines
        for ancestor_line in ancestor_call_lines(call_line, lines_at_start)
        if ancestor_line.name not in page_line_names
    }
    remaining_lines = [call_line for call_line in page.lines if call_line not in lines_to_replace]
    return replace(page, lines=(*missing_ancestors.values(), *remaining_lines, *new_lines))
