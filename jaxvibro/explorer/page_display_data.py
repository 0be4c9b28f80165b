"""Collect the fields of a page besides its figures, as records of plain values.

The session sends the fields that have changed.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from ..branches.branch_curves import VARIABLES
from ..studies.schema import SceneFile
from . import page_descriptions, page_screen, page_state
from .page_calls import SCENE_NAME, python_code_of_page
from .page_state import PageState


def display_data_on_drag(
    page: PageState, results: Mapping[str, Any], can_undo: bool, task_labels: Mapping[int, str]
) -> dict[str, Any]:
    """Return the fields that may change while a slider moves, such as facts, parameter values and markers."""
    scene = results[page.scene]
    parameter_values = {name: float(scene.parameter(name)) for name in scene.names}
    return {
        "numbers": parameter_values,
        "facts": page_descriptions.page_facts_text(page, results),
        "title": page_descriptions.portrait_title(page, results),
        "marks": page_screen.marker_positions(page, results),
        "actions": page_descriptions.available_actions(page, results),
        "undo": can_undo,
        "works": [{"work": task_number, "label": label} for task_number, label in task_labels.items()],
    }


def display_data_when_idle(page: PageState, results: Mapping[str, Any], scene_file: SceneFile | None) -> dict[str, Any]:
    """Return the fields that do not change while a slider moves, such as sliders, special points and Python code."""
    scene = results[SCENE_NAME]
    slider_ranges = {name: page_state.slider_range(scene, name) for name in scene.names}
    return {
        "sliders": [{"name": name, "low": low, "high": high} for name, (low, high) in slider_ranges.items()],
        "along": {name: getattr(page, name) for name in ("parameter", "bounds", "second", "second_bounds", "variable")},
        "variables": list(VARIABLES),
        "max_period": scene_file.explore.max_period if scene_file and scene_file.explore else 2,
        "points": page_descriptions.special_point_records(page, results),
        "chosen": page.chosen,
        "python": program_text(page, results, scene_file),
        "file": "" if scene_file is None else scene_file_text(page, scene_file),
    }


def program_text(page: PageState, results: Mapping[str, Any], scene_file: SceneFile | None) -> str:
    """Return the calls of the page as a Python program."""
    return python_code_of_page(None if scene_file is None else scene_file.scene, page.lines, results)


def scene_file_text(page: PageState, scene_file: SceneFile) -> str:
    """Return the page as the text of a scene file: the tables of `scene_file`, and the calls as [[view]] tables."""
    return msgspec.toml.encode(msgspec.structs.replace(scene_file, view=list(page.lines))).decode()
