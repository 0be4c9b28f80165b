"""What a page shows: a frozen record, so that undoing is going back to an earlier one."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from ..branches.branch import Branch
from ..branches.diagram import Diagram
from ..design.margin import Margin
from ..loci.locus import Locus
from ..scene.parameters import parameter_domain
from ..scene.scene import Scene
from ..studies.schema import SceneFile, ViewTable
from .calls import SCENE_NAME, prune_lines

RELATIVE_ROUNDING = 1e-12  # of a number: as near is rounding
SLIDER_FACTOR = 2.0  # times a number: as far its slider goes


@dataclass(frozen=True)
class PageState:
    """lines: what was asked; scene, current: names of the results that are the scene, and the orbit or motion, ""
    before there is one; chosen: the reference of what was clicked; place: of the point on the branch that was, else
    None; parameter, bounds: of the diagram; second, second_bounds: of the plane; variable: of the diagram."""

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

    def with_lines(self, *lines: ViewTable, **changes: Any) -> "PageState":
        """With lines and other changes; scenes and looks that nothing needs any more are left out."""
        page = replace(self, **changes)
        names_in_use = (page.scene, page.current, page.chosen.split(".")[0].split("[")[0])
        return replace(page, lines=prune_lines((*self.lines, *lines), names_in_use))

    @property
    def plane_bounds(self) -> dict[str, tuple[float, float]]:
        """The bounds of the plane's two parameters."""
        return {self.parameter: self.bounds, self.second: self.second_bounds}


def first_page(scene: Scene, file: SceneFile | None) -> PageState:
    """What a page shows at first: the parameters and bounds that the file's tables have, else those of the drive."""
    names = [name for name in scene.names if name != "hardness"]
    name, bounds = (file and _file_diagram(file)) or ("amplitude", slider_range(scene, "amplitude"))
    table = file and (file.locus or file.map)
    other_parameters = [candidate for candidate in (table.parameters if table else ()) if candidate != name]
    second = next(
        iter(other_parameters), next(candidate for candidate in ("frequency", "amplitude", *names) if candidate != name)
    )
    second_bounds = table.bounds[second] if table and second in table.bounds else slider_range(scene, second)
    return PageState(name, bounds, second, second_bounds)


def _file_diagram(file):
    """(name, bounds) of the diagram that a file asks for."""
    if file.branch_table is not None:
        return file.branch_table.parameter, file.branch_table.bounds
    if file.sweep is not None:
        end_values = [end_value for leg in file.sweep.legs for end_value in (leg.first, leg.last)]
        return file.sweep.parameter, (min(end_values), max(end_values))
    if file.spectrum is not None and file.spectrum.first != file.spectrum.last:
        return file.spectrum.parameter, tuple(sorted((file.spectrum.first, file.spectrum.last)))
    return None


def slider_range(scene: Scene, name: str) -> tuple[float, float]:
    """The range of a parameter's slider: about its value, within its domain."""
    value = float(scene.parameter(name))
    lower, upper = parameter_domain(scene, name)
    if name.endswith("restitution"):
        return 0.0, 1.0
    if name.endswith("phase"):
        return min(0.0, value), max(2.0 * np.pi, value)
    if name.endswith(("frequency", "stiffness")):
        return value / SLIDER_FACTOR, value * SLIDER_FACTOR
    if name == "hardness":
        return value - 1.0, value + 1.0
    half_range = max(abs(value), 0.5)
    preferred = (min(0.0, value), max(SLIDER_FACTOR * value, 0.5)) if name in ("amplitude", "damping") else None
    start, stop = preferred or (value - half_range, value + half_range)
    wall_gap = 0.01 * half_range  # walls may come near to each other, but not meet
    return max(start, lower + wall_gap if lower > start else start), min(
        stop, upper - wall_gap if upper < stop else stop
    )


def is_same_scene(scene: Scene, other_scene: Scene, *except_names: str) -> bool:
    """Whether two scenes are the same but for some parameters."""
    if scene.names != other_scene.names:
        return False
    names = [name for name in scene.names if name not in except_names and not (name == "hardness" and except_names)]
    return all(
        abs(float(scene.parameter(name)) - float(other_scene.parameter(name)))
        <= RELATIVE_ROUNDING * (1 + abs(float(scene.parameter(name))))
        for name in names
    )


def branches(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Branch]]:
    """(reference, `Branch`) of all that belong to the diagram: of its parameter, and of the scene in all else."""
    scene = results[page.scene]
    for line in page.lines:
        value = results[line.name]
        for reference, branch in _curves(line.name, value, Branch):
            if branch.name == page.parameter and is_same_scene(branch.scene, scene, page.parameter):
                yield reference, branch


def loci(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Locus]]:
    """(reference, `Locus`) of all that belong to the plane."""
    scene, names = results[page.scene], (page.parameter, page.second)
    for line in page.lines:
        for reference, locus in _curves(line.name, results[line.name], Locus):
            if locus.names == names and is_same_scene(locus.scene, scene, *names):
                yield reference, locus


def _curves(name, value, curve_type):
    if isinstance(value, curve_type):
        yield name, value
    elif isinstance(value, Diagram) and curve_type is Branch:
        yield from ((f"{name}.branches[{k}]", curve) for k, curve in enumerate(value.branches))
    elif isinstance(value, tuple):
        yield from ((f"{name}[{k}]", curve) for k, curve in enumerate(value) if isinstance(curve, curve_type))


def latest_result(page: PageState, results: Mapping[str, Any], call: str, *except_names: str) -> Any:
    """The result of the last line of a call whose scene is the one shown but for some parameters, None without."""
    scene = results[page.scene]
    for line in reversed(page.lines):
        if line.call == call and is_same_scene(_receiver_scene(results[line.of]), scene, *except_names):
            return results[line.name]
    return None


def _receiver_scene(value):
    return value if isinstance(value, Scene) else value.scene


def current_sweeps(page: PageState, results: Mapping[str, Any]) -> list[xr.Dataset]:
    """The sweeps that belong to the diagram."""
    scene = results[page.scene]
    sweep_lines = [
        line for line in page.lines if line.call == "sweep" and line.arguments["parameter"] == page.parameter
    ]
    return [results[line.name] for line in sweep_lines if is_same_scene(results[line.of], scene, page.parameter)]


def current_map(page: PageState, results: Mapping[str, Any]) -> xr.Dataset | None:
    """The map that belongs to the plane: the second parameter up, the first across."""
    names = (page.second, page.parameter)
    map_data = latest_result(page, results, "map", *names)
    return map_data if map_data is not None and tuple(map_data["label"].dims) == names else None


def current_margin(page: PageState, results: Mapping[str, Any]) -> Margin | None:
    """The margin that belongs to the plane."""
    margin = latest_result(page, results, "margin")
    return margin if margin is not None and tuple(margin.free) == (page.parameter, page.second) else None
