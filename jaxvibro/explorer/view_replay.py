"""Repeat the calls in the [[view]] tables of a scene file."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..studies.schema import ViewTable
from .background_tasks import ProgressCallback
from .page_calls import MOTION_CALLS, SCENE_NAME, evaluate_call_line
from .page_state import PageState


def replay_call_lines(
    call_lines: Sequence[ViewTable], scene: Scene, report_progress: ProgressCallback
) -> dict[str, Any]:
    """Repeat the calls of lines; return {name: result}.

    Raises ArgumentError for a line that no page can have written. An error of a call is passed on.
    """
    results: dict[str, Any] = {SCENE_NAME: scene}
    for line_number, call_line in enumerate(call_lines, 1):
        if call_line.name in results:
            raise ArgumentError("view.name", "must differ from earlier names", call_line.name)
        report_progress(f"line {line_number} of {len(call_lines)}")
        results[call_line.name] = evaluate_call_line(call_line, results, report_progress)
    return results


def restore_page(initial_page: PageState, call_lines: Sequence[ViewTable], results: Mapping[str, Any]) -> PageState:
    """Return the page after the calls of lines.

    Scene, motion and parameters are the last ones in the lines. All other content is that of `initial_page`.
    """
    scene_names = [call_line.name for call_line in call_lines if call_line.call == "replace"]
    motion_lines = [call_line for call_line in call_lines if call_line.call in MOTION_CALLS]
    page_fields: dict[str, Any] = {"scene": scene_names[-1] if scene_names else SCENE_NAME}
    if motion_lines:
        last_motion_line = motion_lines[-1]
        is_branch_point = last_motion_line.call in ("orbit", "special")
        point_index = last_motion_line.arguments.get("place") if is_branch_point else None
        page_fields |= {
            "current": last_motion_line.name,
            "chosen": last_motion_line.of if is_branch_point else "",
            "place": point_index,
        }
    branch_call_arguments = [call_line.arguments for call_line in call_lines if call_line.call in ("follow", "explore")]
    if branch_call_arguments:
        page_fields |= {
            "parameter": branch_call_arguments[-1]["parameter"],
            "bounds": (branch_call_arguments[-1]["low"], branch_call_arguments[-1]["high"]),
        }
        plane_bounds_records = [
            call_line.arguments["bounds"] for call_line in call_lines if call_line.call in ("locus", "map")
        ]
        plane_bounds: dict[str, Any] = next(
            (
                candidate_bounds
                for candidate_bounds in plane_bounds_records
                if page_fields["parameter"] in candidate_bounds
            ),
            {},
        )
        second_parameter = next(
            (
                name
                for name in (*plane_bounds, initial_page.second, initial_page.parameter)
                if name != page_fields["parameter"]
            ),
            None,
        )
        if second_parameter is not None:
            page_fields["second"] = second_parameter
            page_fields["second_bounds"] = (
                tuple(plane_bounds[second_parameter])
                if second_parameter in plane_bounds
                else initial_page.plane_bounds[second_parameter]
            )
    return initial_page.with_call_lines(*call_lines, **page_fields)
