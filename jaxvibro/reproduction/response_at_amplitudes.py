"""Reproduce figure 11: the frequency response at four drive amplitudes, with saddle-nodes and grazings."""

import numpy as np

from .. import plot
from ..loci.point_continuation import continue_to_values, make_continued_point
from ..plot.style import COLOURS, SYMBOLS
from .closed_forms import grazing_amplitude
from .figure_panels import (
    FigureResult,
    add_figure_legend,
    make_figure,
    panel_scene_files,
    png_bytes,
    trim_axis_labels,
)
from .frequency_response import PEAK_LABEL, frequency_response, keep_folds_and_grazings

CURVE_COLOURS = tuple(COLOURS[k] for k in (0, 5, 7, 3))
N_CURVE_POINTS = 40  # points of the curve of the saddle-node
LOWEST_AMPLITUDE = 0.155  # start of this curve; P100 grazes above 2 gamma sqrt(1 - gamma^2) = 0.1518

CAPTION = (
    "Above, the largest x on P100 and P111 against the drive frequency at four amplitudes; below, the amplitudes of "
    "the saddle-node of P111 and of the grazing of P100. P100 and P111 coexist between them."
)


def reproduce_figure_11(scene_file, show_progress):
    """Reproduce figure 11; the paper makes no claims about it."""
    scene_responses = [
        (panel_scene_file.scene.make(), frequency_response(panel_scene_file.scene.make(), scene_file.branch))
        for panel_scene_file in panel_scene_files(scene_file)
    ]
    return FigureResult(_figure_png(scene_file, scene_responses), CAPTION, ())


def trace_special_point(special_point, amplitudes):
    """Continue a special point in the amplitude and return the curve as (frequencies, amplitudes).

    The curve ends at the last of the `amplitudes` at which the special point exists.
    """
    continued_point, curve_points = make_continued_point(special_point, ("amplitude",)), []
    for amplitude in amplitudes:
        continued_point, move_fraction = continue_to_values(continued_point, [amplitude])
        if move_fraction < 1.0:
            break
        curve_points.append((continued_point.value, amplitude))
    return np.array(curve_points).T


def _figure_png(scene_file, scene_responses):
    figure, ((upper_ax,), (lower_ax,)) = make_figure(2, 1, 2.9)
    scene_folds = [(scene, response.fold) for scene, response in scene_responses if response.fold is not None]
    for colour, (scene, response) in zip(CURVE_COLOURS, scene_responses, strict=True):
        for branch in reversed(response.branches):
            plot.branch(keep_folds_and_grazings(branch), "peak", upper_ax, colour)
        lower_ax.axhline(float(scene.amplitude), color=colour, linewidth=0.8)
        upper_ax.plot([], [], color=colour, label=f"{SYMBOLS['amplitude']} = {float(scene.amplitude):g}")
    upper_ax.set(ylim=(0.0, None))
    scene, fold_point = scene_folds[0]
    start_amplitude, max_amplitude = (
        float(scene.amplitude),
        1.25 * max(float(scene.amplitude) for scene, _ in scene_responses),
    )
    lower_curve, upper_curve = (
        trace_special_point(fold_point, np.linspace(start_amplitude, end_amplitude, N_CURVE_POINTS))
        for end_amplitude in (LOWEST_AMPLITUDE, max_amplitude)
    )
    lower_ax.plot(*np.hstack([lower_curve[:, ::-1], upper_curve]), color="black", label="saddle-node of P111")
    grazing_frequencies = np.linspace(*scene_file.branch.bounds, 400)
    lower_ax.plot(
        grazing_frequencies,
        grazing_amplitude(grazing_frequencies, float(scene.damping)),
        color="black",
        linestyle=":",
        label="grazing of P100",
    )
    lower_ax.set(
        xlim=upper_ax.get_xlim(), ylim=(0.0, max_amplitude), xlabel=upper_ax.get_xlabel(), ylabel="drive amplitude $A$"
    )
    axes_grid = np.array([[upper_ax], [lower_ax]])
    trim_axis_labels(axes_grid, max_ticks=9)
    upper_ax.set_ylabel(PEAK_LABEL)
    lower_ax.set_ylabel("$A$")
    add_figure_legend(figure, axes_grid, n_columns=3, excluded_artist_ids=("branch",))
    return png_bytes(figure)
