"""Format a swept diagram, or the motion from rest of a file without analyses."""

from ..output.table_text import align_columns, column_header
from ..output.units import LENGTH, SPEED, unit_in_system, unit_of
from .compute import DEFAULT_KEEP, DEFAULT_SETTLE
from .sweep_periods import MAX_EXTRA_PERIODS, max_recorded_period

IRREGULAR = {
    "chaotic": "the largest Lyapunov exponent is positive",
    "not settled": "a transient: more periods must be discarded",
    "undecided": f"none of these within {MAX_EXTRA_PERIODS} further periods",
}


def sweep_lines(results, units):
    """Iterate over the lines of the table."""
    table = results.file.sweep
    if table is None:
        yield from _rest_lines(results, units)
        return
    unit, factor = unit_in_system(results.scene, unit_of(table.parameter), units)
    yield f"sweep of {table.parameter}: {table.count} values, {table.settle} periods settled, {table.keep} kept"
    rows = [("leg", column_header("from", unit, units), column_header("to", unit, units), "values", "periods")]
    rows += [
        (stretch.leg, factor * stretch.first, factor * stretch.last, stretch.count, _periods_text(stretch))
        for stretch in results.stretches
    ]
    yield align_columns(rows)
    yield _meaning_text(results)
    if "stopped" in results.swept.attrs:
        yield results.swept.attrs["stopped"]


def _rest_lines(results, units):
    """Iterate over the lines of the motion from rest."""
    sweep_data, ((x_heading, x_factor), (v_heading, v_factor)) = results.swept, state_headings(results, units)
    (stretch,), last_state = results.stretches, sweep_data.isel(step=0, leg=0, period=-1)
    yield f"from rest, after {DEFAULT_SETTLE + DEFAULT_KEEP} drive periods, at phase 0 of the drive"
    rows = [
        (x_heading, f"{x_factor * float(last_state['x']):.12f}"),
        (v_heading, f"{v_factor * float(last_state['v']):.12f}"),
    ]
    rows += [("periods", _periods_text(stretch))]
    yield align_columns(rows)
    yield _meaning_text(results)


def state_headings(results, units):
    """Return (heading with unit, conversion factor) for x and for v."""
    conversions = ((name, *unit_in_system(results.scene, unit, units)) for name, unit in (("x", LENGTH), ("v", SPEED)))
    return [(column_header(name, unit, units), factor) for name, unit, factor in conversions]


def _periods_text(stretch):
    """Return the number of periods, or the kind of a motion that is not periodic."""
    return stretch.periods if stretch.motion == "periodic" else stretch.motion


def _meaning_text(results):
    """Return the explanation of the column of periods."""
    meanings = [
        f"{name}: {IRREGULAR[name]}"
        for name in IRREGULAR
        if any(stretch.motion == name for stretch in results.stretches)
    ]
    long_note = (
        f"above {max_recorded_period(results.swept)} found by continuing the motion"
        if any((stretch.periods or 0) > max_recorded_period(results.swept) for stretch in results.stretches)
        else ""
    )
    return "; ".join(filter(None, ["periods: drive periods after which the state recurs", long_note, *meanings]))
