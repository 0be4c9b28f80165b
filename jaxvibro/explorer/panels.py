"""The pictures of the page, by `jv.plot`: each a PNG, and where its axes lie in it."""

import base64
import io
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from .. import plot
from ..attractors.find import Attractor
from ..branches.branch import Branch
from ..design.margin import Margin
from ..loci.locus import Locus
from ..maps.simulate import simulate
from ..orbits.orbit import Orbit
from ..plot.style import VARIABLES, label
from ..scene.scene import Scene

DPI = 100
LEAST, MOST = 120, 4000  # pixels of a side
SAMPLES = 200  # of a drive period
AT_MOST = 12  # entries of a legend
MARGINS = {"left": 74, "right": 12, "bottom": 52, "top": 24}  # pixels at a ratio of 1
Draw = Callable[[Axes], object]
_drawing = threading.Lock()  # matplotlib reads formulas in one thread at a time


class Size(NamedTuple):
    """Of a panel: width and height in pixels of the page, and how many pixels of the screen one of them is."""

    width: float
    height: float
    ratio: float


class Limits(NamedTuple):
    """Of the axes of a panel, None: as the picture has them."""

    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None


class Panel:
    """The figure of one panel, kept from picture to picture: making axes anew takes longer than all that is in them."""

    def __init__(self, size: Size) -> None:
        self.size = size
        ratio = min(max(size.ratio, 0.5), 4.0)
        width, height = (min(max(side, LEAST), MOST / ratio) for side in (size.width, size.height))
        self._figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI * ratio)
        self._canvas = FigureCanvasAgg(self._figure)
        left, right = MARGINS["left"] / width, 1.0 - MARGINS["right"] / width
        bottom, top = MARGINS["bottom"] / height, 1.0 - MARGINS["top"] / height
        self._ax = self._figure.add_axes((left, bottom, right - left, top - bottom))
        self._empty: Any = None  # the axes' picture without what is in them, and their limits

    def picture(self, draw: Draw, limits: Limits, moving: bool = False) -> dict[str, Any]:
        """What the page is told: png, a text; box, the axes' left, top, width and height as parts of the picture's; x,
        y: their limits. draw: is given the Axes. moving: with the axes of the last picture, if all keeps within them.
        """
        with _drawing:
            self._clear()
            draw(self._ax)
            if not moving:
                _limit(self._ax, limits)
                self._canvas.draw()
                self._empty = None
            else:
                self._draw_moving(limits)
            content = io.BytesIO()
            Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB").save(
                content, "png", compress_level=1
            )
            box = self._ax.get_position()
            return {
                "png": base64.b64encode(content.getvalue()).decode(),
                "box": [box.x0, 1.0 - box.y1, box.width, box.height],
                "x": list(map(float, self._ax.get_xlim())),
                "y": list(map(float, self._ax.get_ylim())),
            }

    def _draw_moving(self, limits):
        """Draws what is in the axes over their picture without it, which is kept as long as all keeps within them."""
        if self._empty is None or not self._keeps_within(self._empty):
            _limit(self._ax, limits)
            inner = self._inner()
            for artist in inner:
                artist.set_visible(False)
            self._canvas.draw()
            self._empty = (
                self._canvas.copy_from_bbox(self._figure.bbox),
                self._ax.get_xlim(),
                self._ax.get_ylim(),
            )
            for artist in inner:
                artist.set_visible(True)
        region, across, up = self._empty
        self._ax.set(xlim=across, ylim=up)
        self._canvas.restore_region(region)
        for artist in sorted(self._inner(), key=lambda one: one.get_zorder()):
            self._ax.draw_artist(artist)

    def _clear(self):
        """Takes all out of the axes, and lets their limits follow what comes."""
        ax = self._ax
        legend = ax.get_legend()
        for artist in (*self._inner(), *([legend] if legend else ())):
            artist.remove()
        for child in ax.child_axes[:]:
            child.remove()
        ax.set_prop_cycle(None)
        ax.set_title("")
        ax.relim()
        ax.margins(0.05)
        ax.autoscale(True)

    def _inner(self):
        ax = self._ax
        return [*ax.images, *ax.collections, *ax.patches, *ax.lines, *ax.texts]

    def _keeps_within(self, known):
        (_, across, up), found = known, self._ax.dataLim
        return across[0] <= found.x0 and found.x1 <= across[1] and up[0] <= found.y0 and found.y1 <= up[1]


def _limit(ax, limits):
    if limits.x is not None:
        ax.set_xlim(limits.x)
    if limits.y is not None:
        ax.set_ylim(limits.y)


def exported(draw: Draw, limits: Limits, kind: str) -> bytes:
    """The picture as a file of a kind: "png", "svg" or "pdf"."""
    with _drawing:
        figure = Figure(figsize=(7.0, 5.0), dpi=200, layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        draw(ax)
        _limit(ax, limits)
        content = io.BytesIO()
        figure.savefig(content, format=kind)
    return content.getvalue()


def diagram(
    ax: Axes,
    branches: Sequence[Branch],
    swept: Sequence[xr.Dataset],
    attractors: tuple[Attractor, ...],
    value: float,
    name: str,
    bounds: Sequence[float],
    variable: str,
) -> None:
    """Branches along a parameter, over what was swept, and attractors at its value."""
    for one in swept if variable in ("x", "v") else ():
        plot.diagram(one, variable, ax, faint=bool(branches))
    for curve in branches:
        plot.branch(curve, variable, ax)
    if attractors and variable in ("x", "v"):
        plot.mark(attractors, value, variable, ax)
    if not branches:
        ax.set(xlabel=label(name), ylabel=VARIABLES[variable])
    if not branches and not swept:
        ax.text(0.5, 0.5, "no branch of this scene yet", transform=ax.transAxes, ha="center", color="0.4")
    ax.set_xlim(*bounds)
    _legend(ax)


def plane(
    ax: Axes,
    loci: Sequence[Locus],
    mapped: xr.Dataset | None,
    near: Margin | None,
    names: Sequence[str],
    bounds: Sequence[Sequence[float]],
) -> None:
    """Loci in two parameters, over a map."""
    if mapped is not None:
        plot.map(mapped, ax)
    cells = _entries(ax)
    for one in loci:
        plot.locus(one, ax)
    if near is not None:
        plot.margin(near, ax)
    if not loci and mapped is None and near is None:
        ax.set(xlabel=label(names[0]), ylabel=label(names[1]))
    ax.set_xlim(*bounds[0])
    ax.set_ylim(*bounds[1])
    _legend(ax, cells)


def portrait(ax: Axes, one: Orbit | xr.Dataset, scene: Scene, stable: bool, basins: xr.Dataset | None) -> None:
    """An orbit, or a motion that is none, in the phase plane, over basins."""
    if basins is not None:
        plot.basins(basins, ax)
    cells = _entries(ax)
    plot.portrait(motion_of(one), scene, ax, stable)
    if basins is not None:
        _legend(ax, cells)


def trace(ax: Axes, one: Orbit | xr.Dataset, scene: Scene) -> None:
    """The same against time."""
    plot.trace(motion_of(one), scene, ax)


def motion_of(one: Orbit | xr.Dataset) -> xr.Dataset:
    """The trajectory that is drawn."""
    return simulate(one.scene, one.state, one.periods, SAMPLES) if isinstance(one, Orbit) else one


def _entries(ax):
    """(handles, labels) of the legend that a picture has made below its axes, where the page has no room for it."""
    made = ax.get_legend()
    return ([], []) if made is None else (made.legend_handles, [text.get_text() for text in made.get_texts()])


def _legend(ax, more=((), ())):
    handles, labels = ([*own, *others] for own, others in zip(ax.get_legend_handles_labels(), more, strict=True))
    if len(labels) > AT_MOST:
        handles, labels = handles[:AT_MOST], [*labels[: AT_MOST - 1], f"and {len(labels) - AT_MOST + 1} more"]
    if labels:
        ax.legend(handles, labels, fontsize="x-small", loc="upper left", framealpha=0.7)
