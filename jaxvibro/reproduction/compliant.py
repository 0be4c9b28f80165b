"""Reproduce figure 9: spring force and motion with compliant walls."""

import numpy as np

from ..maps.simulate import simulate
from ..orbits.find import find_orbit
from ..plot.style import COLOURS, COORDINATE_LABELS, TIME_LABEL, WALL_COLOUR
from ..scene.state import State
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes

N_SAMPLES, MAX_POSITION = 600, 1.5
LINE_STYLES = ("-", "--")
START_STATE = State(0.9, -1.1)

CAPTION = (
    "The compliant walls at -1 and 1, for two stiffnesses: the force of the springs against position, and the "
    "attractor in the phase plane and in time. Contact is shaded."
)


def reproduce_figure(file, progress):
    """Reproduce figure 9, which has no claims."""
    motions = []
    for panel_file in panel_files(file):
        scene = panel_file.scene.make()
        orbit = find_orbit(scene, START_STATE)
        motions.append((scene, simulate(scene, orbit.state, orbit.periods, N_SAMPLES)))
    with figure_style():
        return FigureResult(_picture(motions), CAPTION, ())


def spring_force(scene, x):
    """Return the restoring force of the springs on the mass at x: x, and k2 (x - x_b) inside a wall (39)."""
    forces = np.array(x)
    for sign, wall in ((-1.0, scene.left), (1.0, scene.right)):
        position, stiffness = float(wall.position), float(wall.stiffness)
        forces += sign * stiffness * np.maximum(sign * (x - position), 0.0)
    return forces


def _picture(motions):
    figure, axes_grid = make_figure(3, 1, 2.2)
    (force_ax,), (phase_ax,), (time_ax,) = axes_grid
    x = np.linspace(-MAX_POSITION, MAX_POSITION, N_SAMPLES + 1)
    for index, (scene, motion) in enumerate(motions):
        line_style = {"color": COLOURS[(0, 7)[index]], "linestyle": LINE_STYLES[index], "linewidth": 1.2}
        force_ax.plot(x, spring_force(scene, x), label=f"$k_2$ = {float(scene.right.stiffness):g}", **line_style)
        phase_ax.plot(motion["x"], motion["v"], **line_style)
        time_ax.plot(motion["time"] * float(scene.frequency) / (2.0 * np.pi), motion["x"], **line_style)
    for wall in (motions[0][0].left, motions[0][0].right):
        position = float(wall.position)
        contact_range = sorted((position, np.sign(position) * MAX_POSITION))
        for ax in (force_ax, phase_ax):
            ax.axvspan(*contact_range, color=WALL_COLOUR, alpha=0.2, linewidth=0)
        time_ax.axhspan(*contact_range, color=WALL_COLOUR, alpha=0.2, linewidth=0)
    force_ax.set(xlim=(-MAX_POSITION, MAX_POSITION), xlabel=COORDINATE_LABELS["x"], ylabel=r"spring force$\,/\,(K d)$")
    phase_ax.set(xlim=(-MAX_POSITION, MAX_POSITION), xlabel=COORDINATE_LABELS["x"], ylabel=COORDINATE_LABELS["v"])
    time_ax.set(xlim=(0.0, 1.0), ylim=(-MAX_POSITION, MAX_POSITION), xlabel=TIME_LABEL, ylabel=COORDINATE_LABELS["x"])
    add_legend(figure, axes_grid)
    return png_bytes(figure)
