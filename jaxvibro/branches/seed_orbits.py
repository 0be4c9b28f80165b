"""Probes: what random starts at values all over a parameter's range settle on."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors.recurrence import returns
from ..maps.initial_conditions import random_starts
from ..maps.iterate import iterate
from ..orbits.free_response import free_orbit
from ..problem.orbit_on_branch import OrbitPoint
from ..scene.codes import Contact, Status
from ..scene.parameters import domain

STARTS = 256  # at as many values
FREE = 15  # values at which the motion that meets no wall is looked for
SETTLE = 600  # drive periods
SETTLED = 1e-7  # of the largest x and v: a return as near as this


class Probe(NamedTuple):
    """What a start settled on. spot: the orbit, about; points: x and v at the end of each period, (periods, 2);
    endless: whether it rests, or hops too often to be recorded: its spot has no impacts."""

    spot: OrbitPoint
    points: Float[np.ndarray, "periods 2"]
    endless: bool = False


def probes(scenes, name, bounds, max_period, seed):
    """For each of some scenes the `Probe`s that come back within so many periods, those of the shortest first.

    scenes: alike but for their numbers, a list; the starts of all are settled together.
    """
    starts = [_starts(scene, name, bounds, seed) for scene in scenes]
    values, state = jax.tree.map(lambda *each: np.concatenate(each), *starts)
    found = iterate(_lanes(scenes).replace(**{name: values}), state, SETTLE)
    rows = [slice(first, first + STARTS) for first in range(0, len(values), STARTS)]
    return [
        _listed(scene, name, values[some], found.lanes(some), max_period)
        for scene, some in zip(scenes, rows, strict=True)
    ]


def free_probes(scene, name, bounds):
    """Yields the `Probe` of the motion that meets no wall at those of some values of a parameter where there is one:
    around a resonance it is there on both sides."""
    low, high = np.clip(domain(scene, name), *bounds)
    for value in np.linspace(low, high, FREE + 2)[1:-1].tolist():
        orbit = free_orbit(scene.replace(**{name: value}))
        if orbit is not None:
            points = np.array([[orbit.state.x, orbit.state.v]])
            yield Probe(OrbitPoint(value, *[np.zeros(0)] * 3, 1, *points[0].tolist(), 0.0), points)


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
    length = 2.0 * np.pi / np.broadcast_to(scene.replace(**{name: values}).frequency, len(values))
    listed = []
    for lane, periods, impacts in settled_orbits(found, length, max_period, True):
        points = found.points[-periods:, lane]
        spot = OrbitPoint(float(values[lane]), *(impacts or [np.zeros(0)] * 3), periods, *points[-1].tolist(), 0.0)
        listed.append(Probe(spot, points, impacts is None))
    return sorted(listed, key=lambda one: (one.spot.periods, one.spot.value))


def settled_orbits(found, length, max_period, endless=False):
    """(lane, periods, (times, speeds, sides) of the impacts) of each lane of a `Trail` that comes back within so many
    periods. length: of a period of each lane; endless: None in place of the impacts of those that rest, or hop too
    often to be recorded, which else are left out."""
    points = found.points
    apart, size = returns(points)[:max_period], SETTLED * abs(points).max(axis=(0, 2))
    for lane in np.flatnonzero((apart < size).any(axis=0) & (found.status < Status.CAP)):
        periods = int(np.argmax(apart[:, lane] < size[lane])) + 1
        if found.status[lane] == Status.FULL or (abs(found.contact[-periods:, lane]) == Contact.STUCK).any():
            if endless:
                yield int(lane), periods, None
            continue
        hit = found.side[-periods:, lane] != 0
        late = found.time[-periods:, lane] + length[lane] * np.arange(periods)[:, None]
        sides = found.side[-periods:, lane].astype(float)
        yield int(lane), periods, tuple(part[hit] for part in (late, found.speed[-periods:, lane], sides))
