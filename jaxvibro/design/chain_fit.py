"""Numbers of a scene from a chain of impacts: least squares under the flights' equations, by Gauss and Newton.

Unknown are all nodes of the chain and the free numbers together (multiple shooting; Bock 1981): the sum of squares of
residuals is least under c = 0, what the flights leave open. A step solves the Karush-Kuhn-Tucker system
((H, C^T), (C, 0)), H the squares' normal matrix, C the derivative of c. The part of its inverse that belongs to the
numbers is their covariance.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..scene.parameters import domain
from ..scene.scene import Scene
from .chain_equations import Nodes, left

ROUNDS = 60  # of Newton's steps
SHORT = 1e-6  # of the errors: a step as short is the last
CLOSED = 1e-9  # what a flight may leave open
NEARER = 0.25  # a flight's time, or the way to a bound, is at least as much of what it was before a step
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
    """The free numbers: their names, the drive's phase at time 0 last where it is free; scales; where they began; how
    much is known of them beforehand, a matrix in units of the scales."""

    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    begun: Float[np.ndarray, " free"]
    known: Float[np.ndarray, "free free"]


class Solved(NamedTuple):
    """nodes, numbers; residuals in errors; chi2: their squares' sum; moved: the same of what was known beforehand;
    covariance: of the numbers, in scales; strain: of each flight, how much chi2 would fall if it went from nowhere to
    nowhere; depth: `chain_equations.Left`'s; open: what is left of the equations at most; met: whether the last step
    was a short one."""

    nodes: Nodes
    numbers: Float[np.ndarray, " free"]
    residuals: Float[np.ndarray, " seen"]
    chi2: float
    moved: float
    covariance: Float[np.ndarray, "free free"]
    strain: Float[np.ndarray, " flights"]
    depth: Float[np.ndarray, " flights"]
    open: float
    met: bool


def solved(scene: Scene, phase: float, nodes: Nodes, seen: Seen, free: Free, numbers=None, rounds=ROUNDS) -> Solved:
    """The `Solved` least squares from nodes and numbers near it; phase: the drive's at time 0 where it is not free."""
    now = _point(scene, phase, nodes, seen, free, free.begun if numbers is None else numbers)
    price, met = 0.0, False
    for _ in range(rounds):
        step, multipliers = _step(now, seen, free)
        if step is None:
            break
        price = max(price, 1.5 * np.max(abs(multipliers), initial=0.0))
        now, met = _moved(scene, phase, now, seen, free, step, price)
        if met:
            break
    return _told(now, seen, free, met)


class _Point(NamedTuple):
    nodes: Nodes
    numbers: Float[np.ndarray, " free"]
    values: Float[np.ndarray, " equations"]
    by: Float[np.ndarray, "equations unknowns"]
    depth: Float[np.ndarray, " flights"]
    residuals: Float[np.ndarray, " seen"]
    bounds: Float[np.ndarray, "2 free"]


def _merit(now, free, price):
    away = (now.numbers - free.begun) / free.scales
    return 0.5 * (now.residuals @ now.residuals + away @ free.known @ away) + price * abs(now.values).sum()


def _point(scene, phase, nodes, seen, free, numbers):
    """The `_Point` with these unknowns, the derivative by numbers in their scales."""
    names, turned = (free.names[:-1], numbers[-1]) if free.names[-1:] == ("phase",) else (free.names, phase)
    found = left(scene, names, nodes, numbers[: len(names)], turned)
    flights, count = len(found.depth), len(nodes.sides)
    by = np.zeros((flights, 2, 2 * count + len(numbers)))
    for k in range(flights):
        by[k, :, 2 * k : 2 * k + 4] = found.by[k, :, :4]
    by[:, :, 2 * count :] = found.by[:, :, 4 : 4 + len(numbers)] * free.scales
    unknowns = np.stack([nodes.first, nodes.second], 1)
    residuals = (unknowns[seen.node, seen.slot] - seen.value) / seen.sigma
    bounds = [(-np.inf, np.inf) if name == "phase" else domain(scene, name) for name in free.names]
    bounds = np.array(bounds, float).reshape(-1, 2).T
    return _Point(nodes, numbers, found.values.ravel(), by.reshape(2 * flights, -1), found.depth, residuals, bounds)


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
    matrix, slope = _system(now, seen, free)
    size = len(slope)
    try:
        found = np.linalg.solve(matrix, -np.concatenate([slope, now.values]))
    except np.linalg.LinAlgError:
        return None, None
    return (found[:size], found[size:]) if np.isfinite(found).all() else (None, None)


def _moved(scene, phase, now, seen, free, step, price):
    """(the `_Point` after as much of a step as makes it better, whether the step was a short one)."""
    inner = len(step) - len(now.numbers)
    by_node, by_number = step[:inner].reshape(-1, 2), step[inner:]
    whole = _longest(now, by_node, by_number * free.scales, free.scales)
    short = _short(now, seen, by_node, by_number)
    share, before = whole, _merit(now, free, price)
    for _ in range(HALVINGS):
        nodes = now.nodes._replace(
            first=now.nodes.first + share * by_node[:, 0], second=now.nodes.second + share * by_node[:, 1]
        )
        new = _point(scene, phase, nodes, seen, free, now.numbers + share * by_number * free.scales)
        if short or _merit(new, free, price) <= before:
            break
        share *= 0.5
    return new, bool(short and abs(new.values).max(initial=0.0) <= CLOSED)


def _short(now, seen, by_node, by_number):
    moved = abs(by_node[seen.node, seen.slot]) / seen.sigma
    return bool(max(moved.max(initial=0.0), abs(by_number).max(initial=0.0)) <= SHORT)


def _longest(now, by_node, by_number, scales):
    """How much of a step leaves the nodes in order and the numbers within what they may be, and near."""
    hit = now.nodes.sides != 0
    spans, change = np.diff(now.nodes.times), np.diff(np.where(hit, by_node[:, 0], 0.0))
    spans = np.maximum(spans, 1e-12)
    limits = [1.0, *((1.0 - NEARER) * spans[change < 0] / -change[change < 0])]
    for value, move, low, high, scale in zip(now.numbers, by_number, *now.bounds, scales, strict=True):
        if move:
            limits.append(FAR * scale / abs(move))
            room = (high - value) if move > 0 else (value - low)
            limits.append((1.0 - NEARER) * room / abs(move) if np.isfinite(room) else 1.0)
    return max(min(limits), 1e-9)


def _told(now, seen, free, met):
    matrix, slope = _system(now, seen, free)
    size, count = len(slope), len(free.names)
    inverse = _inverse(matrix)
    multipliers = -inverse[size:, :size] @ slope - inverse[size:, size:] @ now.values
    pairs = multipliers.reshape(-1, 2)
    flights = np.arange(len(pairs))
    blocks = -np.nan_to_num(inverse)[size:, size:].reshape(len(pairs), 2, len(pairs), 2)[flights, :, flights, :]
    strain = np.einsum("fi,fi->f", pairs, (np.linalg.pinv(blocks) @ pairs[..., None])[..., 0])
    covariance = inverse[size - count : size, size - count : size]
    left_open = float(abs(now.values).max(initial=0.0))
    chi2 = float(now.residuals @ now.residuals)
    away = (now.numbers - free.begun) / free.scales
    moved = float(away @ free.known @ away)
    return Solved(now.nodes, now.numbers, now.residuals, chi2, moved, covariance, strain, now.depth, left_open, met)


def _inverse(matrix):
    """The inverse, of a singular matrix the nearest thing to it; nan where there is no number."""
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(matrix)
