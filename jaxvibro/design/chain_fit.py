"""Numbers of a scene from a chain of impacts: least squares under the flights' equations, by Gauss and Newton.

Unknown are all nodes of the chain and the free numbers together (multiple shooting; Bock 1981): the sum of squares of
residuals is least under c = 0, what the flights leave open. A step solves the Karush-Kuhn-Tucker system
((H, C^T), (C, 0)), H the squares' normal matrix, C the derivative of c. The part of its inverse that belongs to the
numbers is their covariance.
"""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import linalg

from ..scene.scene import Scene
from .chain_equations import Nodes, left

ROUNDS = 200  # of Newton's steps
SHORT = 1e-6  # of the errors: a step as short is the last
CLOSED = 1e-3  # of that: what a flight may leave open
NEARER = 0.25  # a flight's time is at least as much of what it was before a step
FAR = 4.0  # scales that a number may change by in a step
HALVINGS = 8
WEAKEST = 1e-12  # of H's first entries: what makes it regular in unknowns that nothing is known of


class Seen(NamedTuple):
    """What was measured of nodes: of which, what of it, 0 the first unknown, 1 the second, the values, their errors."""

    node: Int[np.ndarray, " seen"]
    slot: Int[np.ndarray, " seen"]
    value: Float[np.ndarray, " seen"]
    sigma: Float[np.ndarray, " seen"]


class Free(NamedTuple):
    """The free numbers: their names, the drive's phase at time 0 last where it is free; scales; where they began; in
    scales, how far from there they may go, and how much is known of them beforehand, a matrix."""

    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    begun: Float[np.ndarray, " free"]
    low: Float[np.ndarray, " free"]
    high: Float[np.ndarray, " free"]
    known: Float[np.ndarray, "free free"]

    def room(self, numbers: Float[np.ndarray, " free"]) -> Float[np.ndarray, "2 free"]:
        """(low, high) of the further change of numbers, in scales."""
        return np.array([self.low, self.high]) - (numbers - self.begun) / self.scales


class Solved(NamedTuple):
    """nodes, numbers; residuals in errors; chi2: their squares' sum; moved: the same of what was known beforehand;
    spread: the covariance of all unknowns, two of each node, then the numbers in scales; open: what is left of the
    equations at most; met: whether the last step was a short one."""

    nodes: Nodes
    numbers: Float[np.ndarray, " free"]
    residuals: Float[np.ndarray, " seen"]
    chi2: float
    moved: float
    spread: Float[np.ndarray, "unknowns unknowns"]
    open: float
    met: bool

    @property
    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Of the numbers, in scales."""
        count = len(self.spread) - len(self.numbers)
        return self.spread[count:, count:]


def solved(
    scene: Scene, phase: float, nodes: Nodes, seen: Seen, free: Free, numbers, rounds=ROUNDS, short=SHORT
) -> Solved:
    """The `Solved` least squares from nodes and numbers near it; phase: the drive's at time 0 where it is not free;
    short: of errors and scales, a step as short is the last."""
    now = _point(scene, phase, nodes, numbers, seen, free)
    price, met = 0.0, False
    for _ in range(rounds):
        way = _step(now, seen, free)
        if way is None:
            break
        step, multipliers, parts = way
        price = max(price, 1.5 * np.max(abs(multipliers), initial=0.0))
        last = _longest_move(now, seen, step) <= short
        now = _moved(scene, phase, now, seen, free, step, price, parts, last)
        met = bool(last and abs(now.values).max(initial=0.0) <= CLOSED * short)
        if met:
            break
    return _told(now, seen, free, met)


def told_apart(free, numbers, phase):
    """(the names of the scene's free numbers, the drive's phase at time 0, which may be one of the numbers)."""
    return (free.names[:-1], numbers[-1]) if free.names[-1:] == ("phase",) else (free.names, phase)


class _Point(NamedTuple):
    nodes: Nodes
    numbers: Float[np.ndarray, " free"]
    values: Float[np.ndarray, " equations"]
    by: Float[np.ndarray, "equations unknowns"]
    residuals: Float[np.ndarray, " seen"]


def _merit(now, free, price):
    away = (now.numbers - free.begun) / free.scales
    return 0.5 * (now.residuals @ now.residuals + away @ free.known @ away) + price * abs(now.values).sum()


def _point(scene, phase, nodes, numbers, seen, free):
    """The `_Point` with these unknowns, the derivative by numbers in their scales."""
    names, turned = told_apart(free, numbers, phase)
    found = left(scene, names, nodes, numbers[: len(names)], turned)
    flights, count = len(found.values), len(nodes.sides)
    by = np.zeros((flights, 2, 2 * count + len(numbers)))
    for k in range(flights):
        by[k, :, 2 * k : 2 * k + 4] = found.by[k, :, :4]
    by[:, :, 2 * count :] = found.by[:, :, 4 : 4 + len(numbers)] * free.scales
    unknowns = np.stack([nodes.first, nodes.second], 1)
    residuals = (unknowns[seen.node, seen.slot] - seen.value) / seen.sigma
    return _Point(nodes, numbers, found.values.ravel(), by.reshape(2 * flights, -1), residuals)


def _system(now, seen, free):
    """(the matrix of Karush, Kuhn and Tucker, the gradient)."""
    size, rows = now.by.shape[1], now.by.shape[0]
    inner = size - len(now.numbers)
    matrix, slope = np.zeros((size + rows, size + rows)), np.zeros(size)
    places = 2 * seen.node + seen.slot
    diagonal = np.zeros(inner)
    np.add.at(diagonal, places, seen.sigma**-2.0)
    np.add.at(slope, places, now.residuals / seen.sigma)
    diagonal += WEAKEST * np.max(diagonal, initial=1.0)
    matrix[np.arange(inner), np.arange(inner)] = diagonal
    matrix[inner:size, inner:size] = free.known
    slope[inner:] = free.known @ ((now.numbers - free.begun) / free.scales)
    matrix[size:, :size], matrix[:size, size:] = now.by, now.by.T
    return matrix, slope


def _step(now, seen, free):
    """(step, multipliers, the matrix's factors), None where there is none. A number that would pass the end of where it
    may be goes there."""
    matrix, slope = _system(now, seen, free)
    size, inner = len(slope), len(slope) - len(now.numbers)
    right = -np.concatenate([slope, now.values])
    low, high = free.room(now.numbers)
    held = np.zeros(len(low), bool)
    while np.isfinite(matrix).all() and np.isfinite(right).all():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", linalg.LinAlgWarning)  # a singular one: what it gives is not finite
            parts = linalg.lu_factor(matrix, check_finite=False)
        found = linalg.lu_solve(parts, right, check_finite=False)
        if not np.isfinite(found).all():
            break
        step = found[inner:size]
        past = ((step < low) | (step > high)) & ~held
        if not past.any():
            return found[:size], found[size:], parts
        for k in np.flatnonzero(past):
            matrix[inner + k] = np.arange(len(matrix)) == inner + k
            right[inner + k] = low[k] if step[k] < low[k] else high[k]
        held |= past
    return None


def _moved(scene, phase, now, seen, free, step, price, parts, last):
    """The `_Point` after as much of a step as makes it better, of the last step after all of it. Where the whole step
    does not, what the equations then leave open is taken away first (Maratos's effect)."""

    def after(change):
        return _point(scene, phase, *_changed(now, free, change), seen, free)

    whole = _longest(now, step)
    share, before = whole, _merit(now, free, price)
    for _ in range(HALVINGS):
        new = after(share * step)
        if last or _merit(new, free, price) <= before:
            break
        if share == whole == 1.0:
            closing = np.concatenate([0.0 * step, -new.values])
            further = step + linalg.lu_solve(parts, closing, check_finite=False)[: len(step)]
            new = after(_longest(now, further) * further)
            if _merit(new, free, price) <= before:
                break
        share *= 0.5
    return new


def _changed(now, free, step):
    """(nodes, numbers) after a step."""
    by_node, by_number = _parts(now, step)
    nodes = now.nodes
    moved = nodes._replace(first=nodes.first + by_node[:, 0], second=nodes.second + by_node[:, 1])
    return moved, now.numbers + by_number * free.scales


def _parts(now, step):
    """(of the nodes, of the numbers in scales)."""
    inner = len(step) - len(now.numbers)
    return step[:inner].reshape(-1, 2), step[inner:]


def _longest_move(now, seen, step):
    """The largest change of what was measured, in errors, and of the numbers, in scales."""
    by_node, by_number = _parts(now, step)
    moved = abs(by_node[seen.node, seen.slot]) / seen.sigma
    return max(moved.max(initial=0.0), abs(by_number).max(initial=0.0))


def _longest(now, step):
    """How much of a step leaves the nodes in order and the numbers near."""
    by_node, by_number = _parts(now, step)
    hit = now.nodes.sides != 0
    spans, change = np.diff(now.nodes.times), np.diff(np.where(hit, by_node[:, 0], 0.0))
    spans = np.maximum(spans, 1e-12)
    limits = [1.0, *((1.0 - NEARER) * spans[change < 0] / -change[change < 0])]
    limits.append(FAR / max(np.max(abs(by_number), initial=0.0), FAR))
    return max(min(limits), 1e-9)


def _told(now, seen, free, met):
    matrix, slope = _system(now, seen, free)
    size = len(slope)
    left_open = float(abs(now.values).max(initial=0.0))
    chi2 = float(now.residuals @ now.residuals)
    away = (now.numbers - free.begun) / free.scales
    moved = float(away @ free.known @ away)
    return Solved(now.nodes, now.numbers, now.residuals, chi2, moved, _inverse(matrix)[:size, :size], left_open, met)


def _inverse(matrix):
    """The inverse, of a singular matrix the nearest thing to it; nan where there is no number."""
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(matrix)
