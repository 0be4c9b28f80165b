"""The search for the chain that explains a record: it begins where six impacts fit as they are, and grows both ways.

From a chain's end the motion is flown on, as it would be, with the error that the numbers and the end have. An impact
that comes where the record has one is taken for it; one that comes much before is missing from the record. Where errors
leave this open, several chains are kept, and what comes later decides.
"""

from itertools import product

import numpy as np

from .first_return import Impact, Motion
from .matching import (
    SPURIOUS,
    WRONG,
    Base,
    Chain,
    Record,
    at,
    clashes,
    fitted,
    good,
    joined,
    less,
    plain,
    puts,
    slopes,
    suits,
    wall_sides,
)
from .matching import spread as as_found

FIRST, FASTER = 6, 0.4  # impacts of the first chain; by what share of it a sure one grows at once
EASY = 6.0  # a first chain that costs as little is not asked whether another is better
FITTED, WINDOWS = 16, 6  # first chains that are fitted, and grown
OPENINGS, BEGUN = 10, 4  # of those with impacts put in
MOST_SPURIOUS = 0.1  # of a record's impacts
ASIDE = 2.0  # scales of the frequency, within which it is looked for
TURN, MOST_TRIED = 0.5, 400  # rad of the last impact's phase between one frequency and the next; how many
NEAR = 5.0  # errors: an impact as near to one that was flown to may be it
SURE = 10.0  # of the record's errors: a time with an error as small is known
FLOWN = 5  # impacts that a chain is flown on by, where it is not sure
KEPT, CLOSE = 6, 24.0  # chains that are kept, and how much more than the best they may cost
PLENTY = 10.0  # a step that costs as much is asked whether another is cheaper
LIKELY = 4  # ways of putting in before a new impact, those that suit its speeds best
STRAINED = 3  # flights at which an impact is put in where a chain breaks off


def matched(record: Record, flawed: bool) -> Chain | None:
    """The `Chain` of a whole record; its cost is `WRONG` at least where there is none. flawed: whether the record may
    lack impacts or have others."""
    best = None
    for first in _openings(record, flawed):
        whole = _grown(record, flawed, first)
        if good(record, whole):
            return whole
        best = whole if best is None or len(whole.seen) > len(best.seen) else best
    return best


def _openings(record, flawed):
    """First chains, likely ones first: of a few impacts as they are, from several places on; then with some put in."""
    size, begun = min(FIRST, len(record.times)), record.free.begun
    first = fitted(record, plain(record, begun, np.arange(size)))
    easy = good(record, first) and first.cost <= EASY
    if easy:
        yield first
    found = [fitted(record, plain(record, numbers, np.arange(k, k + size))) for k, numbers in _places(record, size)]
    found += [] if easy else [first]
    yield from sorted((one for one in found if good(record, one)), key=lambda one: one.cost)[:WINDOWS]
    if flawed:
        yield from _opened(record, begun, size)


def _places(record, size):
    """(place in the record, numbers) where first chains may be, those first in which speeds suit each other best.
    A frequency that is little off is much off in the phase of a late impact: many are tried."""
    free, times = record.free, record.times
    begun, tried = free.begun, [free.begun]
    if "frequency" in free.names:
        which = free.names.index("frequency")
        reach = ASIDE * free.scales[which]
        count = int(min(MOST_TRIED, np.ceil(2.0 * reach * (times[-1] - min(times[0], 0.0)) / TURN))) + 1
        shifts = np.linspace(-reach, reach, count)[:, None] * (np.arange(len(begun)) == which)
        tried = list(begun + shifts[begun[which] + shifts[:, which] > 0])
    badly = np.array([clashes(record, plain(record, numbers, np.arange(len(times)))) for numbers in tried])
    sums = np.cumsum(np.pad(badly, ((0, 0), (1, 0))), axis=1)
    sums = sums[:, size - 2 :] - sums[:, : sums.shape[1] - size + 2]
    low = np.pad(sums, ((1, 1), (0, 0)), constant_values=np.inf)
    ways = np.argwhere((sums <= low[:-2]) & (sums <= low[2:]))
    ways = sorted(ways, key=lambda way: sums[way[0], way[1]])
    return [(int(place), tried[which]) for which, place in ways[:FITTED]]


def _opened(record, numbers, size):
    """Chains of the first impacts with one or two put in, or one left out, the cheapest first."""
    base = plain(record, numbers, np.arange(size))
    once = _each(record, base, range(size - 1))
    twice = [two for one in once for two in _each(record, one, range(_last_put(one) + 1, len(one.seen) - 1))]
    fewer = [less(base, k) for k in range(1, size - 1)]
    ways = sorted([*once, *twice, *fewer], key=lambda way: np.sum(clashes(record, way)))
    found = [fitted(record, way) for way in ways[:OPENINGS]]
    yield from sorted((one for one in found if good(record, one)), key=lambda one: one.cost)[:BEGUN]


def _each(record, base, flights):
    """The chains with one impact put in on one of some flights."""
    ways = product(flights, wall_sides(record.scene))
    return [one for flight, side in ways for one in puts(record, base, flight, (side,))]


def _last_put(base):
    return int(np.flatnonzero(base.seen < 0)[-1])


def _reach(chain):
    """(first, one past the last) of the record's impacts that a chain has come to."""
    hit = [*chain.seen[chain.seen >= 0], *chain.left_out]
    return min(hit), max(hit) + 1


def _grown(record, flawed, first):
    """The cheapest `Chain` of the whole record from a first part on; its cost is `WRONG` at least where it breaks
    off."""
    kept, count = [first], len(record.times)
    while True:
        low, high = _reach(kept[0])
        if low == 0 and high == count:
            return kept[0]
        way = 1 if high < count else -1
        fast = _leapt(record, flawed, kept[0], way) if len(kept) == 1 else None
        if fast is not None:
            kept = [fast]
            continue
        new = _stepped(record, flawed, kept, way)
        if not new:
            return kept[0]._replace(cost=kept[0].cost + WRONG)
        kept = new


def _stepped(record, flawed, kept, way):
    """The good chains with one impact of the record more, the cheapest first."""
    found = {}
    for one in kept:
        for new in _children(record, flawed, one, way):
            key = (tuple(new.seen), tuple(new.solved.nodes.sides))
            if good(record, new) and new.cost < found.get(key, new._replace(cost=np.inf)).cost:
                found[key] = new
    low, high = _reach(kept[0])
    most = 1 + MOST_SPURIOUS * (high - low)
    new = sorted((one for one in found.values() if len(one.left_out) <= most), key=lambda one: one.cost)
    return [one for one in new[:KEPT] if one.cost <= new[0].cost + CLOSE]


def _flown(record, chain, until, count, way):
    """[(the impact, the error of its time)] of the motion from a chain's end on, until a time, so many at most."""
    solved = chain.solved
    nodes, end, free = solved.nodes, (len(solved.nodes.sides) - 1 if way > 0 else 0), len(solved.numbers)
    scene, phase = at(record, solved.numbers)
    start = Impact(nodes.sides[end], nodes.first[end], nodes.second[end])
    found = Motion(scene, phase, way).onward(start, until, count)
    if not found:
        return []
    sides, times, speeds = (np.array(one) for one in zip(*[start, *found][::way], strict=True))
    by = slopes(record, nodes._replace(sides=sides, when=0.0 * sides, first=times, second=speeds), solved.numbers)[
        ::way
    ]
    own, new = (by[:, :, :2], by[:, :, 2:4])[::way]
    known, moves, errors = solved.spread([2 * end, 2 * end + 1]), np.eye(2, 2 + free), []
    for k in range(len(found)):
        numbers = np.concatenate([np.zeros((2, 2)), by[k, :, 4:]], 1)
        moves = -np.linalg.pinv(new[k]) @ (own[k] @ moves + numbers)
        errors.append(float(np.sqrt(max(moves[0] @ known @ moves[0], 0.0))))
    return list(zip(found, errors, strict=True))


def _ahead(record, chain, way, most):
    """The record's impacts beyond a chain's end, the nearest first."""
    low, high = _reach(chain)
    return np.arange(high, len(record.times))[:most] if way > 0 else np.arange(low - 1, -1, -1)[:most]


def _put(seen, impacts, way):
    """The `Base` of impacts that were flown to, the nearest first."""
    sides, times, speeds = (np.array(one, float) for one in zip(*impacts[::way], strict=True))
    return Base(np.array(seen[::way], int), sides, times, speeds, (), np.zeros(0))


def _leapt(record, flawed, chain, way):
    """The chain made longer by as much as is sure; None where nothing is."""
    todo = _ahead(record, chain, way, max(2, int(FASTER * len(chain.seen))))
    until = record.times[todo[-1]] + way * 2.0 * NEAR * SURE * record.sigma[0]
    taken, seen, kept = [], [], 0
    for impact, error in _flown(record, chain, until, 2 * len(todo), way):
        place = todo[kept]
        near = NEAR * np.hypot(error, record.sigma[place])
        late = way * (record.times[place] - impact.time)
        same = impact.side == record.sides[place] and abs(late) <= near
        if error > SURE * record.sigma[place] or not (same or (flawed and late > 2.0 * near)):
            break
        taken, seen, kept = [*taken, impact], [*seen, place if same else -1], kept + same
        if kept == len(todo):
            break
    while seen and seen[-1] < 0:
        taken, seen = taken[:-1], seen[:-1]
    if not seen:
        return None
    new = fitted(record, joined(as_found(chain), _put(seen, taken, way), way))
    return new if good(record, new) else None


def _children(record, flawed, chain, way):
    """The chain with the record's next impact, in the ways that there may be."""
    place, base = int(_ahead(record, chain, way, 1)[0]), as_found(chain)
    time, low_high = record.times[place], _reach(chain)
    gap = abs(time - record.times[low_high[1] - 1 if way > 0 else low_high[0]])
    found, taken = [], []
    for impact, error in _flown(record, chain, time + way * gap, FLOWN, way):
        near = NEAR * np.hypot(error, record.sigma[place])
        if impact.side == record.sides[place] and abs(impact.time - time) <= near:
            more = _put([-1] * len(taken) + [place], [*taken, impact._replace(time=time)], way)
            found.append(fitted(record, joined(base, more, way)))
        taken.append(impact)
        if way * (impact.time - time) > 0 or not flawed:
            break
    direct = joined(base, plain(record, base.numbers, [place]), way)
    found.append(fitted(record, direct))
    if flawed and not any(good(record, one) and one.cost < chain.cost + PLENTY for one in found):
        flight = len(base.seen) - 1 if way > 0 else 0
        kinds = [sides for count in (1, 2) for sides in product(wall_sides(record.scene), repeat=count)]
        kinds.sort(key=lambda sides: suits(record, direct, flight, sides)[0])
        found += [fitted(record, one) for sides in kinds[:LIKELY] for one in puts(record, direct, flight, sides)]
        found.append(chain._replace(left_out=(*chain.left_out, place), cost=chain.cost + SPURIOUS))
    return found
