"""The pictures of a run: the diagram of what was swept or followed, with attractors and orbits in it, or portraits; and
the loci."""

import math
from functools import partial
from io import BytesIO

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import plot
from ..attractors.shares import share_text
from ..loci.bistability import coexistences
from ..loci.loci import image
from ..maps.initial_conditions import box_text
from ..maps.simulate import simulate
from ..output.units import FORCE, LENGTH, amount_text
from ..plot import style
from ..plot.locus import name as of_locus
from ..plot.orbit import title
from ..scene.check import ArgumentError
from ..scene.named_forces import named
from ..scene.state import State
from .sweep_periods import recurrence

DOTS = 170  # per inch
MOST = 9  # portraits
WIDE = 6.5  # inches: a heading is as wide
ROWS = 8  # of a legend's columns
ROAMED = 40  # drive periods drawn of a motion that does not recur
SAMPLES = 400  # of a drive period


def picture(found, units="scene"):
    """The picture of what was `Found`, in "scene" or "physical" units, as a PNG's bytes."""
    figure = _diagram(found, units) if found.across is not None else _portraits(found, units)
    figure.suptitle(_heading(found, units), fontsize="medium")
    return png(figure)


def loci(found, units="scene"):
    """The picture of the loci that were `Found`, likewise; mirror images on one curve are drawn as one."""
    asked, scene = found.file.locus, found.there(found.file.followed)
    figure = Figure(figsize=(9.5, 6.5), layout="constrained")
    ax = figure.subplots()
    kept, twins = [], set()
    for one in sorted(found.loci, key=lambda one: asked.kinds.index(one.kind)):
        other = image(one, kept)
        if other is None:
            kept.append(one)
            plot.locus(one, ax, units=units)
        else:
            twins.add(of_locus(other))
    for pair in coexistences(found.branches, kept):
        plot.region(*pair, ax, units=units)
    scales = style.scales_of(scene, units)
    for which, name in zip("xy", asked.parameters, strict=True):
        axis = style.of_parameter(scales, name)
        limits = [axis.size * bound for bound in asked.bounds[name]]
        ax.set(**{f"{which}label": axis.label, f"{which}lim": limits})
    entries = zip(*ax.get_legend_handles_labels(), strict=True)
    entries = [(handle, f"{text} and mirror image" if text in twins else text) for handle, text in entries]
    entries.sort(key=lambda one: one[0].get_gid() == "codimension two")
    if entries:
        look = {"frameon": False, "fontsize": "small", "handlelength": 4.0}
        figure.legend(*zip(*entries, strict=True), loc="outside right upper", **look)
    figure.suptitle(described(scene, asked.parameters, units), fontsize="medium")
    return png(figure)


def margin(found, units="scene"):
    """The picture of the margin that was `Found`, likewise."""
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    plot.margin(found.margin, figure.subplots(), units)
    figure.suptitle(described(found.there(found.file.margin), (), units), fontsize="medium")
    return png(figure)


def png(figure):
    """A figure as the bytes of a PNG."""
    held = BytesIO()
    figure.savefig(held, format="png", dpi=DOTS)
    return held.getvalue()


def _diagram(found, units):
    size = style.of_parameter(style.scales_of(found.scene, units), found.across).size
    figure = Figure(figsize=(7.5, 9.0 if found.drawn else 8.0), layout="constrained")
    both = figure.subplots(2, 1, sharex=True)
    for ax, variable in zip(both, "xv", strict=True):
        if found.file.sweep is not None:
            plot.diagram(found.swept, variable, ax, bool(found.drawn), units)
        for one in found.drawn:
            plot.branch(one, variable, ax, units=units)
        for asked, draw, some in (
            (found.file.attractors, plot.mark, found.attractors),
            (found.file.orbits, plot.mark_orbits, found.others),
        ):
            value = found.mark(asked)
            if value is not None:
                draw(some, size * value, variable, ax, units)
        ax.label_outer()
    if found.drawn:
        plot.mark_points(found.drawn, both[0], units)
    _legend(figure, both[0])
    return figure


def _legend(figure, ax):
    """One legend below all: with branches in it, a column for each kind of entry."""
    told = list(zip(*ax.get_legend_handles_labels(), strict=True))
    look = {"loc": "outside lower center", "frameon": False}
    kinds = [handle.get_gid() for handle, _ in told]
    if "branch" not in kinds:
        figure.legend(*zip(*told, strict=True), ncols=3, **look)
        return
    first = kinds.index("branch")
    legs, rest = told[:first], told[first:]
    groups = [[one for one in rest if one[0].get_gid() == kind] for kind in ("branch", "stability", "special", None)]
    groups = [groups[0], legs + groups[1], groups[2], groups[3]]
    rows = min(ROWS, max(map(len, groups)))
    blank = Line2D([], [], linestyle="none"), ""
    columns = [part + [blank] * (-len(part) % rows) for part in groups]
    entries = [one for part in columns for one in part]
    figure.legend(*zip(*entries, strict=True), ncols=len(entries) // rows, fontsize="small", columnspacing=1.0, **look)


def _portraits(found, units):
    motions = list(_motions(found, units))
    drawn, columns = motions[:MOST], max(1, math.isqrt(max(0, min(MOST, len(motions)) - 1)) + 1)
    rows = max(1, -(-len(drawn) // columns))
    figure = Figure(figsize=(max(WIDE, 1 + 4.0 * columns), 0.5 + 3.7 * rows), layout="constrained")
    for place, (draw, name) in enumerate(drawn, 1):
        ax = figure.add_subplot(rows, columns, place)
        try:
            draw(ax)
        except ArgumentError as error:  # too many impacts to draw
            ax.text(0.5, 0.5, style.plain(str(error)), wrap=True, ha="center", va="center")
        ax.set_title(name, fontsize="medium")
    if len(motions) != len(drawn) or not motions:
        told = f"the first {MOST} of {len(motions)} motions" if motions else "no motion to draw"
        figure.supxlabel(told, fontsize="medium")
    return figure


def _motions(found, units):
    """(what draws it into Axes, title) of each motion that there is to draw."""
    for one in found.attractors or ():
        if one.kind != "unresolved":
            name = f"{one.label}, {share_text(one)}" + _at(found, found.file.attractors, units)
            yield _drawing(found.there(found.file.attractors), one.state, one.periods or ROAMED, units), name
    for one in found.others:
        yield partial(plot.orbit, one, units=units), title(one) + _at(found, found.file.orbits, units)
    if found.margin is not None:
        told = title(found.margin.orbit) + _at(found, found.file.margin, units)
        yield partial(plot.orbit, found.margin.orbit, units=units), told
    if found.fit is not None:
        yield partial(plot.fit, found.fit, found.record), f"fit: {found.fit.status.name}"
    if found.swept is not None:
        n, last = int(recurrence(found.swept)[0, 0]), found.swept.isel(step=0, leg=0, period=-1)
        if n >= 0:
            state = State(float(last["x"]), float(last["v"]))
            yield _drawing(found.scene, state, n or ROAMED, units), "from rest, settled"


def _drawing(scene, state, periods, units):
    return lambda ax: plot.portrait(simulate(scene, state, periods, SAMPLES), scene, ax, units=units)


def _shared(found):
    """The scene that the heading is of: the diagram's; where attractors and orbits are of two, the file's own."""
    if found.across is not None:
        return found.base
    asked = [one for one in (found.file.attractors, found.file.orbits) if one is not None]
    if not asked or any(one.at != asked[0].at for one in asked):
        return found.scene
    return found.there(asked[0])


def _at(found, asked, units):
    """For a title: the values in which a motion's scene differs from the heading's, in a line of their own."""
    if _shared(found) is not found.scene or not asked.at:
        return ""
    scales = style.scales_of(found.scene, units)
    return "\nat " + ", ".join(style.value_text(scales, *one) for one in asked.at.items())


def _heading(found, units):
    """The scene in a line or two, but for what is swept, and the box of the starts."""
    told = f"{described(_shared(found), [found.across], units)};  states at phase 0 of the drive"
    if found.attractors is None:
        return told
    there = found.there(found.file.attractors)
    return f"{told}\nstarts at phase 0: {box_text(there, style.scales_of(there, units))}"


def described(scene, without, units):
    """A scene in a line or two, but for some parameters."""
    scales = style.scales_of(scene, units)
    plain = [
        style.value_text(scales, name, float(scene.parameter(name)))
        for name in style.SYMBOLS
        if name in scene.names and name not in without and (name != "restitution" or scene.shares_restitution)
    ]
    if scene.force is not None:
        own = {
            name: value for name, value in scene.numbers.items() if name.startswith("force.") and name not in without
        }
        told = ", ".join(f"{name.removeprefix('force.')} {value:g}" for name, value in own.items())
        plain.append(style.plain(f"force {named(scene.force.function)}" + (told and f" with {told}")))
    plain += [_term(k, term, without, scales) for k, term in enumerate(scene.drive)]
    walls = [_wall(side, wall, without, scales) for side, wall in scene.walls.items()]
    return ",  ".join(plain) + "\n" + (",  ".join(walls) or "no walls")


def _term(k, term, without, scales):
    """A further term of the drive, but for some parameters."""
    told = "drive "
    if f"drive.{k}.amplitude" not in without:
        told += amount_text(scales, FORCE, float(term.amplitude)) + " "
    turned = f" + {float(term.phase):g}" if f"drive.{k}.phase" not in without and float(term.phase) else ""
    return told + rf"$\cos({term.harmonic}\omega t{turned})$"


def _wall(side, wall, without, scales):
    told = f"{side} wall"
    if f"{side}.position" not in without:
        told += f" at {amount_text(scales, LENGTH, float(wall.position))}"
    if wall.restitution is not None and f"{side}.restitution" not in without:
        told += f" with $R$ = {float(wall.restitution):g}"
    return told if wall.motion is None else told + ", moving"
