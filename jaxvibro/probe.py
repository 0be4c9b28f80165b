"""Probes: what random starts at values all over a parameter's range settle on."""

from typing import NamedTuple

import jax
import numpy as np

from .domain import domain
from .recurrence import returns
from .starts import random_starts
from .state import State
from .trail import trail

STARTS = 256  # at as many values
SETTLE = 600  # drive periods
SETTLED = 1e-7  # of the largest x and v: a return as near as this


class Probe(NamedTuple):
    """What a start settled on. value: of the parameter; state: at phase 0; periods after which it comes back; points: x
    and v at the end of each, (periods, 2); speeds, sides: of the impacts in them."""

    value: float
    state: State
    periods: int
    points: np.ndarray
    speeds: np.ndarray
    sides: np.ndarray


def probes(scenes, name, bounds, max_period, seed):
    """For each of some scenes the `Probe`s that come back within so many periods, those of the shortest first.

    scenes: alike but for their numbers, a list; the starts of all are settled together.
    """
    starts = [_starts(scene, name, bounds, seed) for scene in scenes]
    values, state = jax.tree.map(lambda *each: np.concatenate(each), *starts)
    found = trail(_lanes(scenes).replace(**{name: values}), state, SETTLE)
    rows = [slice(first, first + STARTS) for first in range(0, len(values), STARTS)]
    return [
        _listed(scene, name, values[some], found.lanes(some), max_period)
        for scene, some in zip(scenes, rows, strict=True)
    ]


def _starts(scene, name, bounds, seed):
    """(values of the parameter, the `State` of a random start at each)."""
    low, high = np.clip(domain(scene, name), *bounds)
    rng = np.random.default_rng(seed)
    values = low + (high - low) * (np.arange(STARTS) + rng.random(STARTS)) / STARTS
    return values, random_starts(scene.replace(**{name: values}), STARTS, (seed, 1))


def _lanes(scenes):
    """One scene for the starts of all: what differs has a number a start."""

    def leaf(*each):
        numbers = np.stack(each)
        return each[0] if (numbers == numbers[0]).all() else np.repeat(numbers, STARTS)

    return jax.tree.map(leaf, *scenes)


def _listed(scene, name, values, found, max_period):
    points = found.points
    apart, size = returns(points)[:max_period], SETTLED * abs(points).max(axis=(0, 2))
    listed = []
    for lane in np.flatnonzero((apart < size).any(axis=0) & (found.status == 0)):
        periods = int(np.argmax(apart[:, lane] < size[lane])) + 1
        hit = found.side[-periods:, lane] != 0
        impacts = (part[-periods:, lane][hit] for part in (found.speed, found.side))
        state = State(*(float(leaf[lane]) for leaf in jax.tree.leaves(found.state)))
        listed.append(Probe(float(values[lane]), state, periods, points[-periods:, lane], *impacts))
    return sorted(listed, key=lambda one: (one.periods, one.value))
