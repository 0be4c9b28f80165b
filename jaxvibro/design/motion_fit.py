"""Numbers of a scene from samples of a motion: least squares of what is measured under shots that join.

A record is gone along from its beginning, as a frequency that is little off is much off in the phase of a late sample:
the motion found is flown on as far as its errors let it be known, and solved for anew. Where it leaves the record, and
at the beginning, many states and numbers that may be are tried, and those gone on with that go best along what follows.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import Scene, changed
from . import least_squares
from .first_return import course, wall_of
from .least_squares import Felt, Free, Problem, Solved, largest_chi2
from .records import SampleRecord
from .shots import Shots, clearances, flown, laid, passed

TRIED, ROUGH = 20, 1e-2  # of Newton's steps; of errors and scales: so short is the last while a record is gone along
GRID, LOOKED = 128, 6  # velocities that are tried; samples that choose among them
BEGUN, OPENINGS = 16, 4  # how many are begun with; how many are gone on with
DRAWN, PHASES = 256, 32  # numbers within their scales; phases
NEAR, SURE = 5.0, 10.0  # errors: so near a motion goes along a record; the record's: a state as sure is known
LARGER = 3.0  # than told: errors that a record may have, while it is gone along
LIKELY = 2.0  # standard deviations of a chi2: more than as much above its mean is looked at again
FASTEST = 2.0  # of what the motion measured, and the drive, would have as a harmonic one
NARROW = 0.1  # of the smallest error: as little may be left open
WIDE = 0.1  # of the range of x: as far from a sample is not near
NEARER = 0.25  # of a node's clearance is kept by a step
HALVINGS = 30


class Samples(NamedTuple):
    """What is fitted: the scene, the phase; the shots; what was measured, (record, 1) or (record, 2), the errors of
    both; what is free."""

    scene: Scene
    phase: float
    shots: Shots
    measured: Float[np.ndarray, "record channels"]
    sigma: Float[np.ndarray, " channels"]
    free: Free

    def at(self, numbers: Float[np.ndarray, " free"]) -> tuple[Scene, float]:
        """(the scene with free numbers, the phase)."""
        return self.free.at(self.scene, self.phase, numbers)


def samples_of(scene: Scene, data: SampleRecord, free: Free) -> Samples:
    """The `Samples` of a record."""
    (measured, sigma), phase = data.measured, data.phase or 0.0
    return Samples(scene, phase, laid(scene, phase, data.times, measured[:, 0]), measured, sigma, free)


def followed(samples: Samples) -> Solved | None:
    """The `Solved` of a whole record; None where no motion goes along it."""
    for state, numbers in _openings(samples):
        found = _grown(samples._replace(free=samples.free.from_phase(numbers)), state, numbers)
        if found is not None:
            return found
    return None


def _grown(samples, state, numbers):
    """The `Solved` of all shots, from the first one's state on: it is flown on from the last as far as it goes along
    the record, and then solved for anew. None where it breaks off."""
    found = _solved(samples, state[None], samples.free, numbers, TRIED, ROUGH)
    while _good(samples, found) and len(found.nodes) < len(samples.shots.node):
        onward = _onward(samples, found)
        now = _with(samples, found, onward)
        if not _good(samples, now) and len(onward) > 1:
            now = _with(samples, found, onward[:1])
        if not _good(samples, now) or _dear(found, now):
            others = _tried(samples, _drawn(samples.free, found), len(found.nodes))[:OPENINGS]
            others = [_with(samples, found._replace(numbers=numbers), one[None]) for one, numbers in others]
            now = min((now, *others), key=_badly)
        found = now
    return found if _good(samples, found) else None


def _good(samples, found):
    """Whether noise, of errors that may be larger than told, may have made the record of what was found; at a grazing,
    where steps need not become short, it is as good as the last one."""
    most = LARGER**2 * largest_chi2(len(found.residuals) - 2)
    closed = found.met or found.open <= NARROW * np.min(samples.sigma)
    return bool(closed and found.chi2 + found.moved <= most)


def _dear(found, now):
    """Whether what came to a record cost more than noise does in nearly all."""
    more = len(now.residuals) - len(found.residuals)
    return _badly(now) - _badly(found) > more + LIKELY * np.sqrt(2.0 * more)


def _drawn(free, found):
    """Numbers that may be, those found first."""
    room, away = free.room(found.numbers), np.random.default_rng(0).normal(size=(DRAWN, len(free.names)))
    scales, ways = np.linalg.eigh(np.nan_to_num(found.covariance))
    away = (away * np.sqrt(np.maximum(scales, 0.0))) @ ways.T
    return found.numbers + np.concatenate([0.0 * away[:1], np.clip(away, *room)]) * free.scales


def _badly(found):
    return found.chi2 + found.moved if np.isfinite(found.chi2) else np.inf


def _with(samples, found, more):
    """The `Solved` with nodes more."""
    states = np.concatenate([found.nodes, more])
    return _solved(samples, states, samples.free, found.numbers, TRIED, ROUGH)


def _onward(samples, found):
    """States of the next nodes, as the last one flies on to them, up to where it leaves the record."""
    count, channels, free = len(found.nodes), len(samples.sigma), len(found.numbers)
    names, phase = samples.free.apart(found.numbers, samples.phase)
    known, state, moves = found.spread([2 * count - 2, 2 * count - 1]), found.nodes[-1], np.eye(2, 2 + free)
    states = []
    for k in range(count - 1, min(len(samples.shots.node), 2 * count) - 1):
        one = samples.shots.at(k)
        flight = flown(samples.scene, names, one, state[None], found.numbers[: len(names)], phase)
        by = flight.by[0, ..., : 2 + free] * np.append([1.0, 1.0], samples.free.scales)
        by = by[..., :2] @ moves + np.concatenate([np.zeros((*by.shape[:2], 2)), by[..., 2:]], -1)
        if k >= count:
            errors = np.sqrt(np.maximum(np.einsum("tcu,uw,tcw->tc", by, known, by), 0.0))[:, :channels]
            away = abs(flight.values[0, :, :channels] - samples.measured[one.passed[0]])
            if not np.all((away <= NEAR * np.hypot(errors, samples.sigma)) & (errors <= SURE * samples.sigma)):
                return np.array(states[: max(1, len(states) - 1)])
        state, moves = flight.values[0, -1], by[-1]
        states.append(state)
    return np.array(states)


def solved(samples: Samples, found: Solved, free: Free) -> Solved:
    """The `Solved` least squares of the whole record, with other free numbers, from what was found of it."""
    return _solved(samples, found.nodes, free, found.numbers)


def _solved(samples, states, free, numbers, *ends):
    """The `Solved` least squares from the first nodes' states and numbers near it; ends: as of
    `least_squares.solved`."""
    shots = samples.shots.first(len(states))
    problem = Problem(partial(_felt, samples, shots), _moved, partial(_share, samples, shots))
    return least_squares.solved(problem, states, free, numbers, *ends)


def _felt(samples, shots, states, numbers):
    names, phase = samples.free.apart(numbers, samples.phase)
    found = flown(samples.scene, names, shots, states, numbers[: len(names)], phase)
    nodes, width, count, channels = len(states), found.values.shape[1], len(numbers), len(samples.sigma)
    by = found.by[..., : 2 + count] * np.append([1.0, 1.0], samples.free.scales)
    node, every = np.repeat(np.arange(nodes), 2 * width)[:, None], np.arange(2 + count)
    columns = np.where(every < 2, 2 * node + every, 2 * nodes - 2 + every)
    by = scipy.sparse.csr_array((by.ravel(), columns.ravel(), np.arange(0, by.size + 1, 2 + count)))
    own = scipy.sparse.eye_array(2 * nodes, 2 * nodes + count, format="csr")
    inner, ends = np.arange(nodes - 1), shots.length[:-1] - 1
    left, left_by = found.values[inner, ends] - states[1:], by[_pairs(inner * width + ends)] - own[2:]
    within = np.arange(width) < shots.length[:, None] - (np.arange(nodes) < nodes - 1)[:, None]
    places = np.concatenate([shots.node, shots.passed[within]])
    order = np.argsort(places)  # that of the record
    values = np.concatenate([states, found.values[within]])[order, :channels]
    rows = np.concatenate([np.arange(nodes), nodes + np.flatnonzero(within)])[order]
    values_by = scipy.sparse.vstack([own, by], format="csr")[_pairs(rows, channels)]
    residuals = (values - samples.measured[places[order]]) / samples.sigma
    errors = scipy.sparse.diags_array(np.tile(1.0 / samples.sigma, len(values)))
    return Felt(left.ravel(), left_by, residuals.ravel(), errors @ values_by)


def _pairs(places, channels=2):
    """Rows of the x and v of places, or of x alone."""
    return (2 * places[:, None] + np.arange(channels)).ravel()


def _moved(states, change):
    return states + change.reshape(-1, 2)


def _share(samples, shots, states, numbers, by_state, by_number):
    """How much of a step leaves all nodes between the walls."""
    times, share = shots.times[shots.node], 1.0
    before = clearances(*samples.at(numbers), times, states[:, 0])
    for _ in range(HALVINGS):
        there = samples.at(numbers + share * by_number)
        if np.all(clearances(*there, times, _moved(states, share * by_state)[:, 0]) >= NEARER * before):
            break
        share *= 0.5
    return share


def _openings(samples):
    """(first state, numbers), likely ones first: with the numbers as they are, then with others within their scales; at
    all phases where it is not known."""
    free, times = samples.free, samples.shots.times
    if free.names[-1] == "phase":
        angles = 2.0 * np.pi * np.arange(PHASES) / PHASES
        period = 2.0 * np.pi / float(samples.scene.frequency)
        some = np.searchsorted(times, times[0] + np.arange(1, LOOKED + 1) * period / LOOKED)
        after = np.maximum(np.minimum(some, len(times) - 1), np.arange(1, LOOKED + 1))
        yield from _tried(samples, np.stack([np.append(free.begun[:-1], one) for one in angles]), 0, after)
        return
    yield from _tried(samples, free.begun[None], 0)[:OPENINGS]
    away = np.clip(np.random.default_rng(0).normal(size=(DRAWN, len(free.names))), free.low, free.high)
    yield from _tried(samples, free.begun + away * free.scales, 0)


def _tried(samples, numbers, which, after=None):
    """[(state of a node, numbers)] that go along what follows it, likely ones first: the state as measured, or with
    each of many velocities; in each of some numbers, (several, free). after: places of samples that choose among them,
    by default the next ones."""
    node, times, measured = samples.shots.node[which], samples.shots.times, samples.measured
    scene, phase = samples.at(numbers[0])
    x = _between(scene, phase, times[node], measured[node, 0], samples.sigma[0])
    span = np.maximum(np.ptp(measured, axis=0), samples.sigma)
    forces = sum((abs(float(term.amplitude)) for term in scene.drive), abs(float(scene.amplitude)))
    reach = FASTEST * max(1.0, float(scene.frequency)) * (span[0] + forces)
    speeds = measured[node, 1:] if len(span) > 1 else reach * np.linspace(-1.0, 1.0, GRID)
    rows, tried = np.repeat(numbers, len(speeds), axis=0), np.tile(speeds, len(numbers))
    names, phases = samples.free.apart(rows.T, samples.phase)
    scenes = changed(scene, dict(zip(names, rows.T, strict=False)))
    after = np.minimum(node + np.arange(1, LOOKED + 1) if after is None else after, len(times) - 1)
    states, begin = np.stack([np.full(len(tried), x), tried], 1), np.full(len(tried), times[node])
    found = passed(scenes, phases, states, begin, np.tile(times[after], (len(tried), 1)))[..., : len(span)]
    away = np.nan_to_num((found - measured[after]) / (WIDE * span), nan=np.inf)
    cost = np.sum(np.minimum(away**2, 1.0), axis=(1, 2)).reshape(len(numbers), -1)
    beside = np.pad(cost, ((0, 0), (1, 1)), constant_values=np.inf)
    low = np.flatnonzero((cost <= beside[:, :-2]) & (cost < beside[:, 2:]))
    low = low[np.argsort(cost.ravel()[low], kind="stable")][:BEGUN]
    return [(states[k], rows[k]) for k in low]


def _between(scene, phase, times, x, sigma):
    """Positions; those that noise put beyond a rigid wall, or nearly, are an error before it."""
    for side, wall in scene.walls.items():
        if not wall.soft:
            one = wall_of(scene, side, phase)
            where = one.sign * course(one, times)[0] - sigma
            x = one.sign * np.minimum(one.sign * x, where)
    return x
