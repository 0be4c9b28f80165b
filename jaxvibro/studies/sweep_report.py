"""The text of a swept diagram, and of the motion from rest where no study was asked for."""

from ..output.table_text import columns, headed
from ..output.units import LENGTH, SPEED, unit_in, unit_of
from .compute import KEEP, SETTLE
from .sweep_periods import PATIENCE, longest

IRREGULAR = {
    "chaotic": "the largest Lyapunov exponent is positive",
    "not settled": "a transient: more periods have to be left out",
    "undecided": f"none of these within {PATIENCE} periods more",
}


def lines(found, units):
    """The lines of the table."""
    asked = found.file.sweep
    if asked is None:
        yield from _rest(found, units)
        return
    unit, size = unit_in(found.scene, unit_of(asked.parameter), units)
    yield f"sweep of {asked.parameter}: {asked.count} values, {asked.settle} periods settled, {asked.keep} kept"
    rows = [("leg", headed("from", unit, units), headed("to", unit, units), "values", "periods")]
    rows += [(one.leg, size * one.first, size * one.last, one.count, _periods(one)) for one in found.stretches]
    yield columns(rows)
    yield _meaning(found)
    if "stopped" in found.swept.attrs:
        yield found.swept.attrs["stopped"]


def _rest(found, units):
    swept, ((x, wide), (v, high)) = found.swept, plane(found, units)
    (one,), last = found.stretches, swept.isel(step=0, leg=0, period=-1)
    yield f"from rest, after {SETTLE + KEEP} drive periods, at phase 0 of the drive"
    rows = [(x, f"{wide * float(last['x']):.12f}"), (v, f"{high * float(last['v']):.12f}")]
    rows += [("periods", _periods(one))]
    yield columns(rows)
    yield _meaning(found)


def plane(found, units):
    """(name with its unit, how much of it one of the scene's is) of x and of v."""
    known = ((name, *unit_in(found.scene, unit, units)) for name, unit in (("x", LENGTH), ("v", SPEED)))
    return [(headed(name, unit, units), size) for name, unit, size in known]


def _periods(one):
    return one.periods if one.motion == "periodic" else one.motion


def _meaning(found):
    """The meaning of the column of periods."""
    told = [f"{name}: {IRREGULAR[name]}" for name in IRREGULAR if any(one.motion == name for one in found.stretches)]
    long = (
        f"above {longest(found.swept)} found by running on"
        if any((one.periods or 0) > longest(found.swept) for one in found.stretches)
        else ""
    )
    return "; ".join(filter(None, ["periods: drive periods after which the state comes back", long, *told]))
