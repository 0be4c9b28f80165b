"""Format the results of a run as a readable table and as a summary for JSON."""

import math

import msgspec

from .. import __version__
from ..attractors.basin_fraction_bounds import format_share
from ..branches.branch import KIND_NAMES, describe_extent, neighbour_labels
from ..branches.branch_tree import originals_of_mirrors
from ..design.records import ImpactRecord
from ..loci.locus import MEANINGS as ON_LOCI
from ..maps.initial_conditions import format_initial_box, initial_box
from ..output.table_text import align_columns, multipliers_text
from ..output.units import LENGTH, SPEED, quantity_text, unit_in_system, unit_of
from ..problem.curve_ends import End
from . import map_report, sweep_report
from .sweep_report import state_headings

CHATTER_NOTE = "inf: the mass sticks after complete chatter; impacts lists the bounces before this is certain"


def format_results_table(results, file_name, units="scene"):
    """Format the scene and all results of a run as text."""
    text_lines = [f"jaxvibro {__version__}, {file_name}\n", align_columns(_parameter_rows(results.scene, units))]
    for field_name, format_section in _LINES_BY_FIELD.items():
        if getattr(results, field_name) is not None:
            text_lines += ["", *format_section(results, units)]
    return "\n".join(text_lines) + "\n"


def _parameter_rows(scene, units):
    """Return a table row for each parameter: (name, value), or (name, value, unit) in physical units."""
    parameter_values = {
        parameter_name: parameter_value
        for parameter_name, parameter_value in scene.numbers.items()
        if parameter_name != "restitution" or scene.shares_restitution
    }
    if units == "scene":
        return list(parameter_values.items())
    unit_conversions = {
        parameter_name: unit_in_system(scene, unit_of(parameter_name), units) for parameter_name in scene.names
    }
    return [
        (parameter_name, parameter_value * unit_conversions[parameter_name][1], unit_conversions[parameter_name][0])
        for parameter_name, parameter_value in parameter_values.items()
    ]


def _attractor_lines(results, units):
    attractors_table, ((x_heading, x_factor), (v_heading, v_factor)) = (
        results.file.attractors,
        state_headings(results, units),
    )
    values_text = _fixed_values_text(results, attractors_table, units)
    starts_text = f"{attractors_table.starts} starts (seed {attractors_table.seed})"
    yield f"attractors at {values_text}, from {starts_text}; x and v at phase 0"
    initial_box_text = format_initial_box(results.scene_of_table(attractors_table), _display_scales(results, units))
    yield f"starts: random at phase 0, {initial_box_text}; shares with 95 % bounds"
    rows = [("", "label", "share", "periods", x_heading, v_heading, "impacts", "exponent", "rests", "mirror image")]
    for attractor_number, attractor in enumerate(results.attractors, 1):
        state_texts = (f"{x_factor * attractor.state.x:.12f}", f"{v_factor * attractor.state.v:.12f}")
        basin_share_text, exponent_text = format_share(attractor), f"{attractor.exponent:.4f}"
        itinerary_text, mirror_text = (
            _itinerary_text(attractor.itinerary),
            _mirror_image_text(attractor_number, attractor.mirror_of),
        )
        rows.append(
            (
                attractor_number,
                attractor.label,
                basin_share_text,
                attractor.periods or "-",
                *state_texts,
                itinerary_text,
                exponent_text,
                _yes_or_dash(attractor.rests),
                mirror_text,
            )
        )
    yield align_columns(rows)
    yield "impacts: L left, R right, one word per period; exponent: the largest Lyapunov exponent, per drive period"
    if any(attractor.rests for attractor in results.attractors):
        yield CHATTER_NOTE
    for attractor_number, attractor in enumerate(results.attractors, 1):
        yield f"{attractor_number}: {attractor.note}"


def _display_scales(results, units):
    return results.scene.scales if units == "physical" else None


def _range_text(results, units, parameter_name, lower, upper):
    lower_text, upper_text = (
        quantity_text(_display_scales(results, units), unit_of(parameter_name), bound) for bound in (lower, upper)
    )
    return f"from {lower_text} to {upper_text}"


def _start_text(results, analysis_table, units):
    scales = _display_scales(results, units)
    x_text, v_text = (
        quantity_text(scales, LENGTH, analysis_table.start.x),
        quantity_text(scales, SPEED, analysis_table.start.v),
    )
    return f"x = {x_text}, v = {v_text} at {_fixed_values_text(results, analysis_table, units)}"


def _fixed_values_text(results, analysis_table, units):
    scales = _display_scales(results, units)
    assignment_texts = (
        f"{parameter_name} = {quantity_text(scales, unit_of(parameter_name), parameter_value)}"
        for parameter_name, parameter_value in analysis_table.at.items()
    )
    return ", ".join(assignment_texts) or "the scene's own values"


def _yes_or_dash(is_yes):
    return "yes" if is_yes else "-"


def _itinerary_text(itinerary):
    return " ".join(itinerary_word or "." for itinerary_word in itinerary) or "-"


def _orbit_lines(results, units):
    orbits_table, ((x_heading, x_factor), (v_heading, v_factor)) = results.file.orbits, state_headings(results, units)
    settings_text = (
        f"max_period {orbits_table.max_period}, near trajectories from {orbits_table.starts} starts (seed"
        f" {orbits_table.seed})"
    )
    values_text, n_orbits = _fixed_values_text(results, orbits_table, units), len(results.orbits)
    yield f"periodic orbits at {values_text}, {settings_text}: {n_orbits or 'none'} found"
    if not results.orbits:
        return
    has_nonzero_phases = any(orbit.state.phase for orbit in results.orbits)
    column_headings = ("", "label", "", "multipliers", x_heading, v_heading, "phase", "impacts")
    rows = [
        (*column_headings, f"least speed{v_heading[1:]}", f"least clearance{x_heading[1:]}", "residual", "mirror image")
    ]
    for orbit_number, orbit in enumerate(results.orbits, 1):
        state_numbers = x_factor * orbit.state.x, v_factor * orbit.state.v, orbit.state.phase
        state_texts = [f"{state_number:.12f}" for state_number in state_numbers]
        speed_gap_residual = (
            v_factor * float(orbit.least_speed),
            x_factor * float(orbit.least_clearance),
            f"{orbit.residual:.1e}",
        )
        stability_text = "stable" if orbit.stable else "unstable"
        details = (
            orbit.label,
            stability_text + ", rests" if orbit.rests else stability_text,
            multipliers_text(orbit.multipliers, 7),
        )
        rows.append(
            (
                orbit_number,
                *details,
                *state_texts,
                _itinerary_text(orbit.itinerary),
                *speed_gap_residual,
                _mirror_image_text(orbit_number, orbit.mirror_of),
            )
        )
    yield align_columns(rows if has_nonzero_phases else [row[:6] + row[7:] for row in rows])
    phase_text = "at the phase (rad) given" if has_nonzero_phases else "at phase 0"
    yield f"x and v {phase_text}; impacts: L left, R right, one word per period; multipliers: Floquet, the larger first"
    if any(orbit.rests for orbit in results.orbits):
        yield CHATTER_NOTE


def _branch_lines(results, units):
    branch_table, (lower, upper) = results.file.branch_table, results.file.branch_table.bounds
    if results.diagram is None:
        origin_text = f"from {_start_text(results, branch_table, units)}, max_period {branch_table.max_period}"
    else:
        origin_text = (
            f"from many starts at {_fixed_values_text(results, branch_table, units)}, max_period"
            f" {branch_table.max_period}"
            f" (seed {branch_table.seed})"
        )
    range_text = _range_text(results, units, branch_table.parameter, lower, upper)
    n_branches = len(results.branches)
    yield f"branches of periodic orbits for {branch_table.parameter} {range_text}, {origin_text}: {n_branches}"
    if results.diagram is not None:
        yield results.diagram.reason
    original_of_image = originals_of_mirrors(results.branches)
    image_of_original = {
        original_index: (branch_index, results.branches[branch_index])
        for branch_index, original_index in original_of_image.items()
    }
    for branch_number, branch in (
        (branch_index + 1, branch)
        for branch_index, branch in enumerate(results.branches)
        if branch_index not in original_of_image
    ):
        extent_text = describe_extent(branch, unit_in_system(branch.scene, unit_of(branch.name), units)[1])
        yield f"\n{branch_number}: {branch.segments[0].label} {extent_text}, {len(branch)} points"
        if branch_number - 1 in image_of_original:
            image_index, image_branch = image_of_original[branch_number - 1]
            yield f"its mirror image is {image_index + 1}: {image_branch.segments[0].label}, with the same values"
        yield branch.table(units)
    yield f"\n{_meanings_text(KIND_NAMES)}"
    yield "multipliers: Floquet, the larger first; meets: orbits that meet there, with their side of the value"


def _locus_lines(results, units):
    parameter_bounds = results.file.locus.bounds
    bounds_text = " and ".join(
        f"{parameter_name} {_range_text(results, units, parameter_name, *bound_pair)}"
        for parameter_name, bound_pair in parameter_bounds.items()
    )
    yield f"loci of special points in {bounds_text}: {len(results.loci)}"
    for locus_number, locus_or_point in enumerate(results.loci, 1):
        yield f"\n{locus_number}: {locus_or_point.kind} of {locus_or_point.label}, {len(locus_or_point)} points"
        yield locus_or_point.table(units)
    for locus_or_point, refusal_reason in results.refused_points:
        point_text = f"{locus_or_point.kind} of {locus_or_point.label} at {locus_or_point.name}"
        yield f"\nnot followed: {point_text} = {locus_or_point.value:.12g}: {refusal_reason}"
    yield f"\n{_meanings_text(ON_LOCI)}; SN, PD, SB on a GR: such a locus ends there"


def _margin_lines(results, units):
    margin_table = results.file.margin
    yield f"nearest bifurcations of the orbit reached from {_start_text(results, margin_table, units)}"
    yield results.margin.table(units)
    yield _meanings_text({kind: KIND_NAMES[kind] for kind in margin_table.kinds})


def _fit_lines(results, units):
    record_kind = "impacts" if isinstance(results.record, ImpactRecord) else "samples"
    yield f"parameters fitted to the {len(results.record.times)} {record_kind} of {results.file.fit.record}"
    yield results.fit.table(units)


def _map_lines(results, units):
    return map_report.map_lines(results.map, units)


# Functions of (results, units) that return the lines of a section, for each field of `StudyResults` that is not None.
_LINES_BY_FIELD = {
    "swept": sweep_report.sweep_lines,
    "attractors": _attractor_lines,
    "orbits": _orbit_lines,
    "branches": _branch_lines,
    "loci": _locus_lines,
    "margin": _margin_lines,
    "fit": _fit_lines,
    "map": _map_lines,
}


def _meanings_text(meaning_by_kind):
    return ", ".join(f"{kind} {meaning}" for kind, meaning in meaning_by_kind.items())


def _mirror_image_text(motion_number, mirror_index):
    """Return the number of the mirror image, "itself" for a symmetric motion, or "-" if there is no mirror image."""
    if mirror_index is None:
        return "-"
    return "itself" if mirror_index + 1 == motion_number else f"{mirror_index + 1}"


def summarise_results(results, path_by_kind):
    """Return the results of a run as dicts, lists, texts and finite numbers, ready for JSON.

    Numbers that are not finite become None. `path_by_kind` are the paths of the output files by kind.
    """
    summary_record = {"version": __version__, "files": path_by_kind, "job": msgspec.to_builtins(results.file)}
    if results.swept is not None:
        summary_record["stretches"] = [msgspec.to_builtins(item) for item in results.stretches]
    if results.attractors is not None:
        box_limits = map(float, initial_box(results.scene_of_table(results.file.attractors)))
        summary_record["starts"] = dict(zip(("left", "right", "fast"), box_limits, strict=True))
        summary_record["attractors"] = [_attractor_record(item) for item in results.attractors]
    if results.orbits is not None:
        summary_record["orbits"] = [_orbit_record(item) for item in results.orbits]
    if results.branches is not None:
        original_of_image = originals_of_mirrors(results.branches)
        summary_record["branches"] = [
            _branch_record(item) | {"mirror_of": original_of_image.get(branch_index)}
            for branch_index, item in enumerate(results.branches)
        ]
    if results.diagram is not None:
        summary_record["explored"] = {"complete": results.diagram.complete, "reason": results.diagram.reason}
    if results.loci is not None:
        summary_record["loci"] = [_locus_record(item) for item in results.loci]
        summary_record["not_followed"] = [
            {"kind": item.kind, "label": item.label, "value": item.value, "reason": refusal_reason}
            for item, refusal_reason in results.refused_points
        ]
    if results.margin is not None:
        summary_record["margin"] = [_near_point_record(item) for item in results.margin.points]
    if results.fit is not None:
        summary_record["fit"] = _fit_record(results.fit)
    if results.map is not None:
        summary_record["map"] = map_report.count_cells_by_label(results.map)
    return summary_record


def _attractor_record(attractor):
    return {
        "kind": attractor.kind,
        "share_bounds": list(attractor.share_bounds),
        "starts": attractor.starts,
        "rests": attractor.rests,
        "points": attractor.points.tolist() if attractor.periods else [],
        "note": attractor.note,
        **_motion_fields(attractor, ("share", "least_speed", "exponent")),
    }


def _orbit_record(orbit):
    """Return the summary of an orbit; multipliers are pairs of real and imaginary part."""
    return {
        "stable": orbit.stable,
        "rests": orbit.rests,
        "unknowns": orbit.unknowns,
        "multipliers": _real_imaginary_pairs(orbit.multipliers),
        **_motion_fields(orbit, ("residual", "least_speed", "least_clearance")),
    }


def _real_imaginary_pairs(multipliers):
    return [[_finite_or_none(multiplier.real), _finite_or_none(multiplier.imag)] for multiplier in multipliers]


def _branch_record(branch):
    first_value, last_value = branch.values[[0, -1]]
    return {
        "label": branch.segments[0].label,
        "parameter": branch.name,
        "from": float(first_value),
        "to": float(last_value),
        "range": [float(branch.values.min()), float(branch.values.max())],
        "closed": End.CLOSED in branch.ends,
        "points": len(branch),
        "reasons": list(branch.reasons),
        "segments": [
            {"label": segment.label, "itinerary": list(segment.itinerary), "first": segment.first, "last": segment.last}
            for segment in branch.segments
        ],
        "special": [_special_record(special_point) for special_point in branch.special],
    }


def _locus_record(locus):
    return {
        "kind": locus.kind,
        "label": locus.label,
        "parameters": list(locus.names),
        "points": len(locus),
        "reasons": list(locus.reasons),
        "special": [
            {"values": special_point.values, **_special_fields(special_point)} for special_point in locus.special
        ],
    }


def _special_record(special_point):
    return {"value": special_point.value, **_special_fields(special_point), "meets": neighbour_labels(special_point)}


def _special_fields(special_point):
    """Return the fields that special points of branches and of loci have in common."""
    return {
        "kind": special_point.kind,
        "label": special_point.label,
        "itinerary": list(special_point.itinerary),
        "multipliers": _real_imaginary_pairs(special_point.multipliers),
        "residual": _finite_or_none(special_point.residual),
        "place": int(special_point.place),
    }


def _near_point_record(near_point):
    return {
        "kind": near_point.kind,
        "distance": near_point.distance,
        "change": near_point.change,
        "status": near_point.status,
        "edge": near_point.edge,
        "at_bound": list(near_point.at_bound),
        "residual": _finite_or_none(near_point.residual),
    }


def _fit_record(fit):
    return {
        "status": fit.status.name,
        "values": fit.values,
        "sigma": {
            parameter_name: _finite_or_none(standard_error) for parameter_name, standard_error in fit.sigma.items()
        },
        "chi2": _finite_or_none(fit.chi2),
        "dof": fit.dof,
        "not_in_the_record": [item.shares for item in fit.unidentifiable],
        "missed": [list(item) for item in fit.missed],
        "spurious": list(fit.spurious),
    }


def _motion_fields(motion, number_field_names):
    """Return the fields that attractors and orbits have in common, and the numerical fields in `number_field_names`."""
    return {
        "label": motion.label,
        "periods": motion.periods,
        "itinerary": list(motion.itinerary),
        "state": {
            field_name: _finite_or_none(getattr(motion.state, field_name))
            for field_name in ("x", "v", "phase", "contact")
        },
        "mirror_of": motion.mirror_of,
    } | {field_name: _finite_or_none(getattr(motion, field_name)) for field_name in number_field_names}


def _finite_or_none(value):
    return float(value) if math.isfinite(value) else None
