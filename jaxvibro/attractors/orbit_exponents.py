"""The Lyapunov exponents of periodic orbits: ln abs(multiplier) / n, of many orbits at once.

The determinant of M is known without error from impacts and damping, ln det M = 2 sum ln R - 2 gamma n T (paper, (38)):
it gives the second multiplier, however much smaller than the first. Within a soft wall gamma2 takes the place of gamma.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from ..scene.codes import Contact, Status
from ..scene.scene import SIDES
from ..scene.state import State
from .tangent import begin, run

NEUTRAL = 1e-5  # growth a period that rounding may make of none
ROUNDS = 5  # of Newton's method on the strobe: the last two are rounding apart


class Rates(NamedTuple):
    """What is known of one motion, or of many, lanes first. exponent, error: (2,), a period, the larger first; impacts:
    a period, of all, left, right, (3,); within: the time within each wall, a period, left, right, (2,); periods: of the
    orbit, 0 for none; status: see `tangent.run`; count: periods averaged."""

    exponent: Float[np.ndarray, "*lanes 2"]
    error: Float[np.ndarray, "*lanes 2"]
    impacts: Float[np.ndarray, "*lanes 3"]
    within: Float[np.ndarray, "*lanes 2"]
    periods: Int[ArrayLike, " *lanes"]
    status: Int[ArrayLike, " *lanes"]
    count: Int[ArrayLike, " *lanes"]  # type: ignore[assignment]  # hides tuple's method

    @property
    def repels(self) -> Bool[ArrayLike, " *lanes"]:
        """Whether motions near it certainly leave it."""
        return self.exponent[..., 0] > NEUTRAL


def lost(status):
    """The `Rates` of a motion that has none."""
    none = np.full(2, np.nan)
    return Rates(none, none, np.full(3, np.nan), none, *np.array([0, status, 0]))


def areas(scene, laps):
    """What of ln abs det M `shrinkage` cannot know of each period of some laps: all of it, by the matrices themselves,
    under a force of the user's own; else what the damping of soft walls adds in the time within them."""
    if scene.force is None:
        found = np.zeros_like(laps.growth)
        for side in scene.soft_sides:
            more = np.asarray(scene.parameter(f"{side}.damping")) - np.asarray(scene.damping)
            found -= 2.0 * more * laps.within[..., SIDES.index(side)]
        return found
    a, b, c, d = np.moveaxis(laps.matrix, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(abs(a * d - b * c))


def shrinkage(scene, left, right, count, area):
    """ln abs det M of so many periods with these impacts on each wall: numbers that broadcast. area: the sum of
    `areas`."""
    if scene.force is not None:
        return area
    length = 2.0 * np.pi / np.asarray(scene.frequency)
    total = area - 2.0 * np.asarray(scene.damping) * length * count
    for side, hits in (("left", left), ("right", right)):
        if side in scene.walls and side not in scene.soft_sides:
            with np.errstate(divide="ignore", invalid="ignore"):
                total = total + np.where(hits > 0, 2.0 * hits * np.log(np.asarray(scene.bounce(side))), 0.0)
    return total


def of_orbits(scene, state, periods):
    """`Rates` of the periodic orbits that states are near to, (lanes,).

    scene: a single one or a lane of a batch each; state: leaves (lanes,); periods: of the orbits, (lanes,), at most
    LAPS. Newton's method on the strobe brings the states to rounding; the best of its steps gives the exponents, how
    far the second best is from that their errors.
    """
    seen = []
    for _ in range(ROUNDS):
        _, laps = run(scene, begin(state), int(periods.max()))
        off = laps.points[periods - 1, np.arange(len(periods))] - np.stack([state.x, state.v], -1)
        parts = laps.left, laps.right, laps.count, areas(scene, laps), *np.moveaxis(laps.within, -1, 0)
        left, right, hits, area, *within = (_until(part, periods) for part in parts)
        matrix, size = _product(laps.matrix, periods)
        logs = _multiplied(matrix, size, shrinkage(scene, left, right, periods, area))
        away = np.nan_to_num(abs(off).max(axis=1), nan=np.inf)
        seen.append((away, logs / periods[:, None], np.stack([hits, left, right, *within], -1), laps.status))
        state = _nearer(state, matrix, size, off)
    away, logs, hits, status = map(np.stack, zip(*seen, strict=True))
    best, second = np.argsort(away, axis=0, kind="stable")[:2]
    lane = np.arange(len(periods))
    return _told(logs[best, lane], logs[second, lane], hits[best, lane], status[best, lane], periods)


def _until(rows, periods):
    """The sum of the first so many rows of each lane."""
    return np.where(np.arange(len(rows))[:, None] < periods, rows, 0.0).sum(axis=0)


def _product(matrix, periods):
    """(M over so many periods over its largest entry, the logarithm of that), from M of each: (periods, lanes, 4)."""
    lanes = len(periods)
    total, size = np.tile(np.eye(2, dtype=matrix.dtype), (lanes, 1, 1)), np.zeros(lanes, matrix.dtype)
    for k in range(periods.max()):
        more = (k < periods)[:, None, None]
        total = np.where(more, matrix[k].reshape(lanes, 2, 2) @ total, total)
        largest = abs(total).max(axis=(1, 2))
        total = total / np.where(largest > 0, largest, 1.0)[:, None, None]
        with np.errstate(divide="ignore"):
            size = size + np.log(largest)
    return total, size


def _multiplied(matrix, size, both):
    """ln abs of the two multipliers, the larger first, (lanes, 2); both: ln abs det M."""
    trace = 0.5 * abs(matrix[:, 0, 0] + matrix[:, 1, 1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inner = trace * trace - np.exp(both - 2.0 * size)
        first = np.where(inner < 0, 0.5 * both, size + np.log(trace + np.sqrt(np.where(inner < 0, 0.0, inner))))
        second = np.where(np.isneginf(both), -np.inf, both - first)
    return np.where(np.isneginf(size)[:, None], -np.inf, np.stack([first, second], -1))


def _nearer(state, matrix, size, off):
    """The states of Newton's next step, as far as there is one: none from a mass that is on a wall.

    One that is within a soft wall may come out of it: where it then is, it is free.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        full = np.eye(2) - matrix * np.exp(size)[:, None, None]
        (a, b), (c, d) = np.moveaxis(full, 0, -1)
        step = np.stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]]) / (a * d - b * c)
    within = abs(state.contact) == Contact.WITHIN
    good = np.isfinite(step).all(axis=0) & np.isfinite(size) & (within | (state.contact == 0))
    x, v = np.where(good, step, 0.0).astype(off.dtype)
    return State(state.x + x, state.v + v, state.phase, np.where(good, 0.0, state.contact).astype(off.dtype))


def _told(rates, second, hits, status, periods):
    """`Rates` from the exponents of the best and of the second best step."""
    bad = (np.isnan(rates) | np.isposinf(rates)).any(axis=1) | (status >= Status.CAP)
    with np.errstate(invalid="ignore"):
        apart = abs(rates - second) + 4.0 * np.finfo(rates.dtype).eps * abs(rates)
    error = np.where(np.isneginf(rates), 0.0, np.where(np.isnan(apart), np.inf, apart))
    rates, error, hits = (np.where(bad[:, None], np.nan, each) for each in (rates, error, hits / periods[:, None]))
    periods, status = np.where(bad, 0, periods), np.where(bad & (status == 0), Status.NONFINITE, status)
    return Rates(rates, error, hits[:, :3], hits[:, 3:], periods, status, periods)
