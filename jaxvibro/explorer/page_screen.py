"""Hold the sizes and limits of the panels of a page, and the figures that are already drawn."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..branches.branch import Branch, Special
from ..branches.branch_curves import variable_columns
from ..orbits.orbit import Orbit
from . import page_state, panels
from .messages import error_record, message_record
from .page_calls import resolve_reference
from .page_state import PageState
from .panels import AxisLimits, Panel

PANEL_ORDER = ("portrait", "trace", "diagram", "plane")
FAST_PANELS = ("portrait",)  # redrawn while a slider moves


class Screen:
    """Panels of one page.

    Attributes
    ----------
    panels : dict of str to Panel
        Figures of the panels.
    limits : dict of str to AxisLimits
        Limits of the axes that the user has chosen.
    drawn_limits : dict of str to tuple
        Limits of the x and y axes of the last figures.
    picture_cache : dict of str to tuple
        Key and arguments of the last figures.
    """

    def __init__(self) -> None:
        self.panels: dict[str, Panel] = {}
        self.limits: dict[str, AxisLimits] = {}
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
        self, page: PageState, results: Mapping[str, Any], portrait_only: bool
    ) -> Iterator[dict[str, Any]]:
        """Yield the record of each panel whose figure changes; `portrait_only` restricts them to the portrait."""
        for panel in FAST_PANELS if portrait_only else PANEL_ORDER:
            if panel not in self.panels:
                continue
            arguments = draw_arguments(panel, page, results)
            for limits in dict.fromkeys((self.limits.get(panel, AxisLimits()), AxisLimits())):
                picture_key = arguments and (*map(_argument_cache_key, arguments), self.panels[panel].size, limits)
                if arguments is None or picture_key == self.picture_cache.get(panel, (None,))[0]:
                    break
                self.picture_cache[panel] = picture_key, arguments
                try:
                    picture_record = self.panels[panel].render(
                        partial(_draw_on_axes, DRAW_FUNCTIONS[panel], arguments), limits, portrait_only
                    )
                except Exception as error:  # values that cannot be drawn: retry without limits
                    self.panels[panel] = Panel(self.panels[panel].size)
                    self.limits.pop(panel, None)
                    yield message_record(f"the {panel} cannot be drawn: {error_record(error)['text']}")
                    continue
                self.drawn_limits[panel] = picture_record["x"], picture_record["y"]
                yield {"kind": "picture", "panel": panel, **picture_record}
                break


DRAW_FUNCTIONS: dict[str, Callable[..., None]] = {
    "portrait": panels.draw_portrait,
    "trace": panels.draw_trace,
    "diagram": panels.draw_diagram,
    "plane": panels.draw_plane,
}


def draw_arguments(panel: str, page: PageState, results: Mapping[str, Any]) -> tuple[Any, ...] | None:
    """Return the arguments of the draw function of a panel; None if there is nothing to draw."""
    if panel == "diagram":
        branches = tuple(result for _, result in page_state.diagram_branches(page, results))
        parameter_value, attractors = (
            float(results[page.scene].parameter(page.parameter)),
            page_state.latest_result(page, results, "attractors"),
        )
        sweeps = tuple(page_state.diagram_sweeps(page, results))
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
        loci = tuple(result for _, result in page_state.plane_loci(page, results))
        names, bounds = (page.parameter, page.second), (page.bounds, page.second_bounds)
        return loci, page_state.plane_map(page, results), page_state.plane_margin(page, results), names, bounds
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
    parameter_values = [float(scene.parameter(name)) for name in (page.parameter, page.second)]
    branch_or_special = resolve_reference(page.chosen, results) if page.chosen else None
    y_values: list[float] = []
    if isinstance(branch_or_special, Special):
        branch = resolve_reference(page.chosen.rpartition(".special")[0], results)
        y_values = variable_columns(branch, page.variable)[branch_or_special.place].tolist()
    elif isinstance(branch_or_special, Branch) and page.place is not None:
        y_values = variable_columns(branch_or_special, page.variable)[page.place].tolist()
    elif isinstance(motion, Orbit) and page.variable in ("x", "v") and not motion.state.phase:
        y_values = [float(getattr(motion.state, page.variable))]
    return {
        "diagram": [[parameter_values[0], y_value] for y_value in y_values if np.isfinite(y_value)],
        "plane": [parameter_values],
    }


def _draw_on_axes(draw, arguments, ax):
    draw(ax, *arguments)


def _argument_cache_key(argument):
    """Return a key that is equal for equal arguments; results never change, so that their identity suffices."""
    if isinstance(argument, tuple):
        return tuple(map(_argument_cache_key, argument))
    return argument if isinstance(argument, str | float | int | bool | None) else id(argument)
