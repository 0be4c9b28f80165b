"""Reproduce figure 11: the response of figure 10 at four amplitudes, with saddle-nodes and grazings."""

import numpy as np

from .. import plot
from ..loci.point_continuation import continue_point, prepare_point
from ..plot.style import COLOURS, SYMBOLS
from .closed_forms import grazing_amplitude
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes, trim_labels
from .response import PEAK_LABEL, frequency_response, select_special_points

CURVE_COLOURS = tuple(COLOURS[k] for k in (0, 5, 7, 3))
CURVE_POINTS = 40  # points of the curve of the saddle-node
LOWEST_AMPLITUDE = 0.155  # start of this curve; P100 grazes above 2 gamma sqrt(1 - gamma^2) = 0.1518

CAPTION = (
    "Above, the largest x on P100 and P111 against the drive frequency at four amplitudes; below, the amplitudes of "
    "the saddle-node of P111 and of the grazing of P100. P100 and P111 coexist between them."
)


def reproduce_figure(file, progress):
    """Reproduce figure 11, which has no claims."""
    responses = [
        (panel_file.scene.make(), frequency_response(panel_file.scene.make(), file.branch))
        for panel_file in panel_files(file)
    ]
    with figure_style():
        return FigureResult(_picture(file, responses), CAPTION, ())


def trace_special_point(special, amplitudes):
    """Return (frequencies, amplitudes) of a special point in frequency, up to the last amplitude at which it exists."""
    point, curve_points = prepare_point(special, ("amplitude",)), []
    for amplitude in amplitudes:
        point, fraction = continue_point(point, [amplitude])
        if fraction < 1.0:
            break
        curve_points.append((point.value, amplitude))
    return np.array(curve_points).T


def _picture(file, responses):
    figure, ((upper_ax,), (lower_ax,)) = make_figure(2, 1, 2.9)
    folds = [(scene, response.fold) for scene, response in responses if response.fold is not None]
    for colour, (scene, response) in zip(CURVE_COLOURS, responses, strict=True):
        for branch in reversed(response.branches):
            plot.branch(select_special_points(branch), "peak", upper_ax, colour)
        lower_ax.axhline(float(scene.amplitude), color=colour, linewidth=0.8)
        upper_ax.plot([], [], color=colour, label=f"{SYMBOLS['amplitude']} = {float(scene.amplitude):g}")
    upper_ax.set(ylim=(0.0, None))
    scene, fold = folds[0]
    scene_amplitude, max_amplitude = (
        float(scene.amplitude),
        1.25 * max(float(scene.amplitude) for scene, _ in responses),
    )
    lower_part, upper_part = (
        trace_special_point(fold, np.linspace(scene_amplitude, end_amplitude, CURVE_POINTS))
        for end_amplitude in (LOWEST_AMPLITUDE, max_amplitude)
    )
    lower_ax.plot(*np.hstack([lower_part[:, ::-1], upper_part]), color="black", label="saddle-node of P111")
    frequencies = np.linspace(*file.branch.bounds, 400)
    lower_ax.plot(
        frequencies,
        grazing_amplitude(frequencies, float(scene.damping)),
        color="black",
        linestyle=":",
        label="grazing of P100",
    )
    lower_ax.set(
        xlim=upper_ax.get_xlim(), ylim=(0.0, max_amplitude), xlabel=upper_ax.get_xlabel(), ylabel="drive amplitude $A$"
    )
    axes_grid = np.array([[upper_ax], [lower_ax]])
    trim_labels(axes_grid, max_ticks=9)
    upper_ax.set_ylabel(PEAK_LABEL)
    lower_ax.set_ylabel("$A$")
    add_legend(figure, axes_grid, columns=3, excluded_gids=("branch",))
    return png_bytes(figure)
