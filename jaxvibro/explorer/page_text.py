"""Collect the fields of a page besides its figures, as records of plain values.

The session sends those that changed.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from ..branches.curves import VARIABLES
from ..studies.schema import SceneFile
from . import descriptions, page_state, screen
from .calls import SCENE_NAME, python_program
from .page_state import PageState


def live_fields(
    page: PageState, results: Mapping[str, Any], can_undo: bool, task_labels: Mapping[int, str]
) -> dict[str, Any]:
    """Return the fields that change while a slider moves: facts, numbers and markers."""
    scene = results[page.scene]
    parameter_values = {name: float(scene.parameter(name)) for name in scene.names}
    return {
        "numbers": parameter_values,
        "facts": descriptions.page_facts(page, results),
        "title": descriptions.portrait_title(page, results),
        "marks": screen.marker_positions(page, results),
        "actions": descriptions.available_actions(page, results),
        "undo": can_undo,
        "works": [{"work": task_number, "label": label} for task_number, label in task_labels.items()],
    }


def static_fields(page: PageState, results: Mapping[str, Any], file: SceneFile | None) -> dict[str, Any]:
    """Return the other fields: sliders, axes, special points, Python code, and the page as a scene file."""
    scene = results[SCENE_NAME]
    return {
        "sliders": [_slider_record(scene, name) for name in scene.names],
        "along": {name: getattr(page, name) for name in ("parameter", "bounds", "second", "second_bounds", "variable")},
        "variables": list(VARIABLES),
        "max_period": file.explore.max_period if file and file.explore else 2,
        "points": descriptions.special_points(page, results),
        "chosen": page.chosen,
        "python": program_text(page, results, file),
        "file": "" if file is None else scene_file_text(page, file),
    }


def _slider_record(scene, name):
    lower, upper = page_state.slider_range(scene, name)
    return {"name": name, "low": lower, "high": upper}


def program_text(page: PageState, results: Mapping[str, Any], file: SceneFile | None) -> str:
    """Return the calls of the page as a Python program."""
    return python_program(None if file is None else file.scene, page.lines, results)


def scene_file_text(page: PageState, file: SceneFile) -> str:
    """Return the page as a scene file: the tables of the file, and the calls as [[view]] tables."""
    return msgspec.toml.encode(msgspec.structs.replace(file, view=list(page.lines))).decode()
