"""Repeat the calls in the [[view]] tables of a scene file."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..studies.schema import ViewTable
from .background_tasks import ProgressCallback
from .calls import MOTION_CALLS, SCENE_NAME, evaluate
from .page_state import PageState


def replay_lines(lines: Sequence[ViewTable], scene: Scene, report: ProgressCallback) -> dict[str, Any]:
    """Return {name: result} of lines.

    Raises ArgumentError for a line that no page can have written, and the errors of its call.
    """
    results: dict[str, Any] = {SCENE_NAME: scene}
    for line_number, line in enumerate(lines, 1):
        if line.name in results:
            raise ArgumentError("view.name", "must differ from earlier names", line.name)
        report(f"line {line_number} of {len(lines)}")
        results[line.name] = evaluate(line, results, report)
    return results


def restore_page(first_page: PageState, lines: Sequence[ViewTable], results: Mapping[str, Any]) -> PageState:
    """Return the page after lines: their last scene, orbit and parameters, and the rest of the first page."""
    scene_names = [line.name for line in lines if line.call == "replace"]
    motion_lines = [line for line in lines if line.call in MOTION_CALLS]
    fields: dict[str, Any] = {"scene": scene_names[-1] if scene_names else SCENE_NAME}
    if motion_lines:
        last_line = motion_lines[-1]
        is_point = last_line.call in ("orbit", "special")
        point_index = last_line.arguments.get("place") if is_point else None
        fields |= {"current": last_line.name, "chosen": last_line.of if is_point else "", "place": point_index}
    branch_arguments = [line.arguments for line in lines if line.call in ("follow", "explore")]
    if branch_arguments:
        fields |= {
            "parameter": branch_arguments[-1]["parameter"],
            "bounds": (branch_arguments[-1]["low"], branch_arguments[-1]["high"]),
        }
        bounds_records = [line.arguments["bounds"] for line in lines if line.call in ("locus", "map")]
        bounds: dict[str, Any] = next(
            (candidate for candidate in bounds_records if fields["parameter"] in candidate), {}
        )
        second = next(
            (name for name in (*bounds, first_page.second, first_page.parameter) if name != fields["parameter"]), None
        )
        if second is not None:
            fields["second"] = second
            fields["second_bounds"] = tuple(bounds[second]) if second in bounds else _first_bounds(first_page, second)
    return first_page.with_lines(*lines, **fields)


def _first_bounds(first_page, name):
    return first_page.second_bounds if name == first_page.second else first_page.bounds
