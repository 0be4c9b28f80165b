"""What was found, for reading and for machines."""

import math

import msgspec

from . import __version__
from .stretch import longest, stretches
from .study import KEEP, SETTLE


def table(found, name):
    """A text: the scene, the stretches of the sweep, the attractors."""
    scene = found.scene
    parts = [f"jaxvibro {__version__}, {name}\n", _columns([(key, float(scene.parameter(key))) for key in scene.names])]
    if found.swept is not None:
        parts += ["", *_sweep(found)]
    if found.attractors is not None:
        parts += ["", *_attractors(found)]
    return "\n".join(parts) + "\n"


def _sweep(found):
    asked = found.file.sweep
    if asked is None:
        yield from _rest(found.swept)
        return
    yield f"sweep of {asked.parameter}: {asked.count} values, {asked.settle} periods settled, {asked.keep} kept"
    yield f"periods: drive periods after which the state comes back, -: not within {longest(found.swept)}"
    rows = [("leg", "from", "to", "values", "periods")]
    rows += [(one.leg, one.first, one.last, one.count, _periods(one.periods)) for one in stretches(found.swept)]
    yield _columns(rows)


def _rest(swept):
    (one,), last = stretches(swept), swept.isel(step=0, leg=0, period=-1)
    yield f"from rest, after {SETTLE + KEEP} drive periods, at phase 0 of the drive"
    rows = [("x", f"{float(last['x']):.12f}"), ("v", f"{float(last['v']):.12f}"), ("periods", _periods(one.periods))]
    yield _columns(rows)
    yield f"periods: drive periods after which the state comes back, -: not within {longest(swept)}"


def _periods(number):
    return "bad status" if number is None else number or "-"


def _attractors(found):
    asked = found.file.attractors
    at = ", ".join(f"{key} = {value:g}" for key, value in asked.at.items()) or "the scene's own values"
    yield f"attractors at {at}, from {asked.starts} starts (seed {asked.seed}); x and v at phase 0"
    rows = [("", "label", "share", "periods", "x", "v", "impacts", "exponent", "mirror image")]
    for place, one in enumerate(found.attractors, 1):
        state = (f"{one.state.x:.12f}", f"{one.state.v:.12f}")
        words, twin = " ".join(word or "." for word in one.itinerary), _mirror(place, one.mirror_of)
        share, rate = f"{100 * one.share:.1f} %", f"{one.exponent:.4f}"
        rows.append((place, one.label, share, one.periods or "-", *state, words or "-", rate, twin))
    yield _columns(rows)
    yield "impacts: L left, R right, a word a period; exponent: the largest, per drive period"
    for place, one in enumerate(found.attractors, 1):
        yield f"{place}: {one.note}"


def _mirror(place, twin):
    if twin is None:
        return "-"
    return "itself" if twin + 1 == place else f"{twin + 1}"


def _columns(rows):
    """Rows of texts and numbers in columns."""
    texts = [[f"{entry:.6g}" if isinstance(entry, float) else str(entry) for entry in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in texts)


def summary(found, files):
    """The same as plain dicts, lists, texts and numbers; what is not finite is None."""
    told = {"version": __version__, "files": files, "job": msgspec.to_builtins(found.file)}
    if found.swept is not None:
        told["stretches"] = [msgspec.to_builtins(one) for one in stretches(found.swept)]
    if found.attractors is not None:
        told["attractors"] = [_plain(one) for one in found.attractors]
    return told


def _plain(attractor):
    numbers = ("share", "least_speed", "exponent")
    return {
        "label": attractor.label,
        "kind": attractor.kind,
        "periods": attractor.periods,
        "itinerary": list(attractor.itinerary),
        "state": {key: _finite(getattr(attractor.state, key)) for key in ("x", "v", "phase", "contact")},
        "points": attractor.points.tolist() if attractor.periods else [],
        "mirror_of": attractor.mirror_of,
        "note": attractor.note,
    } | {key: _finite(getattr(attractor, key)) for key in numbers}


def _finite(number):
    return float(number) if math.isfinite(number) else None
