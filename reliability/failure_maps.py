"""Maps of failure: over two numbers of a scene, the first of 100 periods in which a method's itinerary is wrong.

Each cell begins at (0.9, -1.1), so that it has its transient to go through. It is judged where that is not chaotic:
where the true itinerary of a start 1e-9 beside it is the same and both end together (so a wrong itinerary is no shadow
of a right one), and where no period has more impacts than `periods.ROOM`.
"""

import functools
from typing import NamedTuple

import numpy as np

import jaxvibro as jv
from benchmarks.work import GAMMA, OMEGA, RESTITUTION

from . import methods, periods
from .periods import Scenes

PERIODS, CELLS = 100, 16
BESIDE, TOGETHER = 1e-9, 1e-6
MAPS = {  # what varies, by name and bounds; the rest is figure 4's, with an A at which it hits the walls
    ("amplitude", "omega"): ((0.2, 6.0), (0.6, 4.0)),
    ("restitution", "gamma"): ((0.3, 1.0), (0.0, 0.6)),
}
PLAIN = {"amplitude": 6.0, "omega": OMEGA, "gamma": GAMMA, "restitution": RESTITUTION}


NOTES = (
    f"{PERIODS} periods from (0.9, -1.1), a cell each; A 6, omega {OMEGA}, gamma {GAMMA}, R {RESTITUTION} but for what "
    "varies; walls at -1 and 1. The truth flies in 80-bit floats, each contact certified.",
    f"Judged where a start {BESIDE:g} beside has the same itinerary and ends within {TOGETHER:g}: so no wrong "
    "itinerary is the shadow of a right one.",
)


class FailureMap(NamedTuple):
    """names, and values of both; judged: (cells, cells), the first name along the last axis; crowded: a period has
    too many impacts to be judged; first: {method: the first period that is wrong, from 0 on, PERIODS where none is}."""

    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    judged: np.ndarray
    crowded: np.ndarray
    first: dict[str, np.ndarray]


def scenes_of(names, bounds, cells):
    """The values of two numbers, and the `Scenes` of their grid."""
    values = tuple(np.linspace(*each, cells) for each in bounds)
    grid = dict(zip(names, (part.ravel() for part in np.meshgrid(*values)), strict=True))
    numbers = {name: grid.get(name, np.full(cells * cells, value)) for name, value in PLAIN.items()}
    ones = np.ones(cells * cells)
    return values, Scenes(**numbers, low=-ones, high=ones, x=0.9 * ones, v=-1.1 * ones)


def ours_of(scenes):
    """Our scene of them."""
    numbers = scenes.amplitude, scenes.omega, scenes.gamma, scenes.restitution
    return jv.make_scene(*numbers, (scenes.low, scenes.high))


def by_ours(scenes):
    """A `Period` by our strobe."""
    end, impacts = jv.strobe(ours_of(scenes), jv.State(scenes.x, scenes.v), slots=periods.ROOM)
    return periods.Period(np.asarray(end.x), np.asarray(end.v), np.asarray(impacts.side))


def itineraries(period, scenes, count):
    """Sides, (count, scenes, ROOM), and where the scenes end."""
    sides = []
    for _ in range(count):
        found = period(scenes)
        sides.append(found.sides)
        scenes = scenes._replace(x=found.x, v=found.v)
    return np.array(sides), scenes


def whole_methods(room=periods.ROOM):
    """{name: a function of Scenes that gives a `Period`}, ours first; room: impacts at which another gives up."""
    found = {methods.OURS: by_ours}
    for rival in methods.RIVALS:
        if rival.met.func is methods.by_heyoka:
            found[rival.name] = functools.partial(periods.by_heyoka, **rival.met.keywords, room=room)
        else:
            found[rival.name] = functools.partial(periods.by_flights, rival.met, room=room)
    return found


def measure(names, bounds, size):
    """The `FailureMap` of a grid."""
    cells, count = (4, 10) if size.quick else (CELLS, PERIODS)
    values, scenes = scenes_of(names, bounds, cells)
    true, end = itineraries(periods.true, scenes, count)
    other, beside = itineraries(periods.true, scenes._replace(x=scenes.x * (1.0 - BESIDE)), count)
    crowded = np.isnan(end.x.astype(float)) | np.isnan(beside.x.astype(float))
    judged = ~crowded & (true == other).all((0, 2))
    judged &= abs(end.x - beside.x) + abs(end.v - beside.v) < TOGETHER
    first = {}
    few = np.flatnonzero(judged)
    some = Scenes(*(each[few] for each in scenes))
    for name, period in whole_methods().items():
        sides, _ = itineraries(period, some, count)
        wrong = (sides != true[:, few]).any(2)
        found = np.full(cells * cells, count)
        found[few] = np.where(wrong.any(0), wrong.argmax(0), count)
        first[name] = found.reshape(cells, cells)
    return FailureMap(names, values, judged.reshape(cells, cells), crowded.reshape(cells, cells), first)
