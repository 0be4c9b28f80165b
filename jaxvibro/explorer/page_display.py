"""Collect the fields of a page besides its figures: records of plain values, and descriptions in words.

The session sends the fields that have changed.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import xarray as xr

from ..attractors.basin_fraction_bounds import format_share
from ..branches.branch import KIND_NAMES, Branch, Special, neighbour_labels
from ..branches.branch_curves import VARIABLES
from ..branches.switch import SWITCHING_KINDS as LEAVING
from ..loci.locus_start import KINDS, STICKING_KINDS
from ..orbits.orbit import Orbit
from ..studies.schema import SceneFile
from . import page_screen, page_state
from .page_calls import SCENE_NAME, python_code_of_page, resolve_reference
from .page_state import PageState, diagram_branches

SCENE_ACTIONS = {  # actions on the scene, always available
    "explore": "all branches",
    "sweep": "sweep up and down",
    "attractors": "attractors from 200 starts",
    "basins": "basins behind the portrait",
    "map": "map behind the plane",
}


def page_facts_text(page: PageState, results: Mapping[str, Any]) -> str:
    """Describe the current orbit or motion, the selected special point, and the last result."""
    paragraphs = []
    branch_or_special = resolve_reference(page.chosen, results) if page.chosen else None
    if isinstance(branch_or_special, Special):
        normal_form = branch_or_special.normal_form
        normal_form_text = f", {normal_form.consequence}: {normal_form}" if normal_form else ""
        neighbours_text = (
            f", where {' and '.join(neighbour_labels(branch_or_special))} meet" if branch_or_special.joins else ""
        )
        paragraphs.append(
            f"{branch_or_special.kind} ({KIND_NAMES.get(branch_or_special.kind, 'a monitor')}) at"
            f" {branch_or_special.value:.12g}{neighbours_text}{normal_form_text}"
        )
    elif page.place is not None and isinstance(branch_or_special, Branch):
        paragraphs.append(
            f"point {page.place} of {len(branch_or_special)} at {branch_or_special.name}"
            f" {branch_or_special.values[page.place]:.12g}"
        )
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        paragraphs.append(motion.table())
    elif isinstance(motion, xr.Dataset):
        paragraphs.append(_describe_motion(motion))
    for call_line in page.lines[-1:]:
        result = results[call_line.name]
        if call_line.call == "margin":
            paragraphs.append(result.table())
        elif call_line.call == "attractors":
            paragraphs.append("\n".join(f"{attractor.label}, {format_share(attractor)}" for attractor in result))
    return "\n\n".join(paragraphs)


def portrait_title(page: PageState, results: Mapping[str, Any]) -> str:
    """Return the title of the portrait."""
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        return f"{motion.label}, {'stable' if motion.stable else 'unstable'}"
    return "" if motion is None else "no orbit"


def action_label(call_name: str, page: PageState, results: Mapping[str, Any]) -> str:
    """Return the label of an action."""
    return next(
        (action["label"] for action in available_actions(page, results) if action["call"] == call_name), call_name
    )


def _describe_motion(motion):
    x, v = (motion[name].values for name in ("x", "v"))
    n_impacts = motion.sizes["impact"]
    n_periods = (motion["phase"].values[-1] - motion["phase"].values[0]) / (2.0 * np.pi)
    return (
        f"no periodic orbit of up to 32 periods found; the portrait shows {n_periods:.0f} periods with"
        f" {n_impacts} impacts;\n"
        f"x from {x.min():.6g} to {x.max():.6g}, v from {v.min():.6g} to {v.max():.6g}"
    )


def available_actions(page: PageState, results: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the available actions as {"call", "label"}, those of the selection first."""
    branch_or_special, calls_and_labels = resolve_reference(page.chosen, results) if page.chosen else None, []
    if isinstance(branch_or_special, Special):
        if branch_or_special.kind in LEAVING:
            calls_and_labels.append(("switch", f"branches from {branch_or_special.kind}"))
        if branch_or_special.kind in (*KINDS, *STICKING_KINDS):
            calls_and_labels.append(("locus", f"locus of {branch_or_special.kind}"))
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        calls_and_labels.append(("follow", f"branch of {motion.label}"))
        calls_and_labels.append(("margin", f"margin of {motion.label}"))
    return [{"call": call_name, "label": label} for call_name, label in (*calls_and_labels, *SCENE_ACTIONS.items())]


def special_point_records(page: PageState, results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return records of the special points of the branches in the diagram, sorted by value.

    Each record has the reference, kind, value, label and meaning. A point that several branches share is listed once.
    """
    records: list[dict[str, Any]] = []
    for reference, branch in diagram_branches(page, results):
        for index, special_point in enumerate(branch.special):
            if special_point.kind == "EP":
                continue
            record = {
                "of": f"{reference}.special[{index}]",
                "kind": special_point.kind,
                "value": special_point.value,
                "label": special_point.label,
            }
            same_kind_records = [
                other_record
                for other_record in records
                if (other_record["kind"], other_record["label"]) == (special_point.kind, special_point.label)
            ]
            if not any(
                abs(other_record["value"] - special_point.value) <= 1e-9 * (1.0 + abs(special_point.value))
                for other_record in same_kind_records
            ):
                records.append(record | {"meaning": KIND_NAMES.get(special_point.kind, "monitor")})
    return sorted(records, key=lambda record: record["value"])


def display_data_on_drag(
    page: PageState, results: Mapping[str, Any], can_undo: bool, task_labels: Mapping[int, str]
) -> dict[str, Any]:
    """Return the fields that may change while a slider moves, such as facts, parameter values and markers."""
    scene = results[page.scene]
    parameter_values = {name: float(scene.parameter(name)) for name in scene.names}
    return {
        "numbers": parameter_values,
        "facts": page_facts_text(page, results),
        "title": portrait_title(page, results),
        "marks": page_screen.marker_positions(page, results),
        "actions": available_actions(page, results),
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
        "points": special_point_records(page, results),
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
