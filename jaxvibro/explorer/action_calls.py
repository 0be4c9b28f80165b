"""Translate clicks, slider motions and menu entries of a page into lines: `ViewTable` records of calls."""

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
from .messages import RunAction
from .page_calls import SCENE_NAME, parent_line_name, resolve_reference
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


def action_call_lines(
    message: RunAction, page: PageState, results: Mapping[str, Any], allocate_name: AllocateName
) -> Iterator[list[ViewTable]]:
    """Yield the lines of an action in rounds; the results of a round replace those of the previous round.

    Raises ArgumentError if the selection does not permit the action.
    """
    scene, (parameter_lower, parameter_upper) = results[page.scene], page.bounds
    range_arguments = {"parameter": page.parameter, "low": parameter_lower, "high": parameter_upper}

    def make_call_line(receiver_reference, **arguments):
        return ViewTable(
            name=allocate_name(result_name_stem(message.call)),
            call=message.call,
            of=receiver_reference,
            arguments=arguments,
        )

    if message.call in ("switch", "locus"):
        selection = resolve_reference(page.chosen, results) if page.chosen else None
        if not isinstance(selection, Special):
            raise ArgumentError(message.call, "requires a special point. Select one first", page.chosen)
        yield [
            make_call_line(page.chosen)
            if message.call == "switch"
            else make_call_line(page.chosen, bounds=_extend_bounds_to_scene(page.plane_bounds, selection.scene))
        ]
    elif message.call in ("follow", "margin"):
        orbit = results.get(page.current)
        if not isinstance(orbit, Orbit):
            raise ArgumentError(
                message.call, "requires a periodic orbit; the current motion is not periodic", page.current
            )
        if message.call == "follow":
            _require_new_branch(page, results)
            parameter_lower, parameter_upper = _extend_bounds_to_scene({page.parameter: page.bounds}, orbit.scene)[
                page.parameter
            ]
            yield [make_call_line(page.current, **range_arguments | {"low": parameter_lower, "high": parameter_upper})]
        else:
            yield [
                make_call_line(
                    page.current,
                    free={
                        parameter: _margin_distance_unit(orbit.scene, parameter)
                        for parameter in (page.parameter, page.second)
                    },
                )
            ]
    elif message.call == "explore":
        yield [make_call_line(page.scene, **range_arguments, max_period=message.max_period)]
    elif message.call == "sweep":
        zero_state_arguments = {"x": 0.0, "v": 0.0}
        sweep_ranges = ((parameter_upper, parameter_lower), (parameter_lower, parameter_upper))
        yield [
            make_call_line(
                page.scene,
                parameter=page.parameter,
                first=first_value,
                last=last_value,
                count=message.count,
                **zero_state_arguments,
            )
            for first_value, last_value in sweep_ranges
        ]
    elif message.call == "attractors":
        yield [make_call_line(page.scene)]
    else:
        yield from _grid_refinement_rounds(message, page, scene, make_call_line)


def _require_new_branch(page, results):
    """Raise ArgumentError if the selection is a branch along the parameter and within the bounds of the diagram."""
    selection = resolve_reference(page.chosen, results) if page.chosen else None
    if isinstance(selection, Branch) and selection.name == page.parameter and selection.bounds == page.bounds:
        raise ArgumentError("follow", "requires an orbit that is not on a branch along this parameter", page.chosen)


def _grid_refinement_rounds(message, page, scene, make_call_line):
    """Yield the lines of a grid in rounds, each with up to twice as many cells per side as the previous round."""
    cells_per_side = min(FIRST_GRID_SIZE, message.count)
    while True:
        if message.call == "map":
            plane_bounds = {page.second: list(page.second_bounds), page.parameter: list(page.bounds)}
            yield [make_call_line(page.scene, bounds=plane_bounds, count=cells_per_side)]
        else:
            x_lower, x_upper, max_speed = (float(initial_box_limit) for initial_box_limit in initial_box(scene))
            yield [make_call_line(page.scene, x=[x_lower, x_upper], v=[-max_speed, max_speed], count=cells_per_side)]
        if cells_per_side >= message.count:
            return
        cells_per_side = min(2 * cells_per_side, message.count)


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
