"""Reproduce figure 9: spring force and motion with compliant walls."""

import numpy as np

from ..maps.simulate import simulate
from ..orbits.find import find_orbit
from ..plot.style import COLOURS, COORDINATE_LABELS, TIME_LABEL, WALL_COLOUR
from ..scene.state import State
from .figure_panels import FigureResult, add_figure_legend, make_figure, panel_scene_files, png_bytes

N_SAMPLES, MAX_POSITION = 600, 1.5
LINE_STYLES = ("-", "--")
START_STATE = State(0.9, -1.1)

CAPTION = (
    "The compliant walls at -1 and 1, for two stiffnesses: the force of the springs against position, and the "
    "attractor in the phase plane and in time. Contact is shaded."
)


def reproduce_figure_9(scene_file, show_progress):
    """Reproduce figure 9; the paper makes no claims about it."""
    scene_motions = []
    for panel_scene_file in panel_scene_files(scene_file):
        scene = panel_scene_file.scene.make()
        orbit = find_orbit(scene, START_STATE)
        scene_motions.append((scene, simulate(scene, orbit.state, orbit.periods, N_SAMPLES)))
    return FigureResult(_figure_png(scene_motions), CAPTION, ())


def spring_force(scene, x):
    """Return the restoring force of the springs at the positions x (equation 39).

    The force is x, plus k2 (x - x_b) inside a wall at x_b. A positive force acts to the left.
    """
    spring_forces = np.array(x)
    for side_sign, wall in ((-1.0, scene.left), (1.0, scene.right)):
        wall_position, wall_stiffness = float(wall.position), float(wall.stiffness)
        spring_forces += side_sign * wall_stiffness * np.maximum(side_sign * (x - wall_position), 0.0)
    return spring_forces


def _figure_png(scene_motions):
    figure, axes_grid = make_figure(3, 1, 2.2)
    (force_ax,), (phase_ax,), (time_ax,) = axes_grid
    x = np.linspace(-MAX_POSITION, MAX_POSITION, N_SAMPLES + 1)
    for scene_index, (scene, motion_data) in enumerate(scene_motions):
        line_style = {"color": COLOURS[(0, 7)[scene_index]], "linestyle": LINE_STYLES[scene_index], "linewidth": 1.2}
        force_ax.plot(x, spring_force(scene, x), label=f"$k_2$ = {float(scene.right.stiffness):g}", **line_style)
        phase_ax.plot(motion_data["x"], motion_data["v"], **line_style)
        time_ax.plot(motion_data["time"] * float(scene.frequency) / (2.0 * np.pi), motion_data["x"], **line_style)
    for wall in (scene_motions[0][0].left, scene_motions[0][0].right):
        wall_position = float(wall.position)
        contact_range = sorted((wall_position, np.sign(wall_position) * MAX_POSITION))
        for ax in (force_ax, phase_ax):
            ax.axvspan(*contact_range, color=WALL_COLOUR, alpha=0.2, linewidth=0)
        time_ax.axhspan(*contact_range, color=WALL_COLOUR, alpha=0.2, linewidth=0)
    force_ax.set(xlim=(-MAX_POSITION, MAX_POSITION), xlabel=COORDINATE_LABELS["x"], ylabel=r"spring force$\,/\,(K d)$")
    phase_ax.set(xlim=(-MAX_POSITION, MAX_POSITION), xlabel=COORDINATE_LABELS["x"], ylabel=COORDINATE_LABELS["v"])
    time_ax.set(xlim=(0.0, 1.0), ylim=(-MAX_POSITION, MAX_POSITION), xlabel=TIME_LABEL, ylabel=COORDINATE_LABELS["x"])
    add_figure_legend(figure, axes_grid)
    return png_bytes(figure)
