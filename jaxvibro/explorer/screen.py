"""What a page has on its screen: the sizes and limits of its panels, and which pictures are there already."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..branches.branch import Branch, Special
from ..branches.curves import columns_of
from ..orbits.orbit import Orbit
from . import panels, shown
from .complaints import complaint, told
from .lines import resolved
from .panels import Limits, Panel
from .shown import Shown

ORDER = ("portrait", "trace", "diagram", "plane")
FAST = ("portrait",)  # drawn while a slider moves


class Screen:
    """The panels of one page."""

    def __init__(self) -> None:
        self.panels: dict[str, Panel] = {}
        self.limits: dict[str, Limits] = {}
        self.boxes: dict[str, tuple[list[float], list[float]]] = {}
        self.drawn: dict[str, Any] = {}  # (key, parts) of each panel: what a key names is not to be lost

    def forget(self) -> None:
        """All is to be drawn anew."""
        self.limits.clear()
        self.drawn.clear()

    def box(self, panel: str, now: Shown) -> tuple[Any, Any]:
        """The limits of a panel's axes, across and up; before it has been drawn what is asked for."""
        return self.boxes.get(panel, (now.bounds, now.second_bounds))

    def pictures(self, now: Shown, results: Mapping[str, Any], fast: bool) -> Iterator[dict[str, Any]]:
        """What the page is to be told of each panel that is to look otherwise. fast: of the portrait alone."""
        for panel in FAST if fast else ORDER:
            if panel not in self.panels:
                continue
            parts = parts_of(panel, now, results)
            for limits in dict.fromkeys((self.limits.get(panel, Limits()), Limits())):
                key = parts and (*map(_key, parts), self.panels[panel].size, limits)
                if parts is None or key == self.drawn.get(panel, (None,))[0]:
                    break
                self.drawn[panel] = key, parts
                try:
                    found = self.panels[panel].picture(partial(_draw, DRAW[panel], parts), limits, fast)
                except Exception as error:  # of numbers that cannot be drawn; then with other limits, or not at all
                    self.panels[panel] = Panel(self.panels[panel].size)
                    self.limits.pop(panel, None)
                    yield told(f"the {panel} cannot be drawn: {complaint(error)['text']}")
                    continue
                self.boxes[panel] = found["x"], found["y"]
                yield {"kind": "picture", "panel": panel, **found}
                break


DRAW: dict[str, Callable[..., None]] = {
    "portrait": panels.portrait,
    "trace": panels.trace,
    "diagram": panels.diagram,
    "plane": panels.plane,
}


def parts_of(panel: str, now: Shown, results: Mapping[str, Any]) -> tuple[Any, ...] | None:
    """What a panel's picture is made of, None where there is nothing to draw."""
    if panel == "diagram":
        curves = tuple(one for _, one in shown.branches(now, results))
        value, found = float(results[now.scene].parameter(now.parameter)), shown.latest(now, results, "attractors")
        swept = tuple(shown.swept(now, results))
        return curves, swept, found or (), value if found else 0.0, now.parameter, now.bounds, now.variable
    if panel == "plane":
        loci = tuple(one for _, one in shown.loci(now, results))
        names, bounds = (now.parameter, now.second), (now.bounds, now.second_bounds)
        return loci, shown.mapped(now, results), shown.near(now, results), names, bounds
    one = results.get(now.current)
    if one is None:
        return None
    scene = one.scene if isinstance(one, Orbit) else results[now.scene]
    if panel == "trace":
        return one, scene
    return one, scene, isinstance(one, Orbit) and one.stable, shown.latest(now, results, "basins")


def marks(now: Shown, results: Mapping[str, Any]) -> dict[str, list[list[float]]]:
    """Where in the diagram and in the plane what is shown lies: {panel: [[across, up], ...]}."""
    scene, one = results[now.scene], results.get(now.current)
    here = [float(scene.parameter(name)) for name in (now.parameter, now.second)]
    chosen = resolved(now.chosen, results) if now.chosen else None
    up: list[float] = []
    if isinstance(chosen, Special):
        curve = resolved(now.chosen.rpartition(".special")[0], results)
        up = columns_of(curve, now.variable)[chosen.place].tolist()
    elif isinstance(chosen, Branch) and now.place is not None:
        up = columns_of(chosen, now.variable)[now.place].tolist()
    elif isinstance(one, Orbit) and now.variable in ("x", "v") and not one.state.phase:
        up = [float(getattr(one.state, now.variable))]
    return {"diagram": [[here[0], each] for each in up if np.isfinite(each)], "plane": [here]}


def _draw(draw, parts, ax):
    draw(ax, *parts)


def _key(part):
    """Equal where a part would be drawn alike: results are never changed."""
    if isinstance(part, tuple):
        return tuple(map(_key, part))
    return part if isinstance(part, str | float | int | bool | None) else id(part)
