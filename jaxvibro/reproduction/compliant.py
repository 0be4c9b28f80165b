"""Figure 9: the compliant wall: force against position, and what a motion in and out of contact looks like."""

import numpy as np

from ..maps.simulate import simulate
from ..orbits.find import find_orbit
from ..plot.style import COLOURS, COORDINATES, TIME_IN_PERIODS, WALL
from ..scene.state import State
from .panels import Drawn, legend, panels, png, sheet, styled

SAMPLES, FAR = 600, 1.5
LOOKS = ("-", "--")
START = State(0.9, -1.1)

CAPTION = (
    "The compliant walls at -1 and 1, for two stiffnesses: the force of the springs against position; the motion that "
    "the mass settles on in the phase plane; and in time. Shaded is where the mass is in contact."
)


def drawn(file, progress):
    """Figure 9; it has no claims."""
    found = []
    for each in panels(file):
        scene = each.scene.make()
        orbit = find_orbit(scene, START)
        found.append((scene, simulate(scene, orbit.state, orbit.periods, SAMPLES)))
    with styled():
        return Drawn(_picture(found), CAPTION, ())


def force(scene, x):
    """The force of the springs on the mass at x, towards 0: x, and k2 (x - x_b) within a wall (39)."""
    found = np.array(x)
    for sign, wall in ((-1.0, scene.left), (1.0, scene.right)):
        place, stiffness = float(wall.position), float(wall.stiffness)
        found += sign * stiffness * np.maximum(sign * (x - place), 0.0)
    return found


def _picture(found):
    figure, places = sheet(3, 1, 2.2)
    (pull,), (phase,), (trace,) = places
    x = np.linspace(-FAR, FAR, SAMPLES + 1)
    for k, (scene, motion) in enumerate(found):
        look = {"color": COLOURS[(0, 7)[k]], "linestyle": LOOKS[k], "linewidth": 1.2}
        pull.plot(x, force(scene, x), label=f"$k_2$ = {float(scene.right.stiffness):g}", **look)
        phase.plot(motion["x"], motion["v"], **look)
        trace.plot(motion["time"] * float(scene.frequency) / (2.0 * np.pi), motion["x"], **look)
    for side in (found[0][0].left, found[0][0].right):
        place = float(side.position)
        beyond = sorted((place, np.sign(place) * FAR))
        for ax in (pull, phase):
            ax.axvspan(*beyond, color=WALL, alpha=0.2, linewidth=0)
        trace.axhspan(*beyond, color=WALL, alpha=0.2, linewidth=0)
    pull.set(xlim=(-FAR, FAR), xlabel=COORDINATES["x"], ylabel=r"spring force$\,/\,(K d)$")
    phase.set(xlim=(-FAR, FAR), xlabel=COORDINATES["x"], ylabel=COORDINATES["v"])
    trace.set(xlim=(0.0, 1.0), ylim=(-FAR, FAR), xlabel=TIME_IN_PERIODS, ylabel=COORDINATES["x"])
    legend(figure, places)
    return png(figure)
