"""Figure 11: the response of figure 10 at four amplitudes, and which of them have a fold and a grazing."""

import numpy as np

from .. import plot
from ..loci.held_point import hold, move
from ..plot.style import COLOURS, SYMBOLS
from .closed import grazing
from .panels import Drawn, legend, panels, png, sheet, styled, trim
from .response import SHORT, marked, response

SHADES = tuple(COLOURS[k] for k in (0, 5, 7, 3))
CURVE = 40  # points of the fold's amplitude
FROM = 0.155  # the amplitude at which it begins: P100 grazes from 2 gamma sqrt(1 - gamma^2) = 0.1518 on

CAPTION = (
    "Above, the largest x on P100 and P111 against the drive's frequency at four amplitudes; below, the amplitude at "
    "which P111 begins in a saddle-node, and that at which P100 grazes. P100 and P111 exist together between them."
)


def drawn(file, progress):
    """Figure 11; it has no claims."""
    found = [(each.scene.make(), response(each.scene.make(), file.branch)) for each in panels(file)]
    with styled():
        return Drawn(_picture(file, found), CAPTION, ())


def edge(special, amplitudes):
    """(frequencies, amplitudes) at which a special point in frequency is, of those that it is followed to."""
    point, found = hold(special, ("amplitude",)), []
    for amplitude in amplitudes:
        point, share = move(point, [amplitude])
        if share < 1.0:
            break
        found.append((point.value, amplitude))
    return np.array(found).T


def _picture(file, found):
    figure, ((above,), (below,)) = sheet(2, 1, 2.9)
    folds = [(scene, one.fold) for scene, one in found if one.fold is not None]
    for colour, (scene, one) in zip(SHADES, found, strict=True):
        for branch in reversed(one.branches):
            plot.branch(marked(branch), "peak", above, colour)
        below.axhline(float(scene.amplitude), color=colour, linewidth=0.8)
        above.plot([], [], color=colour, label=f"{SYMBOLS['amplitude']} = {float(scene.amplitude):g}")
    above.set(ylim=(0.0, None))
    scene, fold = folds[0]
    own, top = float(scene.amplitude), 1.25 * max(float(scene.amplitude) for scene, _ in found)
    down, up = (edge(fold, np.linspace(own, last, CURVE)) for last in (FROM, top))
    below.plot(*np.hstack([down[:, ::-1], up]), color="black", label="saddle-node of P111")
    w = np.linspace(*file.branch.bounds, 400)
    below.plot(w, grazing(w, float(scene.damping)), color="black", linestyle=":", label="grazing of P100")
    below.set(xlim=above.get_xlim(), ylim=(0.0, top), xlabel=above.get_xlabel(), ylabel="drive amplitude $A$")
    places = np.array([[above], [below]])
    trim(places, ticks=9)
    above.set_ylabel(SHORT)
    below.set_ylabel("$A$")
    legend(figure, places, columns=3, without=("branch",))
    return png(figure)
