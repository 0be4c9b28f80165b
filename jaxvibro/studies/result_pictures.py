"""Draw the pictures of a run: a diagram or phase portraits, the loci, and the margin."""

import math
from functools import partial
from io import BytesIO

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import plot
from ..attractors.basin_fraction_bounds import format_share
from ..loci.loci_of_branches import find_coexistence_loci, find_mirror_locus
from ..maps.initial_conditions import format_initial_box
from ..maps.simulate import simulate
from ..output.units import FORCE, LENGTH, quantity_text
from ..plot import style
from ..plot.locus import locus_name as of_locus
from ..plot.orbit import orbit_title
from ..scene.check import ArgumentError
from ..scene.predefined_forces import force_name
from ..scene.state import State
from .sweep_periods import find_recurrence_periods

DPI = 170
MAX_PORTRAITS = 9
MIN_WIDTH = 6.5  # inches, the width of a heading
LEGEND_ROWS = 8  # rows per column
CHAOTIC_PERIODS = 40  # drive periods drawn of a motion that does not recur
SAMPLES_PER_PERIOD = 400  # samples per drive period


def draw_main_picture(results, units="scene"):
    """Draw the main picture of a run and return the PNG bytes.

    The picture is the diagram with attractors and orbits, or phase portraits without a diagram.
    """
    figure = (
        _diagram_figure(results, units) if results.diagram_parameter is not None else _portraits_figure(results, units)
    )
    figure.suptitle(_heading_text(results, units), fontsize="medium")
    return png_bytes(figure)


def draw_loci_picture(results, units="scene"):
    """Draw the loci of a run and return the PNG bytes; loci of mirror images coincide and are drawn as one curve."""
    locus_table, scene = results.file.locus, results.scene_of_table(results.file.branch_table)
    figure = Figure(figsize=(9.5, 6.5), layout="constrained")
    ax = figure.subplots()
    drawn_loci, names_with_mirror = [], set()
    for locus in sorted(results.loci, key=lambda locus: locus_table.kinds.index(locus.kind)):
        original_locus = find_mirror_locus(locus, drawn_loci)
        if original_locus is None:
            drawn_loci.append(locus)
            plot.locus(locus, ax, units=units)
        else:
            names_with_mirror.add(of_locus(original_locus))
    for bistable_region in find_coexistence_loci(results.branches, drawn_loci):
        plot.region(*bistable_region, ax, units=units)
    scales = style.scales_of(scene, units)
    for axis_letter, parameter_name in zip("xy", locus_table.parameters, strict=True):
        axis_label_and_factor = style.parameter_axis(scales, parameter_name)
        axis_limits = [axis_label_and_factor.factor * axis_bound for axis_bound in locus_table.bounds[parameter_name]]
        ax.set(**{f"{axis_letter}label": axis_label_and_factor.label, f"{axis_letter}lim": axis_limits})
    legend_entries = zip(*ax.get_legend_handles_labels(), strict=True)
    legend_entries = [
        (legend_handle, f"{legend_text} and mirror image" if legend_text in names_with_mirror else legend_text)
        for legend_handle, legend_text in legend_entries
    ]
    legend_entries.sort(key=lambda legend_entry: legend_entry[0].get_gid() == "codimension two")
    if legend_entries:
        legend_options = {"frameon": False, "fontsize": "small", "handlelength": 4.0}
        figure.legend(*zip(*legend_entries, strict=True), loc="outside right upper", **legend_options)
    figure.suptitle(describe_scene(scene, locus_table.parameters, units), fontsize="medium")
    return png_bytes(figure)


def draw_margin_picture(results, units="scene"):
    """Draw the margin of a run and return the PNG bytes."""
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    plot.margin(results.margin, figure.subplots(), units)
    figure.suptitle(describe_scene(results.scene_of_table(results.file.margin), (), units), fontsize="medium")
    return png_bytes(figure)


def png_bytes(figure):
    """Return a figure as the bytes of a PNG file.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure to convert.

    Returns
    -------
    bytes
        Content of the file.
    """
    png_buffer = BytesIO()
    figure.savefig(png_buffer, format="png", dpi=DPI)
    return png_buffer.getvalue()


def _diagram_figure(results, units):
    unit_factor = style.parameter_axis(style.scales_of(results.scene, units), results.diagram_parameter).factor
    figure = Figure(figsize=(7.5, 9.0 if results.diagram_branches else 8.0), layout="constrained")
    axes_pair = figure.subplots(2, 1, sharex=True)
    for ax, coordinate_name in zip(axes_pair, "xv", strict=True):
        if results.file.sweep is not None:
            plot.diagram(results.swept, coordinate_name, ax, bool(results.diagram_branches), units)
        for branch in results.diagram_branches:
            plot.branch(branch, coordinate_name, ax, units=units)
        for analysis_table, draw_marks, motions in (
            (results.file.attractors, plot.mark, results.attractors),
            (results.file.orbits, plot.mark_orbits, results.other_orbits),
        ):
            diagram_value = results.diagram_value(analysis_table)
            if diagram_value is not None:
                draw_marks(motions, unit_factor * diagram_value, coordinate_name, ax, units)
        ax.label_outer()
    if results.diagram_branches:
        plot.mark_points(results.diagram_branches, axes_pair[0], units)
    _add_legend(figure, axes_pair[0])
    return figure


def _add_legend(figure, ax):
    """Add a legend below the axes; if there are branches, the legend has a column for each kind of entry."""
    legend_entries = list(zip(*ax.get_legend_handles_labels(), strict=True))
    legend_options = {"loc": "outside lower center", "frameon": False}
    entry_kinds = [legend_handle.get_gid() for legend_handle, _ in legend_entries]
    if "branch" not in entry_kinds:
        figure.legend(*zip(*legend_entries, strict=True), ncols=3, **legend_options)
        return
    n_leg_entries = entry_kinds.index("branch")
    leg_entries, other_entries = legend_entries[:n_leg_entries], legend_entries[n_leg_entries:]
    entry_groups = [
        [legend_entry for legend_entry in other_entries if legend_entry[0].get_gid() == entry_kind]
        for entry_kind in ("branch", "stability", "special", None)
    ]
    entry_groups = [entry_groups[0], leg_entries + entry_groups[1], entry_groups[2], entry_groups[3]]
    n_rows = min(LEGEND_ROWS, max(map(len, entry_groups)))
    blank_entry = Line2D([], [], linestyle="none"), ""
    legend_columns = [legend_column + [blank_entry] * (-len(legend_column) % n_rows) for legend_column in entry_groups]
    entries_with_blanks = [legend_entry for legend_column in legend_columns for legend_entry in legend_column]
    figure.legend(
        *zip(*entries_with_blanks, strict=True),
        ncols=len(entries_with_blanks) // n_rows,
        fontsize="small",
        columnspacing=1.0,
        **legend_options,
    )


def _portraits_figure(results, units):
    drawers_and_titles = list(_yield_portrait_drawers(results, units))
    drawers_within_limit, n_columns = (
        drawers_and_titles[:MAX_PORTRAITS],
        max(1, math.isqrt(max(0, min(MAX_PORTRAITS, len(drawers_and_titles)) - 1)) + 1),
    )
    n_rows = max(1, -(-len(drawers_within_limit) // n_columns))
    figure = Figure(figsize=(max(MIN_WIDTH, 1 + 4.0 * n_columns), 0.5 + 3.7 * n_rows), layout="constrained")
    for panel_number, (draw_portrait, portrait_title) in enumerate(drawers_within_limit, 1):
        ax = figure.add_subplot(n_rows, n_columns, panel_number)
        try:
            draw_portrait(ax)
        except ArgumentError as error:  # too many impacts to draw
            ax.text(0.5, 0.5, style.escape_formulas(str(error)), wrap=True, ha="center", va="center")
        ax.set_title(portrait_title, fontsize="medium")
    if len(drawers_and_titles) != len(drawers_within_limit) or not drawers_and_titles:
        count_note = (
            f"the first {MAX_PORTRAITS} of {len(drawers_and_titles)} motions"
            if drawers_and_titles
            else "no motion to draw"
        )
        figure.supxlabel(count_note, fontsize="medium")
    return figure


def _yield_portrait_drawers(results, units):
    """Yield (function that draws the phase portrait on Axes, title) for each motion."""
    for motion in results.attractors or ():
        if motion.kind != "unresolved":
            portrait_title = f"{motion.label}, {format_share(motion)}" + _differing_values_line(
                results, results.file.attractors, units
            )
            yield (
                _make_portrait_drawer(
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
            orbit_title(motion) + _differing_values_line(results, results.file.orbits, units),
        )
    if results.margin is not None:
        margin_title = orbit_title(results.margin.orbit) + _differing_values_line(results, results.file.margin, units)
        yield partial(plot.orbit, results.margin.orbit, units=units), margin_title
    if results.fit is not None:
        yield partial(plot.fit, results.fit, results.record), f"fit: {results.fit.status.name}"
    if results.swept is not None:
        n_periods, last_state = (
            int(find_recurrence_periods(results.swept)[0, 0]),
            results.swept.isel(step=0, leg=0, period=-1),
        )
        if n_periods >= 0:
            state = State(float(last_state["x"]), float(last_state["v"]))
            yield _make_portrait_drawer(results.scene, state, n_periods or CHAOTIC_PERIODS, units), "from rest, settled"


def _make_portrait_drawer(scene, state, n_periods, units):
    return lambda ax: plot.portrait(simulate(scene, state, n_periods, SAMPLES_PER_PERIOD), scene, ax, units=units)


def _heading_scene(results):
    """Return the scene that the heading describes.

    With a diagram, the heading describes the scene of the diagram. Without a diagram, it describes the common scene of
    attractors and orbits, or the scene of the file if the scenes of attractors and orbits differ.
    """
    if results.diagram_parameter is not None:
        return results.diagram_scene
    analysis_tables = [
        analysis_table
        for analysis_table in (results.file.attractors, results.file.orbits)
        if analysis_table is not None
    ]
    if not analysis_tables or any(analysis_table.at != analysis_tables[0].at for analysis_table in analysis_tables):
        return results.scene
    return results.scene_of_table(analysis_tables[0])


def _differing_values_line(results, analysis_table, units):
    """Return a title line with the parameter values in which a motion's scene differs from that of the heading."""
    if _heading_scene(results) is not results.scene or not analysis_table.at:
        return ""
    scales = style.scales_of(results.scene, units)
    return "\nat " + ", ".join(
        style.parameter_value_text(scales, *name_and_value) for name_and_value in analysis_table.at.items()
    )


def _heading_text(results, units):
    """Describe the scene, except for the parameter of the diagram, and the range of the initial states."""
    heading_text = (
        f"{describe_scene(_heading_scene(results), [results.diagram_parameter], units)};  states at phase 0 of"
        " the drive"
    )
    if results.attractors is None:
        return heading_text
    attractor_scene = results.scene_of_table(results.file.attractors)
    return (
        f"{heading_text}\nstarts at phase 0:"
        f" {format_initial_box(attractor_scene, style.scales_of(attractor_scene, units))}"
    )


def describe_scene(scene, excluded_names, units):
    """Describe the parameters and walls of a scene in two lines, without the parameters in `excluded_names`."""
    scales = style.scales_of(scene, units)
    part_texts = [
        style.parameter_value_text(scales, parameter_name, float(scene.parameter(parameter_name)))
        for parameter_name in style.SYMBOLS
        if parameter_name in scene.names
        and parameter_name not in excluded_names
        and (parameter_name != "restitution" or scene.shares_restitution)
    ]
    if scene.force is not None:
        force_param_values = {
            parameter_name: parameter_value
            for parameter_name, parameter_value in scene.numbers.items()
            if parameter_name.startswith("force.") and parameter_name not in excluded_names
        }
        params_text = ", ".join(
            f"{parameter_name.removeprefix('force.')} {parameter_value:g}"
            for parameter_name, parameter_value in force_param_values.items()
        )
        part_texts.append(
            style.escape_formulas(
                f"force {force_name(scene.force.function)}" + (params_text and f" with {params_text}")
            )
        )
    part_texts += [
        _drive_term_text(term_index, drive_term, excluded_names, scales)
        for term_index, drive_term in enumerate(scene.drive)
    ]
    wall_texts = [_wall_text(side, wall, excluded_names, scales) for side, wall in scene.walls.items()]
    return ",  ".join(part_texts) + "\n" + (",  ".join(wall_texts) or "no walls")


def _drive_term_text(term_index, drive_term, excluded_names, scales):
    """Describe an additional term of the drive, without the parameters in `excluded_names`."""
    term_text = "drive "
    if f"drive.{term_index}.amplitude" not in excluded_names:
        term_text += quantity_text(scales, FORCE, float(drive_term.amplitude)) + " "
    phase_text = (
        f" + {float(drive_term.phase):g}"
        if f"drive.{term_index}.phase" not in excluded_names and float(drive_term.phase)
        else ""
    )
    return term_text + rf"$\cos({drive_term.harmonic}\omega t{phase_text})$"


def _wall_text(side, wall, excluded_names, scales):
    """Describe a wall, without the parameters in `excluded_names`."""
    wall_text = f"{side} wall"
    if f"{side}.position" not in excluded_names:
        wall_text += f" at {quantity_text(scales, LENGTH, float(wall.position))}"
    if wall.restitution is not None and f"{side}.restitution" not in excluded_names:
        wall_text += f" with $R$ = {float(wall.restitution):g}"
    return wall_text if wall.motion is None else wall_text + ", moving"
