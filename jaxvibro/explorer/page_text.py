"""What the page is told besides pictures: a record of plain values, of which those that changed are sent."""

from collections.abc import Mapping
from typing import Any

import msgspec

from ..branches.curves import VARIABLES
from ..studies.schema import SceneFile
from . import descriptions, screen, shown
from .lines import SCENE, python
from .shown import Shown


def state_of(now: Shown, results: Mapping[str, Any], is_undoable: bool, works: Mapping[int, str]) -> dict[str, Any]:
    """What of a page changes as a slider moves: facts, numbers, marks."""
    scene = results[now.scene]
    numbers = {name: float(scene.parameter(name)) for name in scene.names}
    return {
        "numbers": numbers,
        "facts": descriptions.facts(now, results),
        "title": descriptions.title(now, results),
        "marks": screen.marks(now, results),
        "actions": descriptions.actions(now, results),
        "undo": is_undoable,
        "works": [{"work": number, "label": label} for number, label in works.items()],
    }


def rest_of(now: Shown, results: Mapping[str, Any], file: SceneFile | None) -> dict[str, Any]:
    """The rest: sliders, what is along the axes, special points, lines of Python, and the page as a scene file."""
    scene = results[SCENE]
    return {
        "sliders": [_slider(scene, name) for name in scene.names],
        "along": {name: getattr(now, name) for name in ("parameter", "bounds", "second", "second_bounds", "variable")},
        "variables": list(VARIABLES),
        "max_period": file.explore.max_period if file and file.explore else 2,
        "points": descriptions.points(now, results),
        "chosen": now.chosen,
        "python": program(now, results, file),
        "file": "" if file is None else text_of(now, file),
    }


def _slider(scene, name):
    low, high = shown.slider(scene, name)
    return {"name": name, "low": low, "high": high}


def program(now: Shown, results: Mapping[str, Any], file: SceneFile | None) -> str:
    """What was asked, as Python."""
    return python(None if file is None else file.scene, now.lines, results)


def text_of(now: Shown, file: SceneFile) -> str:
    """The page as a scene file: the file's own tables, and what was asked as [[view]]."""
    return msgspec.toml.encode(msgspec.structs.replace(file, view=list(now.lines))).decode()
