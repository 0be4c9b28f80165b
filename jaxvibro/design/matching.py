"""Which impacts of a record are of the motion, and which of the motion are missing from it.

The chain grows along the record, a few impacts at a time: what is short is fitted from far away, and each longer one
begins where it is already right. Where one impact more does not fit, impacts are put in before it, or where the chain
is under strain, or it is left out; the cheapest way is taken.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import special

from ..scene.scene import SIDES, Scene, changed
from . import chain_fit
from .chain_equations import Nodes, aimed
from .chain_fit import Free, Seen, Solved

FIRST, FASTER = 6, 1.4  # impacts of the first chain; how much longer the next one is
RARE = 1e-5  # a chi2 that noise makes larger so seldom is too large
MISSED, SPURIOUS, WRONG = 6.0, 14.0, 1e6  # what is added to chi2 for each of them, for a chain that cannot be
OPENINGS, BEGUN = 10, 4  # ways to begin that are fitted; of them how many are gone on with
MOST_SPURIOUS = 0.1  # of a record's impacts
ASIDE = 1.5  # scales of the frequency, where a chain as it is given does not begin
STRAINED = 3  # flights at which an impact is put in
GRID = 24  # times of an impact that is put in
LIKELY = 4  # ways of putting in before a new impact, those that suit its speeds best
LOW = 2  # places on a grid that are tried
TRIED = 25  # of Newton's steps
WEAK = 0.05  # restitution below which a speed before an impact is not told from that after it


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


def matched(record: Record, flawed: bool) -> Chain | None:
    """The `Chain` of a whole record; its cost is `WRONG` at least where there is none. flawed: whether the record may
    lack impacts or have others."""
    found = None
    for numbers in _starts(record.free):
        for first in _first(record, flawed, numbers):
            whole = _grown(record, flawed, first)
            if _good(record, whole):
                return whole
            found = whole if found is None else found
    return found


def _starts(free):
    """Numbers to begin with: as given, and with other frequencies, which a short chain feels most."""
    ways = ASIDE * free.scales * np.array([name == "frequency" for name in free.names])
    return [free.begun] if not ways.any() else [free.begun, free.begun - ways, free.begun + ways]


def _first(record, flawed, numbers):
    """Chains of the first few impacts, the cheapest first: as they are, with one or two put in, or one left out."""
    base = _base(record, _NONE._replace(numbers=numbers), 0, min(FIRST, len(record.times)))
    plain = _fitted(record, base)
    if not flawed:
        return [plain]
    flights = range(len(base.seen) - 1)
    once = _each(record, base, flights)
    twice = [two for one in once for two in _each(record, one, _flights_after(one))]
    less = [_less(base, k) for k in range(1, len(base.seen) - 1)]
    ways = sorted([*once, *twice, *less], key=lambda way: _clash(record, way))
    found = [plain, *(_fitted(record, way) for way in ways[:OPENINGS])]
    good = sorted((one for one in found if _good(record, one)), key=lambda one: one.cost)
    return good[:BEGUN] or [plain]


def _each(record, base, flights):
    """The chains with one impact put in on one of some flights."""
    ways = product(flights, _sides(record.scene))
    return [one for flight, side in ways for one in _puts(record, base, flight, (side,))]


def _flights_after(base):
    """The flights after an impact that was put in."""
    return range(int(np.flatnonzero(base.seen < 0)[-1]) + 1, len(base.seen) - 1)


def _clash(record, base):
    """How badly the speeds with which flights come suit those with which the next ones go."""
    scene, phase = at(record, base.numbers)
    zero = np.zeros(len(base.seen))
    after, before = aimed(scene, Nodes(base.sides, zero, _apart(base.times, record.sigma[0]), zero), phase)
    lacks = after[1:] - bounces(scene, base.sides[1:-1]) * before[:-1]
    return float(np.sum(lacks**2) + 10.0 * np.sum(np.minimum(np.append(after, before), 0.0) ** 2))


def _grown(record, flawed, found):
    """The `Chain` from its first part on; its cost is `WRONG` at least where it breaks off."""
    count, done = len(record.times), min(FIRST, len(record.times))
    step = 2
    while done < count:
        end = min(count, done + step)
        new = _longer(record, found, done, end)
        if not _good(record, new):
            if end - done > 1:
                step = max(1, (end - done) // 2)
                continue
            if flawed:
                new = _mended(record, found, new, done, end)
            if not _good(record, new) or len(new.left_out) > 1 + MOST_SPURIOUS * end:
                return new._replace(cost=max(new.cost, WRONG))
        found, done = new, end
        step = max(2, int((FASTER - 1.0) * done))
    return found


def _without(found, k):
    """The chain where an impact of the record is left out."""
    return found._replace(left_out=(*found.left_out, k), cost=found.cost + SPURIOUS)


def _longer(record, found, done, end):
    """The chain with the record's impacts up to an end."""
    return _fitted(record, _base(record, _spread(found), done, end))


def _fitted(record, base):
    """The `Chain` of a `_Base`; speeds that are not known, nan, are those with which flights come."""
    scene, phase = at(record, base.numbers)
    times, zero = _apart(base.times, record.sigma[0]), np.zeros(len(base.seen))
    after, before = aimed(scene, Nodes(base.sides, zero, times, zero), phase)
    come = np.concatenate([[after[0] / max(bounces(scene, base.sides[:1])[0], WEAK)], before])
    nodes = Nodes(base.sides, zero, times, np.where(np.isnan(base.speeds), come, base.speeds))
    hit = np.flatnonzero(base.seen >= 0)
    given = Seen(hit, np.zeros(len(hit), int), record.times[base.seen[hit]], record.sigma[base.seen[hit]])
    found = chain_fit.solved(record.scene, record.phase, nodes, given, record.free, base.numbers, TRIED)
    cost = found.chi2 + found.moved + MISSED * np.sum(base.seen < 0) + SPURIOUS * len(base.left_out)
    return Chain(base.seen, base.left_out, found, float(cost if possible(found, record) else WRONG + cost))


def possible(found, record):
    """Whether a chain is a motion: solved, each impact into its wall, and no flight through one."""
    deep = np.max(record.sigma) * np.max(abs(found.nodes.second), initial=1.0)
    return bool(found.met and np.all(found.nodes.second > 0) and np.all(found.depth <= deep))


def _good(record, chain):
    found = chain.solved
    return chain.cost < WRONG and found.chi2 + found.moved <= special.chdtri(max(1, len(found.residuals) - 2), RARE)


def _apart(times, sigma):
    """Times in order, none as near to the next as their error."""
    times = np.array(times)
    for k in range(1, len(times)):
        times[k] = max(times[k], times[k - 1] + 0.5 * sigma)
    return times


def at(record, numbers):
    """(the scene with free numbers, the phase)."""
    given = dict(zip(record.free.names, numbers, strict=True))
    phase = float(given.pop("phase", record.phase))
    return changed(record.scene, given), phase


def bounces(scene, sides):
    """R of the walls on sides."""
    return np.array([float(scene.bounce(SIDES[int(side > 0)])) for side in sides])


def _mended(record, found, new, done, end):
    """The cheapest chain up to an end with impacts put in, or taken out; that without the new impact is not tried
    where another is possible."""
    base = _base(record, _spread(found), done, end)
    tried = [_fitted(record, way) for way in _likely(record, base)]
    known = _spread(new)
    for flight in _strained(new):
        tried += [_fitted(record, way) for way in _each(record, known, [flight])]
        tried += [_fitted(record, _less(base, k)) for k in (flight, flight + 1) if 0 < k < len(base.seen) - 1]
    best = min([new, *tried], key=lambda one: one.cost)
    return best if _good(record, best) else _without(found, end - 1)


def _sides(scene):
    return tuple(-1.0 if side == "left" else 1.0 for side in scene.walls)


def _strained(chain):
    """The flights that are under most strain, or pass through a wall."""
    strain = np.where(np.isfinite(chain.solved.strain), chain.solved.strain, 0.0)
    return np.argsort(-strain)[:STRAINED]


class _Base(NamedTuple):
    seen: Int[np.ndarray, " nodes"]
    sides: Float[np.ndarray, " nodes"]
    times: Float[np.ndarray, " nodes"]
    speeds: Float[np.ndarray, " nodes"]
    left_out: tuple[int, ...]
    numbers: Float[np.ndarray, " free"]


_NONE = _Base(np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0), (), np.zeros(0))


def _spread(chain):
    nodes, solved = chain.solved.nodes, chain.solved
    return _Base(chain.seen, nodes.sides, nodes.first, nodes.second, chain.left_out, solved.numbers)


def _base(record, base, done, end):
    """The chain with new impacts of the record, whose speeds are not known."""
    fresh = np.arange(done, end)
    return base._replace(
        seen=np.concatenate([base.seen, fresh]),
        sides=np.concatenate([base.sides, record.sides[fresh]]),
        times=np.concatenate([base.times, record.times[fresh]]),
        speeds=np.concatenate([base.speeds, np.full(len(fresh), np.nan)]),
    )


def _puts(record, base, flight, sides):
    """The chains with impacts put in after a node, at times that suit, the best first."""
    place, count = flight + 1, len(sides)
    speeds = np.insert(base.speeds, place, np.full(count, np.nan))
    speeds[place + count] = np.nan
    new = base._replace(
        seen=np.insert(base.seen, place, np.full(count, -1)),
        sides=np.insert(base.sides, place, sides),
        speeds=speeds,
    )
    suiting = _suiting(record, base, flight, sides)[1]
    return [new._replace(times=np.insert(base.times, place, times)) for times in suiting]


def _less(base, node):
    """The chain without a node; of a measured one the record's impact is left out."""
    seen, sides, times, speeds = (np.delete(one, node) for one in base[:4])
    speeds[node] = np.nan
    left_out = base.left_out if base.seen[node] < 0 else (*base.left_out, int(base.seen[node]))
    return base._replace(seen=seen, sides=sides, times=times, speeds=speeds, left_out=left_out)


def _likely(record, base):
    """The likely ways of putting in before the last impact."""
    flight, walls = len(base.seen) - 2, _sides(record.scene)
    kinds = [sides for count in (1, 2) for sides in product(walls, repeat=count)]
    kinds.sort(key=lambda sides: _suiting(record, base, flight, sides)[0])
    return [one for sides in kinds[:LIKELY] for one in _puts(record, base, flight, sides)]


def _suiting(record, base, flight, sides):
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
