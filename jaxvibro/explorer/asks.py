"""The lines of Python that a click, a slider or a choice from the menu means."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ..branches.branch import Branch, Special
from ..maps.initial_conditions import box
from ..orbits.orbit import Orbit
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies.schema import ViewTable
from .lines import SCENE, referred, resolved
from .messages import Ask
from .shown import Shown, slider

LONGEST = 64  # periods of a motion that is no orbit
FIRST = 16  # cells of a side of a grid that is drawn first
FARTHEST = 1e100  # bound of axes and parameters: squares and sums of such numbers are still finite
UNITS = 0.1  # of a number: the unit of a margin's distances
WORDS = {"find_orbit": "orbit", "special": "orbit", "switch": "branches", "explore": "diagram", "follow": "branch"}

Name = Callable[[str], str]


def stem(call: str) -> str:
    """What results of a call are called."""
    return WORDS.get(call, call)


def changes_of(now: Shown) -> dict[str, float]:
    """What of the scene is other than in the file."""
    return next((dict(line.arguments["changes"]) for line in now.lines if line.name == now.scene), {})


def changed(now: Shown, results: Mapping[str, Any], changes: Mapping[str, float], name: str) -> tuple[Scene, ViewTable]:
    """(the scene with other numbers, the line that makes it). Raises SceneError for numbers that cannot be."""
    known = results[SCENE]
    for each in changes:
        if each not in known.names:
            raise ArgumentError("name", "must be that of a parameter of the scene", each)
    merged = {**changes_of(now), **{each: float(value) for each, value in changes.items()}}
    return known.replace(**merged), ViewTable(name=name, call="replace", of=SCENE, arguments={"changes": merged})


def look(reference: str, place: int | None, value: Any, name: str) -> ViewTable:
    """The line of the orbit at a special point, or at a branch's point. Raises ArgumentError for other things."""
    if isinstance(value, Special):
        return ViewTable(name=name, call="special", of=reference)
    if isinstance(value, Branch):
        return ViewTable(name=name, call="orbit", of=reference, arguments={"place": int(place or 0)})
    raise ArgumentError("choose", "must be a special point, a branch or an orbit", reference)


def asked(message: Ask, now: Shown, results: Mapping[str, Any], name: Name) -> Iterator[list[ViewTable]]:
    """The lines that a choice from the menu means, in rounds: each replaces the one before, and is finer.

    Raises ArgumentError for a choice that what is chosen does not allow.
    """
    scene, (low, high) = results[now.scene], now.bounds
    along = {"parameter": now.parameter, "low": low, "high": high}

    def line(of, **arguments):
        return ViewTable(name=name(stem(message.call)), call=message.call, of=of, arguments=arguments)

    if message.call in ("switch", "locus"):
        chosen = resolved(now.chosen, results) if now.chosen else None
        if not isinstance(chosen, Special):
            raise ArgumentError(message.call, "must be asked of a special point: choose one first", now.chosen)
        yield [
            line(now.chosen) if message.call == "switch" else line(now.chosen, bounds=_holding(now.box, chosen.scene))
        ]
    elif message.call in ("follow", "margin"):
        one = results.get(now.current)
        if not isinstance(one, Orbit):
            raise ArgumentError(message.call, "must be asked of an orbit: this motion is none", now.current)
        if message.call == "follow":
            _refuse_known(now, results)
            low, high = _holding({now.parameter: now.bounds}, one.scene)[now.parameter]
            yield [line(now.current, **along | {"low": low, "high": high})]
        else:
            yield [line(now.current, free={each: _unit(one.scene, each) for each in (now.parameter, now.second)})]
    elif message.call == "explore":
        yield [line(now.scene, **along, max_period=message.max_period)]
    elif message.call == "sweep":
        start = {"x": 0.0, "v": 0.0}
        ways = ((high, low), (low, high))
        yield [line(now.scene, parameter=now.parameter, first=a, last=b, count=message.count, **start) for a, b in ways]
    elif message.call == "attractors":
        yield [line(now.scene)]
    else:
        yield from _grids(message, now, scene, line)


def _refuse_known(now, results):
    """Refuses to follow a point of a branch along the parameter that it is along already."""
    chosen = resolved(now.chosen, results) if now.chosen else None
    if isinstance(chosen, Branch) and chosen.name == now.parameter and chosen.bounds == now.bounds:
        raise ArgumentError("follow", "must be asked of an orbit that is on no branch yet", now.chosen)


def _grids(message, now, scene, line):
    """Rounds of a grid, each with twice as many cells a side."""
    count = min(FIRST, message.count)
    while True:
        if message.call == "map":
            pairs = {now.second: list(now.second_bounds), now.parameter: list(now.bounds)}
            yield [line(now.scene, bounds=pairs, count=count)]
        else:
            left, right, fast = (float(edge) for edge in box(scene))
            yield [line(now.scene, x=[left, right], v=[-fast, fast], count=count)]
        if count >= message.count:
            return
        count = min(2 * count, message.count)


def _holding(bounds, scene):
    """Bounds that hold a scene's numbers, a list each, as a scene file has them."""
    values = {name: float(scene.parameter(name)) for name in bounds}
    return {name: [min(low, values[name]), max(high, values[name])] for name, (low, high) in bounds.items()}


def _unit(scene, name):
    """A unit for distances along a parameter: a part of its number, or of its slider where that is 0."""
    low, high = slider(scene, name)
    return UNITS * (abs(float(scene.parameter(name))) or high - low)


def require_rising(key: str, pair: Sequence[float] | None) -> None:
    """Raises ArgumentError for bounds that do not go from a smaller number to a larger one, or are too far apart to be
    drawn; there may be none."""
    if pair is not None and not (np.isfinite(pair).all() and pair[0] < pair[1]):
        raise ArgumentError(key, "must go from a smaller number to a larger one", pair)
    if pair is not None and not max(map(abs, pair)) <= FARTHEST:
        raise ArgumentError(key, f"must lie within -{FARTHEST:g} and {FARTHEST:g}", pair)


def closure(line: ViewTable, lines: Mapping[str, ViewTable]) -> list[ViewTable]:
    """The lines that a line refers to, directly or not, in order."""
    found: list[ViewTable] = []
    before = referred(line)
    while before in lines:
        found.insert(0, lines[before])
        before = referred(lines[before])
    return found


def state_of(one: Orbit | xr.Dataset | None) -> State:
    """A state of what is shown, free of contact; rest before there is any."""
    if one is None:
        return State(0.0, 0.0)
    if isinstance(one, Orbit):
        return State(*(float(np.asarray(each)) for each in (one.state.x, one.state.v, one.state.phase)))
    return State(float(one["x"][-1]), float(one["v"][-1]), float(one["phase"][-1]) % (2.0 * np.pi))


def with_found(now: Shown, lines: Sequence[ViewTable], left: Sequence[ViewTable], then: Shown) -> Shown:
    """What there is now, with lines that were asked when there was something else; left: lines in whose place they
    are. What they refer to, and is no more there, is there again."""
    there, older = {line.name for line in now.lines}, {line.name: line for line in then.lines}
    needed = {each.name: each for line in lines for each in closure(line, older) if each.name not in there}
    stay = [line for line in now.lines if line not in left]
    return replace(now, lines=(*needed.values(), *stay, *lines))
