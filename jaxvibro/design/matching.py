"""Chains of impacts: which of a record's impacts are of the motion, and which of the motion are missing from it.

How a chain is fitted, made longer, given an impact that the record lacks, or relieved of one. What is tried, and in
which order, is in `growth`.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..scene.scene import SIDES, Scene
from ..scene.soft_walls import effective_restitution
from . import chain_fit
from .chain_equations import Nodes, aimed, left
from .chain_fit import Seen
from .first_return import Motion
from .least_squares import Free, Solved, largest_chi2

MISSED, SPURIOUS, WRONG = 6.0, 14.0, 1e6  # what is added to chi2 for each of them, for a chain that cannot be
GRID = 24  # times of an impact that is put in
LOW = 2  # places on a grid that are tried
TRIED, ROUGH = 25, 1e-2  # of Newton's steps; of errors and scales: so short is the last while chains are looked for
WEAK = 0.05  # restitution below which a speed before an impact is not told from that after it
DEEP = 4.0  # errors of a flight's depth in a wall: deeper it passes through


class Chain(NamedTuple):
    """seen: of each node the record's impact, -1 where it was missed; left_out: the record's impacts of no node;
    solved: the `Solved`; cost: chi2 and what is added."""

    seen: Int[np.ndarray, " nodes"]
    left_out: tuple[int, ...]
    solved: Solved
    cost: float


class Record(NamedTuple):
    """What the chains are of: the scene, the phase, times, sides and their errors, what is free."""

    scene: Scene
    phase: float
    times: Float[np.ndarray, " record"]
    sides: Float[np.ndarray, " record"]
    sigma: Float[np.ndarray, " record"]
    free: Free


class Base(NamedTuple):
    """A chain that is not fitted yet; a speed that is not known is nan."""

    seen: Int[np.ndarray, " nodes"]
    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]
    left_out: tuple[int, ...]
    numbers: Float[np.ndarray, " free"]


def fitted(record: Record, base: Base) -> Chain:
    """The `Chain` of a `Base`; speeds that are not known are those with which flights come."""
    scene, phase = at(record, base.numbers)
    times, zero = _apart(base.times, record.sigma[0]), np.zeros(len(base.seen))
    after, before = aimed(scene, Nodes(base.sides, zero, times, zero), phase)
    come = np.concatenate([[after[0] / max(bounces(scene, base.sides[:1])[0], WEAK)], before])
    nodes = Nodes(base.sides, zero, times, np.where(np.isnan(base.speeds), come, base.speeds))
    given = seen(record, base)
    found = chain_fit.solved(record.scene, record.phase, nodes, given, record.free, base.numbers, TRIED, ROUGH)
    cost = found.chi2 + found.moved + MISSED * np.sum(base.seen < 0) + SPURIOUS * len(base.left_out)
    return Chain(base.seen, base.left_out, found, float(cost if possible(record, found) else WRONG + cost))


def seen(record, chain):
    """What was measured of a chain's nodes."""
    hit = np.flatnonzero(chain.seen >= 0)
    return Seen(hit, np.zeros(len(hit), int), record.times[chain.seen[hit]], record.sigma[chain.seen[hit]])


def possible(record, found):
    """Whether a chain is a motion: solved, each impact into its wall, and no flight through one, but for errors."""
    if not found.met or np.any(found.nodes.second <= 0):
        return False
    scene, phase = at(record, found.numbers)
    least, walls, when = Motion(scene, phase).least(found.nodes)
    return all(_grazes(record, found, k, walls[k], when[k], -least[k]) for k in np.flatnonzero(least < 0))


def _grazes(record, found, flight, side, when, deep):
    """Whether a flight is as deep in a wall at a time as errors may take it, and no deeper."""
    nodes, count = found.nodes, len(found.numbers)
    pair = Nodes(
        np.array([nodes.sides[flight], side]),
        np.zeros(2),
        np.array([nodes.first[flight], when]),
        np.array([nodes.second[flight], 0.0]),
    )
    by = slopes(record, pair, found.numbers)[0, 0]
    by = by[[0, 1, *range(4, 4 + count)]]
    known = found.spread([2 * flight, 2 * flight + 1])
    return bool(deep <= DEEP * np.sqrt(max(by @ known @ by, 0.0)))


def slopes(record, nodes, numbers):
    """How what flights leave open changes with their nodes' unknowns and the free numbers, in their scales,
    (flights, 2, 4 + free)."""
    names, phase = record.free.apart(numbers, record.phase)
    by = left(record.scene, names, nodes, numbers[: len(names)], phase).by[:, :, : 4 + len(numbers)]
    return by * np.concatenate([np.ones(4), record.free.scales])


def good(record: Record, chain: Chain) -> bool:
    """Whether a chain is a motion that noise may have made the record of."""
    found = chain.solved
    return bool(chain.cost < WRONG and found.chi2 + found.moved <= largest_chi2(len(found.residuals) - 2))


def _apart(times, sigma):
    """Times in order, none as near to the next as their error."""
    times = np.array(times)
    for k in range(1, len(times)):
        times[k] = max(times[k], times[k - 1] + 0.5 * sigma)
    return times


def at(record, numbers):
    """(the scene with free numbers, the phase)."""
    return record.free.at(record.scene, record.phase, numbers)


def bounces(scene, sides):
    """R of the walls on sides, of soft ones the effective one."""
    own = {side: _bounce(scene, SIDES[int(side > 0)]) for side in set(sides)}
    return np.array([own[side] for side in sides])


def _bounce(scene, side):
    wall = scene.walls[side]
    if not wall.soft:
        return float(scene.bounce(side))
    return float(effective_restitution(wall.stiffness, scene.parameter(f"{side}.damping")))


def wall_sides(scene):
    """-1, 1 of the walls that a scene has."""
    return tuple(-1.0 if side == "left" else 1.0 for side in scene.walls)


def plain(record: Record, numbers, places) -> Base:
    """The chain of some impacts of the record, as they are."""
    places = np.asarray(places, int)
    return Base(places, record.sides[places], record.times[places], np.full(len(places), np.nan), (), numbers)


def spread(chain: Chain) -> Base:
    """A chain as it was found."""
    nodes, solved = chain.solved.nodes, chain.solved
    return Base(chain.seen, nodes.sides, nodes.first, nodes.second, chain.left_out, solved.numbers)


def joined(base: Base, more: Base, way: int) -> Base:
    """A chain with more after it, or before it where way is -1; left out is what either leaves out."""
    parts = (base, more) if way > 0 else (more, base)
    rows = [np.concatenate(pair) for pair in zip(parts[0][:4], parts[1][:4], strict=True)]
    return base._replace(seen=rows[0], sides=rows[1], times=rows[2], speeds=rows[3])


def puts(record: Record, base: Base, flight: int, sides) -> list[Base]:
    """The chains with impacts on sides put in after a node, at times that suit, the best first."""
    place, count = flight + 1, len(sides)
    speeds = np.insert(base.speeds, place, np.full(count, np.nan))
    speeds[place + count] = np.nan
    new = base._replace(
        seen=np.insert(base.seen, place, np.full(count, -1)),
        sides=np.insert(base.sides, place, sides),
        speeds=speeds,
    )
    suiting = suits(record, base, flight, sides)[1]
    return [new._replace(times=np.insert(base.times, place, times)) for times in suiting]


def less(base: Base, node: int) -> Base:
    """The chain without a node; of a measured one the record's impact is left out."""
    rows = [np.delete(one, node) for one in base[:4]]
    if node < len(rows[3]):
        rows[3][node] = np.nan
    left_out = base.left_out if base.seen[node] < 0 else (*base.left_out, int(base.seen[node]))
    return base._replace(seen=rows[0], sides=rows[1], times=rows[2], speeds=rows[3], left_out=left_out)


def clashes(record: Record, base: Base) -> Float[np.ndarray, " inner"]:
    """How badly the speeds with which flights come suit those with which the next ones go, at each inner node."""
    scene, phase = at(record, base.numbers)
    zero = np.zeros(len(base.seen))
    after, before = aimed(scene, Nodes(base.sides, zero, _apart(base.times, record.sigma[0]), zero), phase)
    lacks = after[1:] - bounces(scene, base.sides[1:-1]) * before[:-1]
    return lacks**2 + 10.0 * (np.minimum(after[1:], 0.0) ** 2 + np.minimum(before[:-1], 0.0) ** 2)


def suits(record, base, flight, sides):
    """(how badly, times) of impacts put in after a node, on a grid, at its lowest places: where speeds before and after
    suit each other."""
    scene, phase = at(record, base.numbers)
    begin, end = base.times[flight], base.times[flight + 1]
    shares = (np.arange(GRID) + 0.5) / GRID
    shares = np.array([some for some in product(shares, repeat=len(sides)) if list(some) == sorted(set(some))])
    times = begin + (end - begin) * shares
    walls = np.array([base.sides[flight], *sides, base.sides[flight + 1]])
    rows = np.column_stack([np.full(len(times), begin), times, np.full(len(times), end)])
    size = rows.shape[1]
    zero = np.zeros(rows.size)
    after, before = aimed(scene, Nodes(np.tile(walls, len(rows)), zero, rows.ravel(), zero), phase)
    after, before = (np.append(one, 0.0).reshape(len(rows), size)[:, :-1] for one in (after, before))
    known = base.speeds[flight]
    known = after[:, 0] / bounces(scene, walls[:1])[0] if np.isnan(known) else np.full(len(rows), known)
    come = np.column_stack([known, before[:, :-1]])
    lacks = after - bounces(scene, walls[:-1]) * come
    wrong = np.sum(np.minimum(after, 0.0) ** 2, 1) + np.sum(np.minimum(before, 0.0) ** 2, 1)
    badly = np.sum(lacks**2, 1) + 10.0 * wrong
    badly = np.where(np.isfinite(badly), badly, np.inf)
    best = [int(np.argmin(badly))]
    if len(sides) == 1:
        low = (badly < np.append(np.inf, badly[:-1])) & (badly < np.append(badly[1:], np.inf))
        best = sorted(np.flatnonzero(low), key=lambda k: badly[k])[:LOW] or best
    return float(badly[best[0]]), times[best]
