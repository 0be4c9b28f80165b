"""Hold the sizes and limits of the panels of a page, and the figures that are already drawn."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..branches.branch import Branch, Special
from ..branches.curves import variable_columns
from ..orbits.orbit import Orbit
from . import page_state, panels
from .calls import resolve
from .error_records import error_record, message_record
from .page_state import PageState
from .panels import Limits, Panel

PANEL_ORDER = ("portrait", "trace", "diagram", "plane")
FAST_PANELS = ("portrait",)  # redrawn while a slider moves


class Screen:
    """Panels of one page."""

    def __init__(self) -> None:
        self.panels: dict[str, Panel] = {}
        self.limits: dict[str, Limits] = {}
        self.drawn_limits: dict[str, tuple[list[float], list[float]]] = {}
        # (key, arguments) of each panel. Keeping the arguments keeps the ids in the key valid.
        self.picture_cache: dict[str, Any] = {}

    def invalidate(self) -> None:
        """Discard limits and figures, so that all panels are redrawn."""
        self.limits.clear()
        self.picture_cache.clear()

    def axis_limits(self, panel: str, page: PageState) -> tuple[Any, Any]:
        """Return the limits of the x and y axes of a panel, or the bounds of the page before the first drawing."""
        return self.drawn_limits.get(panel, (page.bounds, page.second_bounds))

    def changed_pictures(
        self, page: PageState, results: Mapping[str, Any], fast_only: bool
    ) -> Iterator[dict[str, Any]]:
        """Yield the record of each panel whose figure changes; `fast_only` restricts them to the portrait."""
        for panel in FAST_PANELS if fast_only else PANEL_ORDER:
            if panel not in self.panels:
                continue
            arguments = draw_arguments(panel, page, results)
            for limits in dict.fromkeys((self.limits.get(panel, Limits()), Limits())):
                key = arguments and (*map(_identity_key, arguments), self.panels[panel].size, limits)
                if arguments is None or key == self.picture_cache.get(panel, (None,))[0]:
                    break
                self.picture_cache[panel] = key, arguments
                try:
                    record = self.panels[panel].render(
                        partial(_call_draw, DRAW_FUNCTIONS[panel], arguments), limits, fast_only
                    )
                except Exception as error:  # values that cannot be drawn: retry without limits
                    self.panels[panel] = Panel(self.panels[panel].size)
                    self.limits.pop(panel, None)
                    yield message_record(f"the {panel} cannot be drawn: {error_record(error)['text']}")
                    continue
                self.drawn_limits[panel] = record["x"], record["y"]
                yield {"kind": "picture", "panel": panel, **record}
                break


DRAW_FUNCTIONS: dict[str, Callable[..., None]] = {
    "portrait": panels.portrait,
    "trace": panels.trace,
    "diagram": panels.diagram,
    "plane": panels.plane,
}


def draw_arguments(panel: str, page: PageState, results: Mapping[str, Any]) -> tuple[Any, ...] | None:
    """Return the arguments of the draw function of a panel; None if there is nothing to draw."""
    if panel == "diagram":
        branches = tuple(result for _, result in page_state.branches(page, results))
        parameter_value, attractors = (
            float(results[page.scene].parameter(page.parameter)),
            page_state.latest_result(page, results, "attractors"),
        )
        sweeps = tuple(page_state.current_sweeps(page, results))
        return (
            branches,
            sweeps,
            attractors or (),
            parameter_value if attractors else 0.0,
            page.parameter,
            page.bounds,
            page.variable,
        )
    if panel == "plane":
        loci = tuple(result for _, result in page_state.loci(page, results))
        names, bounds = (page.parameter, page.second), (page.bounds, page.second_bounds)
        return loci, page_state.current_map(page, results), page_state.current_margin(page, results), names, bounds
    result = results.get(page.current)
    if result is None:
        return None
    scene = result.scene if isinstance(result, Orbit) else results[page.scene]
    if panel == "trace":
        return result, scene
    return result, scene, isinstance(result, Orbit) and result.stable, page_state.latest_result(page, results, "basins")


def marker_positions(page: PageState, results: Mapping[str, Any]) -> dict[str, list[list[float]]]:
    """Return the positions of the current motion in the diagram and the plane, {panel: [[x, y], ...]}."""
    scene, motion = results[page.scene], results.get(page.current)
    coordinates = [float(scene.parameter(name)) for name in (page.parameter, page.second)]
    selection = resolve(page.chosen, results) if page.chosen else None
    heights: list[float] = []
    if isinstance(selection, Special):
        branch = resolve(page.chosen.rpartition(".special")[0], results)
        heights = variable_columns(branch, page.variable)[selection.place].tolist()
    elif isinstance(selection, Branch) and page.place is not None:
        heights = variable_columns(selection, page.variable)[page.place].tolist()
    elif isinstance(motion, Orbit) and page.variable in ("x", "v") and not motion.state.phase:
        heights = [float(getattr(motion.state, page.variable))]
    return {"diagram": [[coordinates[0], height] for height in heights if np.isfinite(height)], "plane": [coordinates]}


def _call_draw(draw, arguments, ax):
    draw(ax, *arguments)


def _identity_key(argument):
    """Return a key that is equal for the same figure; results never change, so their identity suffices."""
    if isinstance(argument, tuple):
        return tuple(map(_identity_key, argument))
    return argument if isinstance(argument, str | float | int | bool | None) else id(argument)
