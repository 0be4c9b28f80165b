"""Represent the content of a page as a frozen record, and find the point that is nearest to a click."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from ..branches.branch import Branch
from ..branches.branch_curves import variable_columns
from ..branches.diagram import Diagram
from ..design.margin_result import Margin
from ..loci.locus import Locus
from ..scene.scene import Scene
from ..scene.scene_parameters import parameter_domain
from ..studies.schema import SceneFile, ViewTable
from .page_calls import SCENE_NAME, prune_call_lines

RELATIVE_ROUNDING = 1e-12  # relative difference of values that are equal up to rounding
SLIDER_FACTOR = 2.0  # upper end of a slider, relative to the value


@dataclass(frozen=True)
class PageState:
    """Content of a page.

    Attributes
    ----------
    parameter : str
        Parameter of the diagram, on the x axis.
    bounds : tuple of float
        Bounds of `parameter`.
    second : str
        Second parameter of the plane, on its y axis.
    second_bounds : tuple of float
        Bounds of `second`.
    lines : tuple of ViewTable
        Actions of the user as calls of the Python interface, in chronological order.
    scene : str
        Name of the current scene.
    current : str
        Name of the current orbit or motion; "" if there is none.
    chosen : str
        Python expression of the selected branch or special point, for example ``"branch.special[1]"``.
    place : int or None
        Index of the selected point on its branch, else None.
    variable : str
        Variable of the diagram, on the y axis.
    """

    parameter: str
    bounds: tuple[float, float]
    second: str
    second_bounds: tuple[float, float]
    lines: tuple[ViewTable, ...] = ()
    scene: str = SCENE_NAME
    current: str = ""
    chosen: str = ""
    place: int | None = None
    variable: str = "x"

    def with_call_lines(self, *lines: ViewTable, **changes: Any) -> "PageState":
        """Return the page with further lines and changed fields; lines of unused scenes and motions are removed."""
        page = replace(self, **changes)
        names_in_use = (page.scene, page.current, page.chosen.split(".")[0].split("[")[0])
        return replace(page, lines=prune_call_lines((*self.lines, *lines), names_in_use))

    @property
    def plane_bounds(self) -> dict[str, tuple[float, float]]:
        """Bounds of the two parameters of the plane."""
        return {self.parameter: self.bounds, self.second: self.second_bounds}


def initial_page(scene: Scene, scene_file: SceneFile | None) -> PageState:
    """Return the initial content of a page.

    The parameters and bounds of the diagram and the plane are those in the file. Where the file defines none, the
    parameters are the amplitude and the frequency of the drive, and the bounds are the ranges of their sliders.
    """
    parameter_names = [parameter for parameter in scene.names if parameter != "hardness"]
    parameter, bounds = (scene_file and _diagram_axis_of_file(scene_file)) or (
        "amplitude",
        slider_range(scene, "amplitude"),
    )
    plane_table = scene_file and (scene_file.locus or scene_file.map)
    other_plane_parameters = [
        candidate_name
        for candidate_name in (plane_table.parameters if plane_table else ())
        if candidate_name != parameter
    ]
    second_parameter = next(
        iter(other_plane_parameters),
        next(
            candidate_name
            for candidate_name in ("frequency", "amplitude", *parameter_names)
            if candidate_name != parameter
        ),
    )
    second_bounds = (
        plane_table.bounds[second_parameter]
        if plane_table and second_parameter in plane_table.bounds
        else slider_range(scene, second_parameter)
    )
    return PageState(parameter, bounds, second_parameter, second_bounds)


def _diagram_axis_of_file(scene_file):
    """Return (parameter, bounds) of the diagram that a scene file defines; None if it defines no diagram."""
    if scene_file.branch_table is not None:
        return scene_file.branch_table.parameter, scene_file.branch_table.bounds
    if scene_file.sweep is not None:
        sweep_ends = [
            sweep_end for sweep_leg in scene_file.sweep.legs for sweep_end in (sweep_leg.first, sweep_leg.last)
        ]
        return scene_file.sweep.parameter, (min(sweep_ends), max(sweep_ends))
    if scene_file.spectrum is not None and scene_file.spectrum.first != scene_file.spectrum.last:
        return scene_file.spectrum.parameter, tuple(sorted((scene_file.spectrum.first, scene_file.spectrum.last)))
    return None


def slider_range(scene: Scene, parameter: str) -> tuple[float, float]:
    """Return the range of the slider of a parameter: around its value, inside its domain."""
    value = float(scene.parameter(parameter))
    domain_lower, domain_upper = parameter_domain(scene, parameter)
    if parameter.endswith("restitution"):
        return 0.0, 1.0
    if parameter.endswith("phase"):
        return min(0.0, value), max(2.0 * np.pi, value)
    if parameter.endswith(("frequency", "stiffness")):
        return value / SLIDER_FACTOR, value * SLIDER_FACTOR
    if parameter == "hardness":
        return value - 1.0, value + 1.0
    half_range = max(abs(value), 0.5)
    range_from_zero = (
        (min(0.0, value), max(SLIDER_FACTOR * value, 0.5)) if parameter in ("amplitude", "damping") else None
    )
    range_start, range_stop = range_from_zero or (value - half_range, value + half_range)
    domain_inset = 0.01 * half_range  # walls must not meet
    return max(range_start, domain_lower + domain_inset if domain_lower > range_start else range_start), min(
        range_stop, domain_upper - domain_inset if domain_upper < range_stop else range_stop
    )


def is_same_scene(scene: Scene, other_scene: Scene, *except_names: str) -> bool:
    """Return True if two scenes agree in all parameters except those in `except_names`, up to rounding.

    If `except_names` is not empty, the hardness may also differ.
    """
    if scene.names != other_scene.names:
        return False
    names = [name for name in scene.names if name not in except_names and not (name == "hardness" and except_names)]
    return all(
        abs(float(scene.parameter(name)) - float(other_scene.parameter(name)))
        <= RELATIVE_ROUNDING * (1 + abs(float(scene.parameter(name))))
        for name in names
    )


def diagram_branches(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Branch]]:
    """Yield (reference, `Branch`) of the branches of the diagram.

    The branches vary the parameter of the diagram and agree with the current scene in all other parameters.
    """
    for reference, branch in _curves_on_scene(page, results, Branch, page.parameter):
        if branch.name == page.parameter:
            yield reference, branch


def plane_loci(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Locus]]:
    """Yield (reference, `Locus`) of the loci in the two parameters of the plane.

    The scenes of the loci agree with the current scene in all other parameters.
    """
    names = (page.parameter, page.second)
    for reference, locus in _curves_on_scene(page, results, Locus, *names):
        if locus.names == names:
            yield reference, locus


def _curves_on_scene(page, results, curve_type, *except_names):
    """Yield (reference, curve) of curves whose scenes agree with the current scene except in named parameters."""
    for call_line in page.lines:
        for reference, curve in result_members(call_line.name, results[call_line.name]):
            if isinstance(curve, curve_type) and is_same_scene(curve.scene, results[page.scene], *except_names):
                yield reference, curve


def result_members(result_name: str, result: Any) -> Iterator[tuple[str, Any]]:
    """Yield (reference, value) of the members of a tuple, or of the branches of a diagram and of the result itself."""
    if isinstance(result, tuple):
        yield from ((f"{result_name}[{index}]", member) for index, member in enumerate(result))
        return
    if isinstance(result, Diagram):
        yield from result_members(f"{result_name}.branches", result.branches)
    yield result_name, result


def latest_result(page: PageState, results: Mapping[str, Any], call_name: str, *except_names: str) -> Any:
    """Return the last result of a named call on the current scene; None if there is no result.

    The scene of the call may differ from the current scene in the parameters `except_names`.
    """
    return next((result for _, result in reversed(_results_of_call(page, results, call_name, *except_names))), None)


def diagram_sweeps(page: PageState, results: Mapping[str, Any]) -> list[xr.Dataset]:
    """Return the sweeps in the parameter of the diagram whose scenes otherwise agree with the current scene."""
    sweep_results = _results_of_call(page, results, "sweep", page.parameter)
    return [result for arguments, result in sweep_results if arguments["parameter"] == page.parameter]


def _results_of_call(page, results, call_name, *except_names):
    """Return [(arguments, result)] of the lines of a call on a scene that agrees with the current scene."""
    scene = results[page.scene]
    call_lines = [call_line for call_line in page.lines if call_line.call == call_name]
    return [
        (call_line.arguments, results[call_line.name])
        for call_line in call_lines
        if is_same_scene(scene_of(results[call_line.of]), scene, *except_names)
    ]


def scene_of(receiver: Any) -> Scene:
    """Return the scene of the object of a call, which may be the scene itself."""
    return receiver if isinstance(receiver, Scene) else receiver.scene


def plane_map(page: PageState, results: Mapping[str, Any]) -> xr.Dataset | None:
    """Return the last map whose scene agrees with the current scene in all parameters except those of the plane.

    Returns None if there is no such map, or if its axes are not the second parameter (y) and the parameter of the
    diagram (x).
    """
    names = (page.second, page.parameter)
    map_data = latest_result(page, results, "map", *names)
    return map_data if map_data is not None and tuple(map_data["label"].dims) == names else None


def plane_margin(page: PageState, results: Mapping[str, Any]) -> Margin | None:
    """Return the last margin on the current scene if its free parameters are those of the plane, otherwise None."""
    margin = latest_result(page, results, "margin")
    return margin if margin is not None and tuple(margin.free) == (page.parameter, page.second) else None


SPECIAL_RADIUS = 0.02  # relative to the panel: a special point within this distance is selected
MAX_DISTANCE = 0.08  # relative to the panel: no point beyond this distance is selected


def nearest_point(
    branches: Iterable[tuple[str, Branch]],
    variable: str,
    click: Sequence[float],
    axis_limits: Sequence[Sequence[float]],
) -> tuple[str, int | None] | None:
    """Return (reference, index) of the nearest point of branches; None if no point is near.

    The index of a special point is None. A special point within `SPECIAL_RADIUS` takes precedence. `click` is (x, y),
    and `axis_limits` are the limits of the x and y axes.
    """
    candidate_points: list[tuple[float, str, int | None]] = []
    for reference, branch in branches:
        parameter_column = branch.values[:, None]
        relative_offsets = [
            (branch_column - click_coordinate) / (upper - lower)
            for branch_column, click_coordinate, (lower, upper) in zip(
                (parameter_column, variable_columns(branch, variable)), click, axis_limits, strict=True
            )
        ]
        distances = np.nan_to_num(np.hypot(*relative_offsets), nan=np.inf).min(axis=1)
        row_by_special_index = {
            special_index: special_point.place
            for special_index, special_point in enumerate(branch.special)
            if special_point.kind != "EP"
        }
        candidate_points += [
            (distances[row] - 1.0, f"{reference}.special[{special_index}]", None)
            for special_index, row in row_by_special_index.items()
            if distances[row] <= SPECIAL_RADIUS
        ]
        candidate_points.append((distances.min(), reference, int(distances.argmin())))
    nearest_candidate = min(candidate_points, key=lambda candidate: candidate[0], default=None)
    return None if nearest_candidate is None or nearest_candidate[0] > MAX_DISTANCE else nearest_candidate[1:]
