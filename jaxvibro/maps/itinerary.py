"""Itineraries: the walls hit, in order, a word of "L" and "R" for each drive period; labels P n p q; the mirror image.

An itinerary is a tuple of words, one a period: ("LR",) or ("LRL", "R"). Orbits are compared cyclically: where along
the orbit one starts to read does not matter. Written is one rotation, the `canonical`, whatever a solver began with.
"""

import numpy as np

from ..scene import check

LETTERS = {-1: "L", 1: "R"}
NEAR = 1e-9  # of a drive period: as little after the section's phase is an impact at it
DIGITS = 9  # of the largest number: as near are two states one
_MIRROR = str.maketrans("LR", "RL")


def checked(itinerary, periods=None):
    """The itinerary as a tuple of words; raises ArgumentError where it is none, or none of so many periods."""
    told = 'must be words of "L" and "R", one a drive period, as ("LR",)'
    if not isinstance(itinerary, tuple | list) or not itinerary:
        raise check.ArgumentError("itinerary", told, itinerary)
    if not all(isinstance(word, str) and set(word) <= {"L", "R"} for word in itinerary):
        raise check.ArgumentError("itinerary", told, itinerary)
    if periods not in (None, len(itinerary)):
        raise check.ArgumentError("periods", f"must be the number of words, {len(itinerary)}, or None", periods)
    return tuple(itinerary)


def words(sides):
    """The itinerary of impacts recorded period by period: sides -1, +1 or 0 (empty slot), shape (periods, slots)."""
    return tuple("".join(LETTERS[side] for side in row if side) for row in np.asarray(sides).tolist())


def split(time, side, periods, length):
    """The itinerary of impacts that one strobe over a number of periods recorded: time and side of its slots.

    length: of a drive period, in t. An impact at a period's end belongs to the period that ends, one at time 0 to the
    first.
    """
    time, side = np.asarray(time), np.asarray(side)
    hit = side != 0
    slack = 8.0 * np.finfo(time.dtype).eps * periods  # so much may rounding put an impact beyond the end
    place = np.clip(np.ceil(time[hit] / length - slack).astype(int) - 1, 0, periods - 1)
    return tuple("".join(LETTERS[int(one)] for one in side[hit][place == k]) for k in range(periods))


def around(time, side, periods, length):
    """The canonical itinerary of a periodic orbit, of its impacts' times since the section's phase, in any order.

    An impact at the section's phase belongs to the period that ends.
    """
    late = np.mod(np.asarray(time) - NEAR * length, periods * length)
    order = np.argsort(late)
    place = np.minimum(late[order] // length, periods - 1)
    sides = np.asarray(side)[order]
    return canonical(tuple("".join(LETTERS[int(one)] for one in sides[place == k]) for k in range(periods)))


def sides(itinerary):
    """-1 for each impact on the left wall, 1 on the right, in order: (impacts,)."""
    return np.array([1.0 if letter == "R" else -1.0 for letter in "".join(itinerary)])


def label(itinerary, endless=""):
    """P n p q: n drive periods, p impacts on the left wall, q on the right; P8-8-16 once a number has two digits.

    endless: letters of the walls on which the mass comes to rest by infinitely many hops: P1-0-inf.
    """
    flat = "".join(itinerary)
    hits = ["inf" if side in endless else str(flat.count(side)) for side in "LR"]
    numbers = [str(len(itinerary)), *hits]
    return "P" + ("" if all(len(number) == 1 for number in numbers) else "-").join(numbers)


def least_period(sequence):
    """The smallest number of entries after which a periodic sequence, given once round or more, begins anew.

    It divides the length: ("LR", "LR") has 1, ("LR", "R", "LR") has 3.
    """
    sequence, size = tuple(sequence), len(sequence)
    return next((n for n in range(1, size + 1) if size % n == 0 and sequence == sequence[:n] * (size // n)), size)


def least_turn(sequence):
    """How many entries to turn a cyclic sequence on by, so that it comes first among its rotations."""
    sequence = tuple(sequence)
    return min(range(len(sequence)), key=lambda k: sequence[k:] + sequence[:k], default=0)


def turned(itinerary, turn):
    """The itinerary, or other rows, from another of its periods on."""
    return tuple(itinerary[turn:]) + tuple(itinerary[:turn])


def canonical(itinerary):
    """The rotation, period by period, that comes first: equal for all starts along one orbit at one section."""
    return turned(itinerary, least_turn(itinerary))


def first(itinerary, points):
    """How many periods to turn an orbit on by, so that its itinerary is `canonical`; where several rotations are, the
    least state begins. points: x and v at the start of each period, (periods, 2)."""
    size = abs(points).max() or 1.0
    rows = [tuple(row) for row in (np.round(points / size, DIGITS) + 0.0).tolist()]
    return min(range(len(rows)), key=lambda k: (turned(itinerary, k), turned(rows, k)))


def same(one, other):
    """Whether two itineraries agree cyclically: as many periods, and the same walls hit in the same cyclic order.

    Which period an impact belongs to is not compared: that changes where an impact crosses phase 0, along one branch.
    """
    flat, text = "".join(one), "".join(other)
    return len(one) == len(other) and len(flat) == len(text) and text in flat + flat


def mirrored(itinerary):
    """The itinerary of the mirror image, left and right exchanged; its section lies half a period on."""
    return tuple(word.translate(_MIRROR) for word in itinerary)
