"""The picture of a run: the swept diagram with the attractors in it, or portraits where nothing was swept."""

import math
from io import BytesIO

from matplotlib.figure import Figure

from . import plot
from .check import SceneError
from .plot import style
from .scene import SIDES
from .simulate import simulate
from .state import State
from .stretch import recurrence

DOTS = 200  # per inch
MOST = 9  # portraits
ROAMED = 40  # drive periods drawn of a motion that does not recur
SAMPLES = 400  # of a drive period


def picture(found):
    """The picture of what was `Found`, as a PNG's bytes."""
    figure = _diagram(found) if found.file.sweep is not None else _portraits(found)
    figure.suptitle(_heading(found), fontsize="medium")
    held = BytesIO()
    figure.savefig(held, format="png", dpi=DOTS)
    return held.getvalue()


def _diagram(found):
    figure = Figure(figsize=(7.5, 8.0), layout="constrained")
    both = figure.subplots(2, 1, sharex=True)
    for ax, variable in zip(both, "xv", strict=True):
        plot.diagram(found.swept, variable, ax)
        if found.mark is not None:
            plot.mark(found.attractors, found.mark, variable, ax)
        ax.label_outer()
    figure.legend(*both[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _portraits(found):
    motions = list(_motions(found))[:MOST]
    columns = max(1, math.isqrt(max(0, len(motions) - 1)) + 1)
    rows = max(1, -(-len(motions) // columns))
    figure = Figure(figsize=(1 + 4.0 * columns, 0.5 + 3.7 * rows), layout="constrained")
    for place, (title, state, periods) in enumerate(motions, 1):
        ax = figure.add_subplot(rows, columns, place)
        try:
            plot.portrait(simulate(found.there, state, periods, SAMPLES), found.there, ax)
        except SceneError as error:  # too many impacts to draw
            ax.text(0.5, 0.5, style.plain(str(error)), wrap=True, ha="center", va="center")
        ax.set_title(title, fontsize="medium")
    return figure


def _motions(found):
    """(title, state, drive periods) of each motion that there is to draw."""
    for one in found.attractors or ():
        if one.kind != "unresolved":
            yield f"{one.label}, {100 * one.share:.1f} % of starts", one.state, one.periods or ROAMED
    if found.attractors is None:
        n, last = int(recurrence(found.swept)[0, 0]), found.swept.isel(step=0, leg=0, period=-1)
        if n >= 0:
            yield "from rest, settled", State(float(last["x"]), float(last["v"])), n or ROAMED


def _heading(found):
    """The scene in a line or two, but for what is swept."""
    scene = found.there
    swept = None if found.file.sweep is None else found.file.sweep.parameter
    plain = [f"{sign} = {float(scene.parameter(name)):g}" for name, sign in style.SYMBOLS.items() if name != swept]
    walls = [_wall(scene, side, swept) for side in SIDES if getattr(scene, side) is not None]
    return ",  ".join(plain) + "\n" + (",  ".join(walls) or "no walls") + ";  states at phase 0 of the drive"


def _wall(scene, side, swept):
    told, wall = f"{side} wall", getattr(scene, side)
    if swept != f"{side}.position":
        told += f" at {float(wall.position):g}"
    if wall.restitution is not None and swept != f"{side}.restitution":
        told += f" with $R$ = {float(wall.restitution):g}"
    return told if wall.motion is None else told + ", moving"
