"""What was found, for reading and for machines."""

import math

import msgspec

from .. import __version__
from ..attractors.shares import share_text
from ..branches.branch import MEANINGS, extent, labels_of
from ..branches.branch_tree import mirror_images
from ..design.records import ImpactRecord
from ..loci.locus import MEANINGS as ON_LOCI
from ..maps.initial_conditions import box, box_text
from ..output.table_text import columns, pair
from ..output.units import LENGTH, SPEED, amount_text, unit_in, unit_of
from ..problem.end import End
from . import map_report, sweep_report
from .sweep_report import plane

RESTS = "inf: the mass comes to rest by infinitely many hops, of which impacts has those before they are sure to end"


def table(found, name, units="scene"):
    """A text: the scene, the stretches of the sweep, the attractors, the orbits, the branches, the loci. units: "scene"
    or "physical"."""
    parts = [f"jaxvibro {__version__}, {name}\n", columns(_numbers(found.scene, units))]
    asked = [
        (found.swept, sweep_report.lines),
        (found.attractors, _attractors),
        (found.orbits, _orbits),
        (found.branches, _branches),
    ]
    asked += [(found.loci, _loci), (found.margin, _margin), (found.fit, _fit)]
    for one, told in asked:
        if one is not None:
            parts += ["", *told(found, units)]
    if found.map is not None:
        parts += ["", *map_report.lines(found.map, units)]
    return "\n".join(parts) + "\n"


def _numbers(scene, units):
    """The scene's parameters, in physical units with these."""
    numbers = {name: each for name, each in scene.numbers.items() if name != "restitution" or scene.shares_restitution}
    if units == "scene":
        return list(numbers.items())
    known = {name: unit_in(scene, unit_of(name), units) for name in scene.names}
    return [(name, value * known[name][1], known[name][0]) for name, value in numbers.items()]


def _attractors(found, units):
    asked, ((x, wide), (v, high)) = found.file.attractors, plane(found, units)
    where = _at(found, asked, units)
    yield f"attractors at {where}, from {asked.starts} starts (seed {asked.seed}); x and v at phase 0"
    area = box_text(found.there(asked), _scales(found, units))
    yield f"starts: random at phase 0, {area}; their shares with bounds at 95 %"
    rows = [("", "label", "share", "periods", x, v, "impacts", "exponent", "rests", "mirror image")]
    for place, one in enumerate(found.attractors, 1):
        state = (f"{wide * one.state.x:.12f}", f"{high * one.state.v:.12f}")
        share, rate = share_text(one), f"{one.exponent:.4f}"
        walls, twin = _walls(one.itinerary), _mirror(place, one.mirror_of)
        rows.append((place, one.label, share, one.periods or "-", *state, walls, rate, _yes(one.rests), twin))
    yield columns(rows)
    yield "impacts: L left, R right, a word a period; exponent: the largest, per drive period"
    if any(one.rests for one in found.attractors):
        yield RESTS
    for place, one in enumerate(found.attractors, 1):
        yield f"{place}: {one.note}"


def _scales(found, units):
    return found.scene.scales if units == "physical" else None


def _span(found, units, name, low, high):
    one, other = (amount_text(_scales(found, units), unit_of(name), value) for value in (low, high))
    return f"from {one} to {other}"


def _start(found, asked, units):
    scales = _scales(found, units)
    x, v = amount_text(scales, LENGTH, asked.start.x), amount_text(scales, SPEED, asked.start.v)
    return f"x = {x}, v = {v} at {_at(found, asked, units)}"


def _at(found, asked, units):
    scales = _scales(found, units)
    told = (f"{key} = {amount_text(scales, unit_of(key), value)}" for key, value in asked.at.items())
    return ", ".join(told) or "the scene's own values"


def _yes(rests):
    return "yes" if rests else "-"


def _walls(itinerary):
    return " ".join(word or "." for word in itinerary) or "-"


def _orbits(found, units):
    asked, ((x, wide), (v, high)) = found.file.orbits, plane(found, units)
    told = f"max_period {asked.max_period}, near trajectories from {asked.starts} starts (seed {asked.seed})"
    yield f"periodic orbits at {_at(found, asked, units)}, {told}: {len(found.orbits) or 'none'} found"
    if not found.orbits:
        return
    turned = any(one.state.phase for one in found.orbits)
    names = ("", "label", "", "multipliers", x, v, "phase", "impacts")
    rows = [(*names, f"least speed{v[1:]}", f"least clearance{x[1:]}", "residual", "mirror image")]
    for place, one in enumerate(found.orbits, 1):
        parts = wide * one.state.x, high * one.state.v, one.state.phase
        state = [f"{each:.12f}" for each in parts]
        least = (high * float(one.least_speed), wide * float(one.least_clearance), f"{one.residual:.1e}")
        kind = "stable" if one.stable else "unstable"
        told = (one.label, kind + ", rests" if one.rests else kind, pair(one.multipliers, 7))
        rows.append((place, *told, *state, _walls(one.itinerary), *least, _mirror(place, one.mirror_of)))
    yield columns(rows if turned else [row[:6] + row[7:] for row in rows])
    where = "at the phase (rad) given" if turned else "at phase 0"
    yield f"x and v {where}; impacts: L left, R right, a word a period; multipliers: Floquet's, the larger first"
    if any(one.rests for one in found.orbits):
        yield RESTS


def _branches(found, units):
    asked, (low, high) = found.file.followed, found.file.followed.bounds
    if found.diagram is None:
        start = f"from {_start(found, asked, units)}, max_period {asked.max_period}"
    else:
        start = f"from many starts at {_at(found, asked, units)}, max_period {asked.max_period} (seed {asked.seed})"
    span = _span(found, units, asked.parameter, low, high)
    yield f"branches of periodic orbits for {asked.parameter} {span}, {start}: {len(found.branches)}"
    if found.diagram is not None:
        yield found.diagram.reason
    images = mirror_images(found.branches)
    twins = {j: (k, found.branches[k]) for k, j in images.items()}
    for place, one in ((k + 1, one) for k, one in enumerate(found.branches) if k not in images):
        between = extent(one, unit_in(one.scene, unit_of(one.name), units)[1])
        yield f"\n{place}: {one.segments[0].label} {between}, {len(one)} points"
        if place - 1 in twins:
            twin, image = twins[place - 1]
            yield f"its mirror image is {twin + 1}: {image.segments[0].label}, with the same values"
        yield one.table(units)
    yield f"\n{_meanings(MEANINGS)}"
    yield "multipliers: Floquet's, the larger first; meets: orbits that meet there, on which side of the value"


def _loci(found, units):
    bounds = found.file.locus.bounds
    where = " and ".join(f"{name} {_span(found, units, name, *pair)}" for name, pair in bounds.items())
    yield f"loci of special points in {where}: {len(found.loci)}"
    for place, one in enumerate(found.loci, 1):
        yield f"\n{place}: {one.kind} of {one.label}, {len(one)} points"
        yield one.table(units)
    for one, why in found.refused:
        yield f"\nnot followed: {one.kind} of {one.label} at {one.name} = {one.value:.12g}: {why}"
    yield f"\n{_meanings(ON_LOCI)}; SN, PD, SB on a GR: such a locus ends there"


def _margin(found, units):
    asked = found.file.margin
    yield f"nearest bifurcations of the orbit that is settled on from {_start(found, asked, units)}"
    yield found.margin.table(units)
    yield _meanings({kind: MEANINGS[kind] for kind in asked.kinds})


def _fit(found, units):
    what = "impacts" if isinstance(found.record, ImpactRecord) else "samples"
    yield f"numbers fitted to the {len(found.record.times)} {what} of {found.file.fit.record}"
    yield found.fit.table(units)


def _meanings(meanings):
    return ", ".join(f"{kind} {meaning}" for kind, meaning in meanings.items())


def _mirror(place, twin):
    if twin is None:
        return "-"
    return "itself" if twin + 1 == place else f"{twin + 1}"


def summary(found, files):
    """The same as plain dicts, lists, texts and numbers; what is not finite is None."""
    told = {"version": __version__, "files": files, "job": msgspec.to_builtins(found.file)}
    if found.swept is not None:
        told["stretches"] = [msgspec.to_builtins(one) for one in found.stretches]
    if found.attractors is not None:
        told["starts"] = dict(zip(("left", "right", "fast"), _box(found), strict=True))
        told["attractors"] = [_attractor(one) for one in found.attractors]
    if found.orbits is not None:
        told["orbits"] = [_orbit(one) for one in found.orbits]
    if found.branches is not None:
        images = mirror_images(found.branches)
        told["branches"] = [_branch(one) | {"mirror_of": images.get(k)} for k, one in enumerate(found.branches)]
    if found.diagram is not None:
        told["explored"] = {"complete": found.diagram.complete, "reason": found.diagram.reason}
    if found.loci is not None:
        told["loci"] = [_locus(one) for one in found.loci]
        told["not_followed"] = [
            {"kind": one.kind, "label": one.label, "value": one.value, "reason": why} for one, why in found.refused
        ]
    if found.margin is not None:
        told["margin"] = [_near(one) for one in found.margin.points]
    if found.fit is not None:
        told["fit"] = _fitted(found.fit)
    if found.map is not None:
        told["map"] = map_report.counts(found.map)
    return told


def _box(found):
    return (float(edge) for edge in box(found.there(found.file.attractors)))


def _attractor(one):
    return {
        "kind": one.kind,
        "share_bounds": list(one.share_bounds),
        "starts": one.starts,
        "rests": one.rests,
        "points": one.points.tolist() if one.periods else [],
        "note": one.note,
        **_plain(one, ("share", "least_speed", "exponent")),
    }


def _orbit(one):
    """Multipliers are pairs, real and imaginary part."""
    return {
        "stable": one.stable,
        "rests": one.rests,
        "unknowns": one.unknowns,
        "multipliers": _pairs(one.multipliers),
        **_plain(one, ("residual", "least_speed", "least_clearance")),
    }


def _pairs(multipliers):
    return [[_finite(root.real), _finite(root.imag)] for root in multipliers]


def _branch(one):
    first, last = one.values[[0, -1]]
    return {
        "label": one.segments[0].label,
        "parameter": one.name,
        "from": float(first),
        "to": float(last),
        "range": [float(one.values.min()), float(one.values.max())],
        "closed": End.CLOSED in one.ends,
        "points": len(one),
        "reasons": list(one.reasons),
        "segments": [
            {"label": part.label, "itinerary": list(part.itinerary), "first": part.first, "last": part.last}
            for part in one.segments
        ],
        "special": [_point(each) for each in one.special],
    }


def _locus(one):
    return {
        "kind": one.kind,
        "label": one.label,
        "parameters": list(one.names),
        "points": len(one),
        "reasons": list(one.reasons),
        "special": [{"values": each.values, **_place(each)} for each in one.special],
    }


def _point(one):
    return {"value": one.value, **_place(one), "meets": labels_of(one)}


def _place(one):
    """What special points of branches and of loci have in common."""
    return {
        "kind": one.kind,
        "label": one.label,
        "itinerary": list(one.itinerary),
        "multipliers": _pairs(one.multipliers),
        "residual": _finite(one.residual),
        "place": int(one.place),
    }


def _near(one):
    return {
        "kind": one.kind,
        "distance": one.distance,
        "change": one.change,
        "status": one.status,
        "edge": one.edge,
        "at_bound": list(one.at_bound),
        "residual": _finite(one.residual),
    }


def _fitted(one):
    return {
        "status": one.status.name,
        "values": one.values,
        "sigma": {name: _finite(sigma) for name, sigma in one.sigma.items()},
        "chi2": _finite(one.chi2),
        "dof": one.dof,
        "not_in_the_record": [each.shares for each in one.unidentifiable],
        "missed": [list(each) for each in one.missed],
        "spurious": list(one.spurious),
    }


def _plain(one, numbers):
    """What attractors and orbits have in common, and some numbers of theirs."""
    return {
        "label": one.label,
        "periods": one.periods,
        "itinerary": list(one.itinerary),
        "state": {key: _finite(getattr(one.state, key)) for key in ("x", "v", "phase", "contact")},
        "mirror_of": one.mirror_of,
    } | {key: _finite(getattr(one, key)) for key in numbers}


def _finite(number):
    return float(number) if math.isfinite(number) else None
