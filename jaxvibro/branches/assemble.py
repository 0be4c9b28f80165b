"""From the pieces of a walk to a `Branch`: its data, segments and special points."""

from dataclasses import replace

import numpy as np
import xarray as xr

from continuation.stretch import backwards, glued

from ..orbits.orbit import MARGIN, roots
from ..output.units import LENGTH, SPEED, TIME, scales_in, unit_of
from ..problem.end import End
from ..problem.equations import are_impacts, codes
from ..problem.orbit_on_branch import OrbitPoint, is_own_image, itinerary, label_of
from ..problem.orbit_rows import spot_of
from ..scene.symmetry import is_symmetric
from .branch import Branch, Segment, frequency_at, scene_at, special_of
from .impossible import require_damped, require_possible

START = End.START.reason()


def assemble(scene, name, bounds, settings, back, on, start=START):
    """The `Branch` of what was walked from a start backwards and onwards; either may be None. start: the `Reason` of
    that end."""
    pieces = [backwards(one) for one in reversed(back.pieces)] if back else []
    if back and on:
        pieces[-1] = glued([pieces[-1], on.pieces[0]])
        pieces += on.pieces[1:]
    elif on:
        pieces = on.pieces
    ends, reasons = zip(back.reason if back else start, on.reason if on else start, strict=True)
    data, segments, special = _told(scene, name, bounds, pieces)
    settings = {key: each for key, each in settings.items() if key != "limits"}
    return Branch(name, bounds, scene, data, segments, special, reasons, settings, ends)


def merge(one, other):
    """Two branches as one, the second, of two points at least, beginning where the first ends."""
    shift = len(one) - 1
    widest = max(one.data.sizes["impact"], other.data.sizes["impact"])
    more = other.data.isel(point=slice(1, None))
    more = more.assign(segment=more["segment"] + one.data["segment"].values[-1])
    data = xr.concat([_widened(one.data, widest), _widened(more, widest)], "point")
    moved = [replace(each, first=each.first + shift, last=each.last + shift) for each in other.segments]
    last = replace(one.segments[-1], last=moved[0].last)
    special = (*one.special, *(replace(each, place=each.place + shift) for each in other.special))
    return replace(
        one,
        data=data,
        segments=(*one.segments[:-1], last, *moved[1:]),
        special=tuple(each for each in special if each.kind != "EP" or each.place != shift),
        reasons=(one.reasons[0], other.reasons[1]),
        ends=(one.ends[0], other.ends[1]),
    )


def _widened(data, widest):
    """The data with room for so many impacts."""
    room = {"impact": (0, widest - data.sizes["impact"])}
    if not room["impact"][1]:
        return data
    sides = data["side"].pad(room, constant_values=0)
    return data.drop_vars("side").pad(room).assign(side=sides)


def _told(scene, name, bounds, pieces):
    """(the data, `Segment`s, `Special`s) of the pieces. Raises ImpossibleError."""
    widest = max(int(np.sum(one.args.cycle.sides != 0)) for one in pieces)
    parts = [columns_of(one, name, widest, k) for k, one in enumerate(pieces)]
    whole = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    meant = about(name)
    data = {key: xr.Variable(meant[key][0], each, meant[key][1]) for key, each in whole.items()}

    def row_at(place):
        return {key: each[place] for key, each in whole.items()}

    segments, special, first = [], [], 0
    marked = set()
    for one in pieces:
        row, size = row_at(first), len(one.points.z)
        walls = itinerary(spot_of(row, name), frequency_at(scene, name, float(row[name])))
        segments.append(Segment(first, first + size - 1, label_of(scene, spot_of(row, name), walls), walls))
        for mark in one.marks:
            place = first + mark.place
            known = mark.kind == "GR" and place - 1 in marked  # the same grazing, met from the other piece
            if not known:
                special.append(_special(scene, name, bounds, mark, place, row_at(place)))
            if mark.kind == "GR":
                marked.add(place)
        first += size
    for place in (0, first - 1):
        if not any(one.place == place for one in special):
            row = row_at(place)
            special.append(special_of(scene, name, bounds, place, row, "EP", float(row["residual"])))
    special = tuple(sorted(special, key=lambda one: one.place))
    if scene.force is None:
        require_damped(name, whole[name], whole["multiplier_real"] + 1j * whole["multiplier_imag"])
    require_possible(special)
    return xr.Dataset(data, attrs={"parameter": name, **scales_in(scene)}), tuple(segments), special


def columns_of(one, name, widest, place):
    """What a branch's data have of a piece: {name: array}, a row a point."""
    z, turn, look = one.points.z, one.points.tangent, one.view
    count, rows, size = int(np.sum(one.args.cycle.sides != 0)), len(one.args.cycle.sides), len(one.points.z)

    def impacts(values, fill):
        found = np.full((size, widest), fill)
        found[:, :count] = values
        return found

    sides = np.broadcast_to(codes(one.args.cycle)[:count], (size, count))
    slow = z[:, rows : rows + count] if rows else z[:, :0]
    quick = turn[:, rows : rows + count] if rows else slow
    found = roots(look.trace, look.determinant)
    return {
        name: z[:, -1],
        "time": impacts(z[:, :count] if rows else slow, np.nan),
        "speed": impacts(slow, np.nan),
        "side": impacts(sides, 0).astype(np.int8),
        "x": look.x,
        "v": look.v,
        "multiplier_real": found.real,
        "multiplier_imag": found.imag,
        "stable": (abs(found) < 1.0 - MARGIN).all(axis=1).astype(np.int8),
        "least_speed": slow[:, are_impacts(one.args.cycle)[:count]].min(axis=1, initial=np.inf),
        "least_clearance": look.clear.min(axis=(1, 2), initial=np.inf),
        "residual": one.points.residual,
        "time_slope": impacts(turn[:, :count] if rows else slow, np.nan),
        "speed_slope": impacts(quick, np.nan),
        "value_slope": turn[:, -1],
        "segment": np.full(size, place),
    }


def about(name):
    """The dimensions, what it is and the units of each column."""

    def told(meaning, units, *more):
        return ("point", *more), {"long_name": meaning, "units": units}

    return {
        name: (("point",), {"long_name": "the parameter", "units": unit_of(name)}),
        "time": told("since phase 0", TIME, "impact"),
        "speed": told("abs(y- - v_b)", SPEED, "impact"),
        "side": told("-1 left, 1 right, 0 none; 2 or 3 times that: its wall lets the mass go", "1", "impact"),
        "x": told("position at phase 0 of each period", LENGTH, "period"),
        "v": told("velocity at phase 0 of each period", SPEED, "period"),
        "multiplier_real": told("Floquet's, the larger first", "1", "multiplier"),
        "multiplier_imag": told("Floquet's, the larger first", "1", "multiplier"),
        "stable": told("1: both are smaller than 1", "1"),
        "least_speed": told("of the impacts, inf: none", SPEED),
        "least_clearance": told("at turning points, inf: none", LENGTH),
        "residual": told("largest error left in the equations", LENGTH),
        "time_slope": told("of the unit tangent", "1", "impact"),
        "speed_slope": told("of the unit tangent", "1", "impact"),
        "value_slope": told("of the unit tangent", "1"),
        "segment": told("which stretch of one itinerary", "1"),
    }


def _special(scene, name, bounds, mark, place, row):
    kind = mark.kind
    if kind == "BP" and is_symmetric(scene):
        spot = spot_of(row, name)
        kind = "SB" if is_own_image(scene_at(scene, name, spot.value), spot) else kind
    joins, aside = ([_joined(way) for way in mark.more.exits], mark.more.aside) if mark.more else ((), ())
    return special_of(scene, name, bounds, place, row, kind, mark.residual, joins, aside)


def _joined(way):
    """The `OrbitPoint` of an `GrazingExit`."""
    along, z = way.along, way.near
    count, rows = int(np.sum(along.cycle.sides != 0)), len(along.cycle.sides)
    look = way.look
    sides = np.asarray(codes(along.cycle)[:count])
    periods, start = int(along.cycle.periods), (float(look.x[0, 0]), float(look.v[0, 0]))
    return OrbitPoint(
        float(z[-1]),
        z[:count] if rows else z[:0],
        z[rows : rows + count] if rows else z[:0],
        sides,
        periods,
        *start,
        0.0,
    )
