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
from ..scene.parameters import domain
from ..scene.scene import Scene
from ..studies.schema import SceneFile, ViewTable
from .lines import SCENE, tidy

SAME = 1e-12  # of a number: as near is rounding
ROOM = 2.0  # times a number: as far its slider goes


@dataclass(frozen=True)
class Shown:
    """lines: what was asked; scene, current: names of the results that are the scene, and the orbit or motion, ""
    before there is one; chosen: the reference of what was clicked; place: of the point on the branch that was, else
    None; parameter, bounds: of the diagram; second, second_bounds: of the plane; variable: of the diagram."""

    parameter: str
    bounds: tuple[float, float]
    second: str
    second_bounds: tuple[float, float]
    lines: tuple[ViewTable, ...] = ()
    scene: str = SCENE
    current: str = ""
    chosen: str = ""
    place: int | None = None
    variable: str = "x"

    def having(self, *lines: ViewTable, **changes: Any) -> "Shown":
        """With lines and other changes; scenes and looks that nothing needs any more are left out."""
        found = replace(self, **changes)
        kept = (found.scene, found.current, found.chosen.split(".")[0].split("[")[0])
        return replace(found, lines=tidy((*self.lines, *lines), kept))

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """The bounds of the plane's two parameters."""
        return {self.parameter: self.bounds, self.second: self.second_bounds}


def first_shown(scene: Scene, file: SceneFile | None) -> Shown:
    """What a page shows at first: the parameters and bounds that the file's tables have, else those of the drive."""
    names = [name for name in scene.names if name != "hardness"]
    name, bounds = (file and _asked(file)) or ("amplitude", slider(scene, "amplitude"))
    table = file and (file.locus or file.map)
    others = [one for one in (table.parameters if table else ()) if one != name]
    second = next(iter(others), next(one for one in ("frequency", "amplitude", *names) if one != name))
    wide = table.bounds[second] if table and second in table.bounds else slider(scene, second)
    return Shown(name, bounds, second, wide)


def _asked(file):
    """(name, bounds) of the diagram that a file asks for."""
    if file.followed is not None:
        return file.followed.parameter, file.followed.bounds
    if file.sweep is not None:
        ends = [each for leg in file.sweep.legs for each in (leg.first, leg.last)]
        return file.sweep.parameter, (min(ends), max(ends))
    if file.spectrum is not None and file.spectrum.first != file.spectrum.last:
        return file.spectrum.parameter, tuple(sorted((file.spectrum.first, file.spectrum.last)))
    return None


def slider(scene: Scene, name: str) -> tuple[float, float]:
    """The range of a parameter's slider: about its value, within its domain."""
    value = float(scene.parameter(name))
    low, high = domain(scene, name)
    if name.endswith("restitution"):
        return 0.0, 1.0
    if name.endswith("phase"):
        return min(0.0, value), max(2.0 * np.pi, value)
    if name.endswith(("frequency", "stiffness")):
        return value / ROOM, value * ROOM
    if name == "hardness":
        return value - 1.0, value + 1.0
    reach = max(abs(value), 0.5)
    wanted = (min(0.0, value), max(ROOM * value, 0.5)) if name in ("amplitude", "damping") else None
    first, last = wanted or (value - reach, value + reach)
    room = 0.01 * reach  # walls may come near to each other, but not meet
    return max(first, low + room if low > first else first), min(last, high - room if high < last else last)


def is_alike(one: Scene, other: Scene, *besides: str) -> bool:
    """Whether two scenes are the same but for some parameters."""
    if one.names != other.names:
        return False
    names = [name for name in one.names if name not in besides and not (name == "hardness" and besides)]
    return all(
        abs(float(one.parameter(name)) - float(other.parameter(name))) <= SAME * (1 + abs(float(one.parameter(name))))
        for name in names
    )


def branches(shown: Shown, results: Mapping[str, Any]) -> Iterator[tuple[str, Branch]]:
    """(reference, `Branch`) of all that belong to the diagram: of its parameter, and of the scene in all else."""
    scene = results[shown.scene]
    for line in shown.lines:
        value = results[line.name]
        for reference, one in _curves(line.name, value, Branch):
            if one.name == shown.parameter and is_alike(one.scene, scene, shown.parameter):
                yield reference, one


def loci(shown: Shown, results: Mapping[str, Any]) -> Iterator[tuple[str, Locus]]:
    """(reference, `Locus`) of all that belong to the plane."""
    scene, names = results[shown.scene], (shown.parameter, shown.second)
    for line in shown.lines:
        for reference, one in _curves(line.name, results[line.name], Locus):
            if one.names == names and is_alike(one.scene, scene, *names):
                yield reference, one


def _curves(name, value, kind):
    if isinstance(value, kind):
        yield name, value
    elif isinstance(value, Diagram) and kind is Branch:
        yield from ((f"{name}.branches[{k}]", one) for k, one in enumerate(value.branches))
    elif isinstance(value, tuple):
        yield from ((f"{name}[{k}]", one) for k, one in enumerate(value) if isinstance(one, kind))


def latest(shown: Shown, results: Mapping[str, Any], call: str, *besides: str) -> Any:
    """The result of the last line of a call whose scene is the one shown but for some parameters, None without."""
    scene = results[shown.scene]
    for line in reversed(shown.lines):
        if line.call == call and is_alike(_scene_of(results[line.of]), scene, *besides):
            return results[line.name]
    return None


def _scene_of(value):
    return value if isinstance(value, Scene) else value.scene


def swept(shown: Shown, results: Mapping[str, Any]) -> list[xr.Dataset]:
    """The sweeps that belong to the diagram."""
    scene = results[shown.scene]
    found = [line for line in shown.lines if line.call == "sweep" and line.arguments["parameter"] == shown.parameter]
    return [results[line.name] for line in found if is_alike(results[line.of], scene, shown.parameter)]


def mapped(shown: Shown, results: Mapping[str, Any]) -> xr.Dataset | None:
    """The map that belongs to the plane: the second parameter up, the first across."""
    names = (shown.second, shown.parameter)
    found = latest(shown, results, "map", *names)
    return found if found is not None and tuple(found["label"].dims) == names else None


def near(shown: Shown, results: Mapping[str, Any]) -> Margin | None:
    """The margin that belongs to the plane."""
    found = latest(shown, results, "margin")
    return found if found is not None and tuple(found.free) == (shown.parameter, shown.second) else None
