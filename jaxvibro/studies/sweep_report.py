"""Format a swept diagram as a table; also the motion from rest, for a scene file without analyses."""

from ..output.table_text import align_columns, column_header
from ..output.units import LENGTH, SPEED, unit_in_system, unit_of
from .scene_file_studies import DEFAULT_KEEP, DEFAULT_SETTLE
from .sweep_periods import MAX_EXTRA_PERIODS, max_recurrence_period

IRREGULAR = {
    "chaotic": "the largest Lyapunov exponent is positive",
    "not settled": "a transient: more periods must be discarded",
    "undecided": f"none of these within {MAX_EXTRA_PERIODS} further periods",
}


def sweep_lines(results, units):
    """Yield the lines of the table of a sweep, or of the motion from rest without a [sweep]."""
    sweep_table = results.file.sweep
    if sweep_table is None:
        yield from _motion_from_rest_lines(results, units)
        return
    unit, unit_factor = unit_in_system(results.scene, unit_of(sweep_table.parameter), units)
    settle_keep_text = f"{sweep_table.settle} periods settled, {sweep_table.keep} kept"
    yield f"sweep of {sweep_table.parameter}: {sweep_table.count} values, {settle_keep_text}"
    rows = [("leg", column_header("from", unit, units), column_header("to", unit, units), "values", "periods")]
    rows += [
        (
            stretch.leg,
            unit_factor * stretch.first,
            unit_factor * stretch.last,
            stretch.count,
            _period_or_motion_kind(stretch),
        )
        for stretch in results.stretches
    ]
    yield align_columns(rows)
    yield _periods_explanation(results)
    if "stopped" in results.swept.attrs:
        yield results.swept.attrs["stopped"]


def _motion_from_rest_lines(results, units):
    """Yield the lines of the table of the motion from rest."""
    sweep_data, ((x_heading, x_factor), (v_heading, v_factor)) = results.swept, state_headings(results, units)
    (stretch,), last_state = results.stretches, sweep_data.isel(step=0, leg=0, period=-1)
    yield f"from rest, after {DEFAULT_SETTLE + DEFAULT_KEEP} drive periods, at phase 0 of the drive"
    rows = [
        (x_heading, f"{x_factor * float(last_state['x']):.12f}"),
        (v_heading, f"{v_factor * float(last_state['v']):.12f}"),
    ]
    rows += [("periods", _period_or_motion_kind(stretch))]
    yield align_columns(rows)
    yield _periods_explanation(results)


def state_headings(results, units):
    """Return (column header with unit, conversion factor) for x and for v."""
    unit_conversions = (
        (coordinate_name, *unit_in_system(results.scene, unit, units))
        for coordinate_name, unit in (("x", LENGTH), ("v", SPEED))
    )
    return [
        (column_header(coordinate_name, unit, units), unit_factor)
        for coordinate_name, unit, unit_factor in unit_conversions
    ]


def _period_or_motion_kind(stretch):
    """Return the number of drive periods of a periodic motion, or the kind of any other motion."""
    return stretch.periods if stretch.motion == "periodic" else stretch.motion


def _periods_explanation(results):
    """Return the explanation of the entries in the column "periods"."""
    motion_meanings = [
        f"{motion_kind}: {IRREGULAR[motion_kind]}"
        for motion_kind in IRREGULAR
        if any(stretch.motion == motion_kind for stretch in results.stretches)
    ]
    long_period_note = (
        f"above {max_recurrence_period(results.swept)} found by continuing the motion"
        if any((stretch.periods or 0) > max_recurrence_period(results.swept) for stretch in results.stretches)
        else ""
    )
    return "; ".join(
        filter(None, ["periods: drive periods after which the state recurs", long_period_note, *motion_meanings])
    )
