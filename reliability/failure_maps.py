"""Map failures over two parameters of a scene: the first of 100 periods with a wrong itinerary, by method.

Each cell starts at (0.9, -1.1), transient included. A cell is judged if it is not chaotic: the true itinerary of a
start at distance 1e-9 is the same and both end together (a wrong itinerary then is no shadow of a right one), and no
period has more than `periods.ROOM` impacts.
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
MAPS = {  # parameters and bounds; the others are those of figure 4, with an A at which the mass hits the walls
    ("amplitude", "omega"): ((0.2, 6.0), (0.6, 4.0)),
    ("restitution", "gamma"): ((0.3, 1.0), (0.0, 0.6)),
}
PLAIN = {"amplitude": 6.0, "omega": OMEGA, "gamma": GAMMA, "restitution": RESTITUTION}


NOTES = (
    f"Each cell represents {PERIODS} periods from (x, v) = (0.9, -1.1) between walls at -1 and 1. The parameters that "
    f"are not varied are A = 6, omega = {OMEGA}, gamma = {GAMMA} and R = {RESTITUTION}.",
    "The reference uses 80-bit floats and certifies each contact.",
    f"A cell is evaluated if a trajectory that starts {BESIDE:g} away has the same itinerary and ends within "
    f"{TOGETHER:g} of the reference. A wrong itinerary is therefore not that of a neighbouring trajectory.",
)


class FailureMap(NamedTuple):
    """Failures over two parameters, `names`, at their `values`.

    `judged` (cells, cells) has the first name along the last axis; `crowded`: a period has too many impacts to be
    judged; `first`: {method: first wrong period, from 0, PERIODS if there is none}.
    """

    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    judged: np.ndarray
    crowded: np.ndarray
    first: dict[str, np.ndarray]


def scenes_of(names, bounds, cells):
    """Return the values of two parameters, and the `Scenes` of their grid."""
    values = tuple(np.linspace(*each, cells) for each in bounds)
    grid = dict(zip(names, (part.ravel() for part in np.meshgrid(*values)), strict=True))
    numbers = {name: grid.get(name, np.full(cells * cells, value)) for name, value in PLAIN.items()}
    ones = np.ones(cells * cells)
    return values, Scenes(**numbers, low=-ones, high=ones, x=0.9 * ones, v=-1.1 * ones)


def ours_of(scenes):
    """Return the scene of this package."""
    numbers = scenes.amplitude, scenes.omega, scenes.gamma, scenes.restitution
    return jv.make_scene(*numbers, (scenes.low, scenes.high))


def by_ours(scenes):
    """Map a `Period` with this package."""
    end, impacts = jv.strobe(ours_of(scenes), jv.State(scenes.x, scenes.v), slots=periods.ROOM)
    return periods.Period(np.asarray(end.x), np.asarray(end.v), np.asarray(impacts.side))


def itineraries(period, scenes, count):
    """Return the sides, (count, scenes, ROOM), and the final states."""
    sides = []
    for _ in range(count):
        found = period(scenes)
        sides.append(found.sides)
        scenes = scenes._replace(x=found.x, v=found.v)
    return np.array(sides), scenes


def whole_methods(room=periods.ROOM):
    """Return {name: function of Scenes that returns a `Period`}, this package first; others stop at `room` impacts."""
    found = {methods.OURS: by_ours}
    for rival in methods.RIVALS:
        if rival.met.func is methods.by_heyoka:
            found[rival.name] = functools.partial(periods.by_heyoka, **rival.met.keywords, room=room)
        else:
            found[rival.name] = functools.partial(periods.by_flights, rival.met, room=room)
    return found


def measure(names, bounds, size):
    """Return the `FailureMap` of a grid."""
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
