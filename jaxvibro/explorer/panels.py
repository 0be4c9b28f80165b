"""Draw the figures of a page with `jv.plot` as PNG images, with the position of their axes."""

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
from ..design.margin_result import Margin
from ..loci.locus import Locus
from ..maps.simulate import simulate
from ..orbits.orbit import Orbit
from ..plot.style import VARIABLE_LABELS, parameter_label
from ..scene.scene import Scene

DPI = 100
MIN_SIDE, MAX_SIDE = 120, 4000  # pixels of a side
SAMPLES_PER_PERIOD = 200  # samples per drive period
MAX_LEGEND_ENTRIES = 12  # entries in a legend
MARGINS = {"left": 74, "right": 12, "bottom": 52, "top": 24}  # pixels at a ratio of 1
DrawFunction = Callable[[Axes], object]
_drawing_lock = threading.Lock()  # matplotlib parses formulas in one thread at a time


class PanelSize(NamedTuple):
    """Size of a panel.

    Attributes
    ----------
    width : float
        Width in page pixels.
    height : float
        Height in page pixels.
    ratio : float
        Number of screen pixels per page pixel.
    """

    width: float
    height: float
    ratio: float


class AxisLimits(NamedTuple):
    """Limits of the axes of a panel; None keeps those of the figure."""

    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None


class Panel:
    """Figure of one panel, reused for each drawing because making axes takes longer than drawing their content."""

    def __init__(self, size: PanelSize) -> None:
        self.size = size
        ratio = min(max(size.ratio, 0.5), 4.0)
        width, height = (
            min(max(side_in_page_pixels, MIN_SIDE), MAX_SIDE / ratio)
            for side_in_page_pixels in (size.width, size.height)
        )
        self._figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI * ratio)
        self._canvas = FigureCanvasAgg(self._figure)
        axes_left, axes_right = MARGINS["left"] / width, 1.0 - MARGINS["right"] / width
        axes_bottom, axes_top = MARGINS["bottom"] / height, 1.0 - MARGINS["top"] / height
        self._ax = self._figure.add_axes((axes_left, axes_bottom, axes_right - axes_left, axes_top - axes_bottom))
        self._background: Any = None  # image of the empty axes, and their limits

    def render(self, draw_content: DrawFunction, limits: AxisLimits, is_dragging: bool = False) -> dict[str, Any]:
        """Draw the panel and return its record for the page.

        Parameters
        ----------
        draw_content : callable
            Function that draws into Axes.
        limits : AxisLimits
            Limits of the axes.
        is_dragging : bool, optional
            Reuse the axes of the last figure if the content lies inside them.

        Returns
        -------
        dict
            ``png``: the encoded image; ``box``: left, top, width and height of the axes relative to the image; ``x``
            and ``y``: limits of the axes.
        """
        with _drawing_lock:
            self._clear_axes()
            draw_content(self._ax)
            if not is_dragging:
                _apply_limits(self._ax, limits)
                self._canvas.draw()
                self._background = None
            else:
                self._draw_over_background(limits)
            buffer = io.BytesIO()
            Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB").save(buffer, "png", compress_level=1)
            relative_axes_box = self._ax.get_position()
            return {
                "png": base64.b64encode(buffer.getvalue()).decode(),
                "box": [
                    relative_axes_box.x0,
                    1.0 - relative_axes_box.y1,
                    relative_axes_box.width,
                    relative_axes_box.height,
                ],
                "x": list(map(float, self._ax.get_xlim())),
                "y": list(map(float, self._ax.get_ylim())),
            }

    def _draw_over_background(self, limits):
        """Draw the content over an image of the empty axes, which is reused while the content lies inside them."""
        if self._background is None or not self._content_fits_within(self._background):
            _apply_limits(self._ax, limits)
            artists = self._content_artists()
            for artist in artists:
                artist.set_visible(False)
            self._canvas.draw()
            self._background = (
                self._canvas.copy_from_bbox(self._figure.bbox),
                self._ax.get_xlim(),
                self._ax.get_ylim(),
            )
            for artist in artists:
                artist.set_visible(True)
        background_pixels, x_limits, y_limits = self._background
        self._ax.set(xlim=x_limits, ylim=y_limits)
        self._canvas.restore_region(background_pixels)
        for artist in sorted(self._content_artists(), key=lambda artist: artist.get_zorder()):
            self._ax.draw_artist(artist)

    def _clear_axes(self):
        """Remove the content of the axes and restore automatic limits."""
        ax = self._ax
        legend = ax.get_legend()
        for artist in (*self._content_artists(), *([legend] if legend else ())):
            artist.remove()
        for inset_axes in ax.child_axes[:]:
            inset_axes.remove()
        ax.set_prop_cycle(None)
        ax.set_title("")
        ax.relim()
        ax.margins(0.05)
        ax.autoscale(True)

    def _content_artists(self):
        ax = self._ax
        return [*ax.images, *ax.collections, *ax.patches, *ax.lines, *ax.texts]

    def _content_fits_within(self, background):
        (_, x_limits, y_limits), data_limits = background, self._ax.dataLim
        return (
            x_limits[0] <= data_limits.x0
            and data_limits.x1 <= x_limits[1]
            and y_limits[0] <= data_limits.y0
            and data_limits.y1 <= y_limits[1]
        )


def _apply_limits(ax, limits):
    if limits.x is not None:
        ax.set_xlim(limits.x)
    if limits.y is not None:
        ax.set_ylim(limits.y)


def export_picture(draw_content: DrawFunction, limits: AxisLimits, file_format: str) -> bytes:
    """Return a figure as a file of format "png", "svg" or "pdf"."""
    with _drawing_lock:
        figure = Figure(figsize=(7.0, 5.0), dpi=200, layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        draw_content(ax)
        _apply_limits(ax, limits)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=file_format)
    return buffer.getvalue()


def draw_diagram(
    ax: Axes,
    branches: Sequence[Branch],
    sweeps: Sequence[xr.Dataset],
    attractors: tuple[Attractor, ...],
    parameter_value: float,
    parameter: str,
    bounds: Sequence[float],
    variable: str,
) -> None:
    """Draw branches along a parameter over sweeps, and attractors at the current value of the parameter."""
    for sweep in sweeps if variable in ("x", "v") else ():
        plot.diagram(sweep, variable, ax, faint=bool(branches))
    for branch in branches:
        plot.branch(branch, variable, ax)
    if attractors and variable in ("x", "v"):
        plot.mark(attractors, parameter_value, variable, ax)
    if not branches:
        ax.set(xlabel=parameter_label(parameter), ylabel=VARIABLE_LABELS[variable])
    if not branches and not sweeps:
        ax.text(0.5, 0.5, "no branch computed yet", transform=ax.transAxes, ha="center", color="0.4")
    ax.set_xlim(*bounds)
    _add_legend(ax)


def draw_plane(
    ax: Axes,
    loci: Sequence[Locus],
    map_data: xr.Dataset | None,
    margin: Margin | None,
    parameter_names: Sequence[str],
    bounds: Sequence[Sequence[float]],
) -> None:
    """Draw loci in two parameters over a map, with a margin."""
    if map_data is not None:
        plot.map(map_data, ax)
    map_legend_entries = _legend_entries(ax)
    for locus in loci:
        plot.locus(locus, ax)
    if margin is not None:
        plot.margin(margin, ax)
    if not loci and map_data is None and margin is None:
        ax.set(xlabel=parameter_label(parameter_names[0]), ylabel=parameter_label(parameter_names[1]))
    ax.set_xlim(*bounds[0])
    ax.set_ylim(*bounds[1])
    _add_legend(ax, map_legend_entries)


def draw_portrait(
    ax: Axes, motion: Orbit | xr.Dataset, scene: Scene, is_stable: bool, basins: xr.Dataset | None
) -> None:
    """Draw an orbit or another motion in the phase plane, over basins."""
    if basins is not None:
        plot.basins(basins, ax)
    basin_legend_entries = _legend_entries(ax)
    plot.portrait(trajectory_of_motion(motion), scene, ax, is_stable)
    if basins is not None:
        _add_legend(ax, basin_legend_entries)


def draw_trace(ax: Axes, motion: Orbit | xr.Dataset, scene: Scene) -> None:
    """Draw an orbit or another motion against time."""
    plot.trace(trajectory_of_motion(motion), scene, ax)


def trajectory_of_motion(motion: Orbit | xr.Dataset) -> xr.Dataset:
    """Return the trajectory of an orbit, or the motion itself."""
    return (
        simulate(motion.scene, motion.state, motion.periods, SAMPLES_PER_PERIOD)
        if isinstance(motion, Orbit)
        else motion
    )


def _legend_entries(ax):
    """Return (handles, labels) of the legend below the axes, for which the page has no room."""
    legend = ax.get_legend()
    return ([], []) if legend is None else (legend.legend_handles, [text.get_text() for text in legend.get_texts()])


def _add_legend(ax, extra_entries=((), ())):
    handles, labels = (
        [*axes_legend_items, *extra_legend_items]
        for axes_legend_items, extra_legend_items in zip(ax.get_legend_handles_labels(), extra_entries, strict=True)
    )
    if len(labels) > MAX_LEGEND_ENTRIES:
        handles, labels = (
            handles[:MAX_LEGEND_ENTRIES],
            [*labels[: MAX_LEGEND_ENTRIES - 1], f"and {len(labels) - MAX_LEGEND_ENTRIES + 1} more"],
        )
    if labels:
        ax.legend(handles, labels, fontsize="x-small", loc="upper left", framealpha=0.7)
