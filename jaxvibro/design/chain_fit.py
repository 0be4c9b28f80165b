"""Numbers of a scene from a chain of impacts: the least squares of their times under what flights leave open."""

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from ..scene.scene import Scene
from . import least_squares
from .chain_equations import Nodes, left
from .least_squares import ROUNDS, SHORT, Felt, Free, Problem, Solved

NEARER = 0.25  # a flight's time is at least as much of what it was before a step
SHORTEST = 1e-12  # of the times of flights
LEAST = 1e-9  # of a step


class Seen(NamedTuple):
    """What was measured of nodes: of which, what of it, 0 the first unknown, 1 the second, the values, their errors."""

    node: Int[np.ndarray, " seen"]
    slot: Int[np.ndarray, " seen"]
    value: Float[np.ndarray, " seen"]
    sigma: Float[np.ndarray, " seen"]


def solved(
    scene: Scene, phase: float, nodes: Nodes, seen: Seen, free: Free, numbers, rounds=ROUNDS, short=SHORT
) -> Solved:
    """The `Solved` least squares from nodes and numbers near it; phase: the drive's at time 0 where it is not free."""
    problem = Problem(partial(_felt, scene, phase, seen, free), _moved, _share)
    return least_squares.solved(problem, nodes, free, numbers, rounds, short)


def _felt(scene, phase, seen, free, nodes, numbers):
    names, turned = free.apart(numbers, phase)
    found = left(scene, names, nodes, numbers[: len(names)], turned)
    flights, count = len(found.values), len(nodes.sides)
    own = found.by[:, :, :4].reshape(2 * flights, 4)
    rows = np.repeat(np.arange(2 * flights), 4)
    columns = np.repeat(2 * np.arange(flights), 8) + np.tile(np.arange(4), 2 * flights)
    by_number = found.by[:, :, 4 : 4 + len(numbers)].reshape(2 * flights, -1) * free.scales
    by_node = scipy.sparse.csr_array((own.ravel(), (rows, columns)), (2 * flights, 2 * count))
    open_by = scipy.sparse.hstack([by_node, by_number], format="csr")
    unknowns, seen_count = np.stack([nodes.first, nodes.second], 1), len(seen.node)
    residuals = (unknowns[seen.node, seen.slot] - seen.value) / seen.sigma
    places = np.arange(seen_count), 2 * seen.node + seen.slot
    residuals_by = scipy.sparse.csr_array((1.0 / seen.sigma, places), (seen_count, open_by.shape[1]))
    return Felt(found.values.ravel(), open_by, residuals, residuals_by)


def _moved(nodes, change):
    first, second = change.reshape(-1, 2).T
    return nodes._replace(first=nodes.first + first, second=nodes.second + second)


def _share(nodes, numbers, by_node, by_number):
    """How much of a step leaves the nodes in order."""
    hit = nodes.sides != 0
    spans, change = np.diff(nodes.times), np.diff(np.where(hit, by_node.reshape(-1, 2)[:, 0], 0.0))
    spans = np.maximum(spans, SHORTEST)
    return max(min([1.0, *((1.0 - NEARER) * spans[change < 0] / -change[change < 0])]), LEAST)
