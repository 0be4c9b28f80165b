"""Represent the content of a page as a frozen record, so that undo restores an earlier record."""

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
        Calls in order.
    scene : str
        Name of the current scene.
    current : str
        Name of the current orbit or motion; "" before there is any.
    chosen : str
        Reference of the selection.
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

    def with_lines(self, *lines: ViewTable, **changes: Any) -> "PageState":
        """Return the page with further lines and changes, without scenes and orbits that nothing uses."""
        page = replace(self, **changes)
        names_in_use = (page.scene, page.current, page.chosen.split(".")[0].split("[")[0])
        return replace(page, lines=prune_lines((*self.lines, *lines), names_in_use))

    @property
    def plane_bounds(self) -> dict[str, tuple[float, float]]:
        """Bounds of the two parameters of the plane."""
        return {self.parameter: self.bounds, self.second: self.second_bounds}


def first_page(scene: Scene, file: SceneFile | None) -> PageState:
    """Return the first content of a page, with parameters and bounds from the file, else those of the drive."""
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
    """Return (name, bounds) of the diagram that a file defines; None without one."""
    if file.branch_table is not None:
        return file.branch_table.parameter, file.branch_table.bounds
    if file.sweep is not None:
        end_values = [end_value for leg in file.sweep.legs for end_value in (leg.first, leg.last)]
        return file.sweep.parameter, (min(end_values), max(end_values))
    if file.spectrum is not None and file.spectrum.first != file.spectrum.last:
        return file.spectrum.parameter, tuple(sorted((file.spectrum.first, file.spectrum.last)))
    return None


def slider_range(scene: Scene, name: str) -> tuple[float, float]:
    """Return the range of the slider of a parameter: around its value, inside its domain."""
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
    wall_gap = 0.01 * half_range  # walls must not meet
    return max(start, lower + wall_gap if lower > start else start), min(
        stop, upper - wall_gap if upper < stop else stop
    )


def is_same_scene(scene: Scene, other_scene: Scene, *except_names: str) -> bool:
    """Return True if two scenes agree in all parameters except some."""
    if scene.names != other_scene.names:
        return False
    names = [name for name in scene.names if name not in except_names and not (name == "hardness" and except_names)]
    return all(
        abs(float(scene.parameter(name)) - float(other_scene.parameter(name)))
        <= RELATIVE_ROUNDING * (1 + abs(float(scene.parameter(name))))
        for name in names
    )


def branches(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Branch]]:
    """Yield (reference, `Branch`) of the branches of the diagram.

    These vary the parameter of the diagram and agree with the scene in all others.
    """
    scene = results[page.scene]
    for line in page.lines:
        value = results[line.name]
        for reference, branch in _curves(line.name, value, Branch):
            if branch.name == page.parameter and is_same_scene(branch.scene, scene, page.parameter):
                yield reference, branch


def loci(page: PageState, results: Mapping[str, Any]) -> Iterator[tuple[str, Locus]]:
    """Yield (reference, `Locus`) of the loci of the plane."""
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
    """Return the last result of a call whose scene is the current one except for some parameters; None without one."""
    scene = results[page.scene]
    for line in reversed(page.lines):
        if line.call == call and is_same_scene(_receiver_scene(results[line.of]), scene, *except_names):
            return results[line.name]
    return None


def _receiver_scene(value):
    return value if isinstance(value, Scene) else value.scene


def current_sweeps(page: PageState, results: Mapping[str, Any]) -> list[xr.Dataset]:
    """Return the sweeps of the diagram."""
    scene = results[page.scene]
    sweep_lines = [
        line for line in page.lines if line.call == "sweep" and line.arguments["parameter"] == page.parameter
    ]
    return [results[line.name] for line in sweep_lines if is_same_scene(results[line.of], scene, page.parameter)]


def current_map(page: PageState, results: Mapping[str, Any]) -> xr.Dataset | None:
    """Return the map of the plane, with the second parameter on the y axis; None without one."""
    names = (page.second, page.parameter)
    map_data = latest_result(page, results, "map", *names)
    return map_data if map_data is not None and tuple(map_data["label"].dims) == names else None


def current_margin(page: PageState, results: Mapping[str, Any]) -> Margin | None:
    """Return the margin of the plane; None without one."""
    margin = latest_result(page, results, "margin")
    return margin if margin is not None and tuple(margin.free) == (page.parameter, page.second) else None
