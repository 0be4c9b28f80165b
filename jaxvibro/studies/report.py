"""Format the results of a run as a table for reading and as a summary for machines."""

import math

import msgspec

from .. import __version__
from ..attractors.shares import share_text
from ..branches.branch import KIND_NAMES, describe_extent, neighbour_labels
from ..branches.branch_tree import mirror_images
from ..design.records import ImpactRecord
from ..loci.locus import MEANINGS as ON_LOCI
from ..maps.initial_conditions import box_text, initial_box
from ..output.table_text import align_columns, multipliers_text
from ..output.units import LENGTH, SPEED, quantity_text, unit_in_system, unit_of
from ..problem.end import End
from . import map_report, sweep_report
from .sweep_report import state_headings

CHATTER_NOTE = "inf: the mass sticks after complete chatter; impacts lists the bounces before this is certain"


def results_table(results, name, units="scene"):
    """Format the scene and all results of a run as a text, in units "scene" or "physical"."""
    lines = [f"jaxvibro {__version__}, {name}\n", align_columns(_parameter_rows(results.scene, units))]
    sections = [
        (results.swept, sweep_report.sweep_lines),
        (results.attractors, _attractor_lines),
        (results.orbits, _orbit_lines),
        (results.branches, _branch_lines),
    ]
    sections += [(results.loci, _locus_lines), (results.margin, _margin_lines), (results.fit, _fit_lines)]
    for value, section_lines in sections:
        if value is not None:
            lines += ["", *section_lines(results, units)]
    if results.map is not None:
        lines += ["", *map_report.map_lines(results.map, units)]
    return "\n".join(lines) + "\n"


def _parameter_rows(scene, units):
    """Return rows of the scene's parameters, converted to physical units if chosen."""
    values = {name: value for name, value in scene.numbers.items() if name != "restitution" or scene.shares_restitution}
    if units == "scene":
        return list(values.items())
    conversions = {name: unit_in_system(scene, unit_of(name), units) for name in scene.names}
    return [(name, value * conversions[name][1], conversions[name][0]) for name, value in values.items()]


def _attractor_lines(results, units):
    table, ((x_heading, x_factor), (v_heading, v_factor)) = results.file.attractors, state_headings(results, units)
    location = _values_text(results, table, units)
    yield f"attractors at {location}, from {table.starts} starts (seed {table.seed}); x and v at phase 0"
    starts_text = box_text(results.scene_of_table(table), _scales(results, units))
    yield f"starts: random at phase 0, {starts_text}; shares with 95 % bounds"
    rows = [("", "label", "share", "periods", x_heading, v_heading, "impacts", "exponent", "rests", "mirror image")]
    for number, attractor in enumerate(results.attractors, 1):
        state = (f"{x_factor * attractor.state.x:.12f}", f"{v_factor * attractor.state.v:.12f}")
        share, exponent = share_text(attractor), f"{attractor.exponent:.4f}"
        itinerary, mirror = _itinerary(attractor.itinerary), _mirror(number, attractor.mirror_of)
        rows.append(
            (
                number,
                attractor.label,
                share,
                attractor.periods or "-",
                *state,
                itinerary,
                exponent,
                _yes_or_dash(attractor.rests),
                mirror,
            )
        )
    yield align_columns(rows)
    yield "impacts: L left, R right, one word per period; exponent: the largest Lyapunov exponent, per drive period"
    if any(attractor.rests for attractor in results.attractors):
        yield CHATTER_NOTE
    for number, attractor in enumerate(results.attractors, 1):
        yield f"{number}: {attractor.note}"


def _scales(results, units):
    return results.scene.scales if units == "physical" else None


def _range_text(results, units, name, lower, upper):
    lower_text, upper_text = (quantity_text(_scales(results, units), unit_of(name), value) for value in (lower, upper))
    return f"from {lower_text} to {upper_text}"


def _start_text(results, table, units):
    scales = _scales(results, units)
    x_text, v_text = quantity_text(scales, LENGTH, table.start.x), quantity_text(scales, SPEED, table.start.v)
    return f"x = {x_text}, v = {v_text} at {_values_text(results, table, units)}"


def _values_text(results, table, units):
    scales = _scales(results, units)
    assignments = (f"{key} = {quantity_text(scales, unit_of(key), value)}" for key, value in table.at.items())
    return ", ".join(assignments) or "the scene's own values"


def _yes_or_dash(rests):
    return "yes" if rests else "-"


def _itinerary(itinerary):
    return " ".join(word or "." for word in itinerary) or "-"


def _orbit_lines(results, units):
    table, ((x_heading, x_factor), (v_heading, v_factor)) = results.file.orbits, state_headings(results, units)
    details = f"max_period {table.max_period}, near trajectories from {table.starts} starts (seed {table.seed})"
    yield f"periodic orbits at {_values_text(results, table, units)}, {details}: {len(results.orbits) or 'none'} found"
    if not results.orbits:
        return
    has_phases = any(orbit.state.phase for orbit in results.orbits)
    headings = ("", "label", "", "multipliers", x_heading, v_heading, "phase", "impacts")
    rows = [(*headings, f"least speed{v_heading[1:]}", f"least clearance{x_heading[1:]}", "residual", "mirror image")]
    for number, orbit in enumerate(results.orbits, 1):
        coordinates = x_factor * orbit.state.x, v_factor * orbit.state.v, orbit.state.phase
        state = [f"{coordinate:.12f}" for coordinate in coordinates]
        minima = (v_factor * float(orbit.least_speed), x_factor * float(orbit.least_clearance), f"{orbit.residual:.1e}")
        stability = "stable" if orbit.stable else "unstable"
        details = (
            orbit.label,
            stability + ", rests" if orbit.rests else stability,
            multipliers_text(orbit.multipliers, 7),
        )
        rows.append((number, *details, *state, _itinerary(orbit.itinerary), *minima, _mirror(number, orbit.mirror_of)))
    yield align_columns(rows if has_phases else [row[:6] + row[7:] for row in rows])
    phase_text = "at the phase (rad) given" if has_phases else "at phase 0"
    yield f"x and v {phase_text}; impacts: L left, R right, one word per period; multipliers: Floquet, the larger first"
    if any(orbit.rests for orbit in results.orbits):
        yield CHATTER_NOTE


def _branch_lines(results, units):
    table, (lower, upper) = results.file.branch_table, results.file.branch_table.bounds
    if results.diagram is None:
        origin_text = f"from {_start_text(results, table, units)}, max_period {table.max_period}"
    else:
        origin_text = (
            f"from many starts at {_values_text(results, table, units)}, max_period {table.max_period}"
            f" (seed {table.seed})"
        )
    range_text = _range_text(results, units, table.parameter, lower, upper)
    yield f"branches of periodic orbits for {table.parameter} {range_text}, {origin_text}: {len(results.branches)}"
    if results.diagram is not None:
        yield results.diagram.reason
    mirror_of = mirror_images(results.branches)
    mirror_branches = {j: (k, results.branches[k]) for k, j in mirror_of.items()}
    for number, branch in ((k + 1, branch) for k, branch in enumerate(results.branches) if k not in mirror_of):
        extent_text = describe_extent(branch, unit_in_system(branch.scene, unit_of(branch.name), units)[1])
        yield f"\n{number}: {branch.segments[0].label} {extent_text}, {len(branch)} points"
        if number - 1 in mirror_branches:
            twin_index, mirror_branch = mirror_branches[number - 1]
            yield f"its mirror image is {twin_index + 1}: {mirror_branch.segments[0].label}, with the same values"
        yield branch.table(units)
    yield f"\n{_meanings_text(KIND_NAMES)}"
    yield "multipliers: Floquet, the larger first; meets: orbits that meet there, with their side of the value"


def _locus_lines(results, units):
    bounds = results.file.locus.bounds
    bounds_text = " and ".join(
        f"{name} {_range_text(results, units, name, *limits)}" for name, limits in bounds.items()
    )
    yield f"loci of special points in {bounds_text}: {len(results.loci)}"
    for number, item in enumerate(results.loci, 1):
        yield f"\n{number}: {item.kind} of {item.label}, {len(item)} points"
        yield item.table(units)
    for item, reason in results.refused_points:
        yield f"\nnot followed: {item.kind} of {item.label} at {item.name} = {item.value:.12g}: {reason}"
    yield f"\n{_meanings_text(ON_LOCI)}; SN, PD, SB on a GR: such a locus ends there"


def _margin_lines(results, units):
    table = results.file.margin
    yield f"nearest bifurcations of the orbit reached from {_start_text(results, table, units)}"
    yield results.margin.table(units)
    yield _meanings_text({kind: KIND_NAMES[kind] for kind in table.kinds})


def _fit_lines(results, units):
    record_kind = "impacts" if isinstance(results.record, ImpactRecord) else "samples"
    yield f"parameters fitted to the {len(results.record.times)} {record_kind} of {results.file.fit.record}"
    yield results.fit.table(units)


def _meanings_text(meanings):
    return ", ".join(f"{kind} {meaning}" for kind, meaning in meanings.items())


def _mirror(number, mirror_index):
    """Return the number of a mirror image, "itself" or "-"."""
    if mirror_index is None:
        return "-"
    return "itself" if mirror_index + 1 == number else f"{mirror_index + 1}"


def summary(results, files):
    """Return the results of a run as plain dicts, lists, texts and numbers; numbers that are not finite are None."""
    record = {"version": __version__, "files": files, "job": msgspec.to_builtins(results.file)}
    if results.swept is not None:
        record["stretches"] = [msgspec.to_builtins(item) for item in results.stretches]
    if results.attractors is not None:
        record["starts"] = dict(zip(("left", "right", "fast"), _start_box(results), strict=True))
        record["attractors"] = [_attractor_record(item) for item in results.attractors]
    if results.orbits is not None:
        record["orbits"] = [_orbit_record(item) for item in results.orbits]
    if results.branches is not None:
        mirror_of = mirror_images(results.branches)
        record["branches"] = [
            _branch_record(item) | {"mirror_of": mirror_of.get(k)} for k, item in enumerate(results.branches)
        ]
    if results.diagram is not None:
        record["explored"] = {"complete": results.diagram.complete, "reason": results.diagram.reason}
    if results.loci is not None:
        record["loci"] = [_locus_record(item) for item in results.loci]
        record["not_followed"] = [
            {"kind": item.kind, "label": item.label, "value": item.value, "reason": reason}
            for item, reason in results.refused_points
        ]
    if results.margin is not None:
        record["margin"] = [_near_point_record(item) for item in results.margin.points]
    if results.fit is not None:
        record["fit"] = _fit_record(results.fit)
    if results.map is not None:
        record["map"] = map_report.label_counts(results.map)
    return record


def _start_box(results):
    return (float(limit) for limit in initial_box(results.scene_of_table(results.file.attractors)))


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
    """Return the record of an orbit; multipliers are pairs of real and imaginary part."""
    return {
        "stable": orbit.stable,
        "rests": orbit.rests,
        "unknowns": orbit.unknowns,
        "multipliers": _complex_pairs(orbit.multipliers),
        **_motion_fields(orbit, ("residual", "least_speed", "least_clearance")),
    }


def _complex_pairs(multipliers):
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
        "special": [_special_record(special) for special in branch.special],
    }


def _locus_record(locus):
    return {
        "kind": locus.kind,
        "label": locus.label,
        "parameters": list(locus.names),
        "points": len(locus),
        "reasons": list(locus.reasons),
        "special": [{"values": special.values, **_special_fields(special)} for special in locus.special],
    }


def _special_record(special):
    return {"value": special.value, **_special_fields(special), "meets": neighbour_labels(special)}


def _special_fields(special):
    """Return the common fields of special points of branches and of loci."""
    return {
        "kind": special.kind,
        "label": special.label,
        "itinerary": list(special.itinerary),
        "multipliers": _complex_pairs(special.multipliers),
        "residual": _finite_or_none(special.residual),
        "place": int(special.place),
    }


def _near_point_record(point):
    return {
        "kind": point.kind,
        "distance": point.distance,
        "change": point.change,
        "status": point.status,
        "edge": point.edge,
        "at_bound": list(point.at_bound),
        "residual": _finite_or_none(point.residual),
    }


def _fit_record(fit):
    return {
        "status": fit.status.name,
        "values": fit.values,
        "sigma": {name: _finite_or_none(sigma) for name, sigma in fit.sigma.items()},
        "chi2": _finite_or_none(fit.chi2),
        "dof": fit.dof,
        "not_in_the_record": [item.shares for item in fit.unidentifiable],
        "missed": [list(item) for item in fit.missed],
        "spurious": list(fit.spurious),
    }


def _motion_fields(motion, field_names):
    """Return the common fields of attractors and orbits, and the numbers in `field_names`."""
    return {
        "label": motion.label,
        "periods": motion.periods,
        "itinerary": list(motion.itinerary),
        "state": {key: _finite_or_none(getattr(motion.state, key)) for key in ("x", "v", "phase", "contact")},
        "mirror_of": motion.mirror_of,
    } | {key: _finite_or_none(getattr(motion, key)) for key in field_names}


def _finite_or_none(value):
    return float(value) if math.isfinite(value) else None
