"""Draw the pictures of a run: the diagram with attractors and orbits, or portraits; the loci; the margin."""

import math
from functools import partial
from io import BytesIO

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import plot
from ..attractors.shares import share_text
from ..loci.bistability import coexistences
from ..loci.loci import find_mirror_image
from ..maps.initial_conditions import box_text
from ..maps.simulate import simulate
from ..output.units import FORCE, LENGTH, quantity_text
from ..plot import style
from ..plot.locus import locus_name as of_locus
from ..plot.orbit import orbit_title
from ..scene.check import ArgumentError
from ..scene.named_forces import force_name
from ..scene.state import State
from .sweep_periods import recurrence_periods

DPI = 170
MAX_PORTRAITS = 9
MIN_WIDTH = 6.5  # inches, the width of a heading
LEGEND_ROWS = 8  # rows per column
CHAOTIC_PERIODS = 40  # drive periods drawn of a motion that does not recur
SAMPLES_PER_PERIOD = 400  # samples per drive period


def main_picture(results, units="scene"):
    """Draw the main picture of the results, in units "scene" or "physical", and return the PNG bytes."""
    figure = (
        _diagram_figure(results, units) if results.diagram_parameter is not None else _portraits_figure(results, units)
    )
    figure.suptitle(_heading(results, units), fontsize="medium")
    return png_bytes(figure)


def loci_picture(results, units="scene"):
    """Draw the loci of the results and return the PNG bytes; mirror images on one curve are drawn once."""
    table, scene = results.file.locus, results.scene_of_table(results.file.branch_table)
    figure = Figure(figsize=(9.5, 6.5), layout="constrained")
    ax = figure.subplots()
    drawn_loci, names_with_image = [], set()
    for locus in sorted(results.loci, key=lambda locus: table.kinds.index(locus.kind)):
        original = find_mirror_image(locus, drawn_loci)
        if original is None:
            drawn_loci.append(locus)
            plot.locus(locus, ax, units=units)
        else:
            names_with_image.add(of_locus(original))
    for bistable_region in coexistences(results.branches, drawn_loci):
        plot.region(*bistable_region, ax, units=units)
    scales = style.scales_of(scene, units)
    for axis_letter, parameter in zip("xy", table.parameters, strict=True):
        axis = style.parameter_axis(scales, parameter)
        limits = [axis.factor * bound for bound in table.bounds[parameter]]
        ax.set(**{f"{axis_letter}label": axis.label, f"{axis_letter}lim": limits})
    entries = zip(*ax.get_legend_handles_labels(), strict=True)
    entries = [(handle, f"{text} and mirror image" if text in names_with_image else text) for handle, text in entries]
    entries.sort(key=lambda entry: entry[0].get_gid() == "codimension two")
    if entries:
        legend_options = {"frameon": False, "fontsize": "small", "handlelength": 4.0}
        figure.legend(*zip(*entries, strict=True), loc="outside right upper", **legend_options)
    figure.suptitle(describe_scene(scene, table.parameters, units), fontsize="medium")
    return png_bytes(figure)


def margin_picture(results, units="scene"):
    """Draw the margin of the results and return the PNG bytes."""
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    plot.margin(results.margin, figure.subplots(), units)
    figure.suptitle(describe_scene(results.scene_of_table(results.file.margin), (), units), fontsize="medium")
    return png_bytes(figure)


def png_bytes(figure):
    """Return a figure as the bytes of a PNG file.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.

    Returns
    -------
    bytes
        The content of the file.
    """
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def _diagram_figure(results, units):
    factor = style.parameter_axis(style.scales_of(results.scene, units), results.diagram_parameter).factor
    figure = Figure(figsize=(7.5, 9.0 if results.diagram_branches else 8.0), layout="constrained")
    axes_pair = figure.subplots(2, 1, sharex=True)
    for ax, variable in zip(axes_pair, "xv", strict=True):
        if results.file.sweep is not None:
            plot.diagram(results.swept, variable, ax, bool(results.diagram_branches), units)
        for branch in results.diagram_branches:
            plot.branch(branch, variable, ax, units=units)
        for table, draw, records in (
            (results.file.attractors, plot.mark, results.attractors),
            (results.file.orbits, plot.mark_orbits, results.other_orbits),
        ):
            value = results.diagram_value(table)
            if value is not None:
                draw(records, factor * value, variable, ax, units)
        ax.label_outer()
    if results.diagram_branches:
        plot.mark_points(results.diagram_branches, axes_pair[0], units)
    _add_legend(figure, axes_pair[0])
    return figure


def _add_legend(figure, ax):
    """Add one legend below the axes; with branches, one column per kind of entry."""
    handles_labels = list(zip(*ax.get_legend_handles_labels(), strict=True))
    legend_options = {"loc": "outside lower center", "frameon": False}
    kinds = [handle.get_gid() for handle, _ in handles_labels]
    if "branch" not in kinds:
        figure.legend(*zip(*handles_labels, strict=True), ncols=3, **legend_options)
        return
    n_leg_entries = kinds.index("branch")
    leg_entries, other_entries = handles_labels[:n_leg_entries], handles_labels[n_leg_entries:]
    groups = [
        [entry for entry in other_entries if entry[0].get_gid() == kind]
        for kind in ("branch", "stability", "special", None)
    ]
    groups = [groups[0], leg_entries + groups[1], groups[2], groups[3]]
    n_rows = min(LEGEND_ROWS, max(map(len, groups)))
    blank_entry = Line2D([], [], linestyle="none"), ""
    columns = [column + [blank_entry] * (-len(column) % n_rows) for column in groups]
    entries = [entry for column in columns for entry in column]
    figure.legend(
        *zip(*entries, strict=True), ncols=len(entries) // n_rows, fontsize="small", columnspacing=1.0, **legend_options
    )


def _portraits_figure(results, units):
    motions = list(_portrait_jobs(results, units))
    drawn_motions, n_columns = (
        motions[:MAX_PORTRAITS],
        max(1, math.isqrt(max(0, min(MAX_PORTRAITS, len(motions)) - 1)) + 1),
    )
    n_rows = max(1, -(-len(drawn_motions) // n_columns))
    figure = Figure(figsize=(max(MIN_WIDTH, 1 + 4.0 * n_columns), 0.5 + 3.7 * n_rows), layout="constrained")
    for index, (draw, portrait_title) in enumerate(drawn_motions, 1):
        ax = figure.add_subplot(n_rows, n_columns, index)
        try:
            draw(ax)
        except ArgumentError as error:  # too many impacts to draw
            ax.text(0.5, 0.5, style.escape_formulas(str(error)), wrap=True, ha="center", va="center")
        ax.set_title(portrait_title, fontsize="medium")
    if len(motions) != len(drawn_motions) or not motions:
        note = f"the first {MAX_PORTRAITS} of {len(motions)} motions" if motions else "no motion to draw"
        figure.supxlabel(note, fontsize="medium")
    return figure


def _portrait_jobs(results, units):
    """Iterate over (drawing function of Axes, title) of the motions."""
    for motion in results.attractors or ():
        if motion.kind != "unresolved":
            portrait_title = f"{motion.label}, {share_text(motion)}" + _value_line(
                results, results.file.attractors, units
            )
            yield (
                _portrait_drawer(
                    results.scene_of_table(results.file.attractors),
                    motion.state,
                    motion.periods or CHAOTIC_PERIODS,
                    units,
                ),
                portrait_title,
            )
    for motion in results.other_orbits:
        yield (
            partial(plot.orbit, motion, units=units),
            orbit_title(motion) + _value_line(results, results.file.orbits, units),
        )
    if results.margin is not None:
        margin_title = orbit_title(results.margin.orbit) + _value_line(results, results.file.margin, units)
        yield partial(plot.orbit, results.margin.orbit, units=units), margin_title
    if results.fit is not None:
        yield partial(plot.fit, results.fit, results.record), f"fit: {results.fit.status.name}"
    if results.swept is not None:
        n_periods, last_state = (
            int(recurrence_periods(results.swept)[0, 0]),
            results.swept.isel(step=0, leg=0, period=-1),
        )
        if n_periods >= 0:
            state = State(float(last_state["x"]), float(last_state["v"]))
            yield _portrait_drawer(results.scene, state, n_periods or CHAOTIC_PERIODS, units), "from rest, settled"


def _portrait_drawer(scene, state, periods, units):
    return lambda ax: plot.portrait(simulate(scene, state, periods, SAMPLES_PER_PERIOD), scene, ax, units=units)


def _heading_scene(results):
    """Return the scene of the heading: the diagram's, or the file's if attractors and orbits have two scenes."""
    if results.diagram_parameter is not None:
        return results.diagram_scene
    tables = [table for table in (results.file.attractors, results.file.orbits) if table is not None]
    if not tables or any(table.at != tables[0].at for table in tables):
        return results.scene
    return results.scene_of_table(tables[0])


def _value_line(results, table, units):
    """Return a line for a title with the values in which a motion's scene differs from the heading's."""
    if _heading_scene(results) is not results.scene or not table.at:
        return ""
    scales = style.scales_of(results.scene, units)
    return "\nat " + ", ".join(style.value_text(scales, *item) for item in table.at.items())


def _heading(results, units):
    """Describe the scene, except for the swept parameter, and the box of the starts."""
    text = (
        f"{describe_scene(_heading_scene(results), [results.diagram_parameter], units)};  states at phase 0 of"
        " the drive"
    )
    if results.attractors is None:
        return text
    attractor_scene = results.scene_of_table(results.file.attractors)
    return f"{text}\nstarts at phase 0: {box_text(attractor_scene, style.scales_of(attractor_scene, units))}"


def describe_scene(scene, excluded, units):
    """Describe a scene in one or two lines, except for some parameters."""
    scales = style.scales_of(scene, units)
    parts = [
        style.value_text(scales, name, float(scene.parameter(name)))
        for name in style.SYMBOLS
        if name in scene.names and name not in excluded and (name != "restitution" or scene.shares_restitution)
    ]
    if scene.force is not None:
        force_params = {
            name: value for name, value in scene.numbers.items() if name.startswith("force.") and name not in excluded
        }
        params_text = ", ".join(f"{name.removeprefix('force.')} {value:g}" for name, value in force_params.items())
        parts.append(
            style.escape_formulas(
                f"force {force_name(scene.force.function)}" + (params_text and f" with {params_text}")
            )
        )
    parts += [_drive_term_text(k, term, excluded, scales) for k, term in enumerate(scene.drive)]
    walls = [_wall_text(side, wall, excluded, scales) for side, wall in scene.walls.items()]
    return ",  ".join(parts) + "\n" + (",  ".join(walls) or "no walls")


def _drive_term_text(k, term, excluded, scales):
    """Describe a further term of the drive, except for some parameters."""
    text = "drive "
    if f"drive.{k}.amplitude" not in excluded:
        text += quantity_text(scales, FORCE, float(term.amplitude)) + " "
    phase_text = f" + {float(term.phase):g}" if f"drive.{k}.phase" not in excluded and float(term.phase) else ""
    return text + rf"$\cos({term.harmonic}\omega t{phase_text})$"


def _wall_text(side, wall, excluded, scales):
    """Describe a wall, except for some parameters."""
    text = f"{side} wall"
    if f"{side}.position" not in excluded:
        text += f" at {quantity_text(scales, LENGTH, float(wall.position))}"
    if wall.restitution is not None and f"{side}.restitution" not in excluded:
        text += f" with $R$ = {float(wall.restitution):g}"
    return text if wall.motion is None else text + ", moving"
