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


def probes(scene, name, bounds, max_period, seed):
    """The `Probe`s that come back within so many periods, those of the shortest first."""
    low, high = np.clip(domain(scene, name), *bounds)
    rng = np.random.default_rng(seed)
    values = low + (high - low) * (np.arange(STARTS) + rng.random(STARTS)) / STARTS
    many = scene.replace(**{name: values})
    found = trail(many, random_starts(many, STARTS, (seed, 1)), SETTLE)
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
