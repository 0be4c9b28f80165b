"""Itineraries: the walls hit, in order, a word of "L" and "R" for each drive period; labels P n p q; the mirror image.

An itinerary is a tuple of words, one a period: ("LR",) or ("LRL", "R"). Orbits are compared cyclically: where along the
orbit one starts to read does not matter. Written is one rotation, the `canonical_itinerary`, whatever a solver began
with."""

import numpy as np

from ..scene import check

LETTERS = {-1: "L", 1: "R"}
SECTION_TOLERANCE = 1e-9  # of a drive period: as little after the section's phase is an impact at it
STATE_DIGITS = 9  # of the largest number: as near are two states one
_MIRROR_LETTERS = str.maketrans("LR", "RL")


def validate_itinerary(itinerary, periods=None):
    """The itinerary as a tuple of words; raises ArgumentError where it is none, or none of so many periods."""
    rule = 'must be words of "L" and "R", one a drive period, as ("LR",)'
    if not isinstance(itinerary, tuple | list) or not itinerary:
        raise check.ArgumentError("itinerary", rule, itinerary)
    if not all(isinstance(word, str) and set(word) <= {"L", "R"} for word in itinerary):
        raise check.ArgumentError("itinerary", rule, itinerary)
    if periods not in (None, len(itinerary)):
        raise check.ArgumentError("periods", f"must be the number of words, {len(itinerary)}, or None", periods)
    return tuple(itinerary)


def words_of_rows(side_rows):
    """The itinerary of impacts recorded period by period: sides -1, +1 or 0 (empty slot), shape (periods, slots)."""
    return tuple("".join(LETTERS[side] for side in row if side) for row in np.asarray(side_rows).tolist())


def words_of_impacts(time, side, periods, drive_period):
    """The itinerary of impacts that one strobe over a number of periods recorded: time and side of its slots.

    drive_period: of a drive period, in t. An impact at a period's end belongs to the period that ends, one at time 0 to
    the first."""
    time, side = np.asarray(time), np.asarray(side)
    is_impact = side != 0
    tolerance = 8.0 * np.finfo(time.dtype).eps * periods  # so much may rounding put an impact beyond the end
    period_index = np.clip(np.ceil(time[is_impact] / drive_period - tolerance).astype(int) - 1, 0, periods - 1)
    return tuple(
        "".join(LETTERS[int(wall_side)] for wall_side in side[is_impact][period_index == period])
        for period in range(periods)
    )


def itinerary_of_orbit(time, side, periods, drive_period):
    """The canonical itinerary of a periodic orbit, of its impacts' times since the section's phase, in any order.

    An impact at the section's phase belongs to the period that ends.
    """
    section_times = np.mod(np.asarray(time) - SECTION_TOLERANCE * drive_period, periods * drive_period)
    order = np.argsort(section_times)
    period_index = np.minimum(section_times[order] // drive_period, periods - 1)
    ordered_sides = np.asarray(side)[order]
    return canonical_itinerary(
        tuple(
            "".join(LETTERS[int(wall_side)] for wall_side in ordered_sides[period_index == period])
            for period in range(periods)
        )
    )


def wall_sides(itinerary):
    """-1 for each impact on the left wall, 1 on the right, in order: (impacts,)."""
    return np.array([1.0 if letter == "R" else -1.0 for letter in "".join(itinerary)])


def label(itinerary, chatter_walls=""):
    """P n p q: n drive periods, p impacts on the left wall, q on the right; P8-8-16 once a number has two digits.

    chatter_walls: letters of the walls on which the mass comes to rest by infinitely many hops: P1-0-inf.
    """
    letters = "".join(itinerary)
    wall_counts = ["inf" if side in chatter_walls else str(letters.count(side)) for side in "LR"]
    counts = [str(len(itinerary)), *wall_counts]
    return "P" + ("" if all(len(count) == 1 for count in counts) else "-").join(counts)


def minimal_period(sequence):
    """The smallest number of entries after which a periodic sequence, given once round or more, begins anew.

    It divides the length: ("LR", "LR") has 1, ("LR", "R", "LR") has 3.
    """
    sequence, size = tuple(sequence), len(sequence)
    return next((n for n in range(1, size + 1) if size % n == 0 and sequence == sequence[:n] * (size // n)), size)


def canonical_rotation(sequence):
    """How many entries to turn a cyclic sequence on by, so that it comes first among its rotations."""
    sequence = tuple(sequence)
    return min(range(len(sequence)), key=lambda k: sequence[k:] + sequence[:k], default=0)


def rotate(itinerary, shift):
    """The itinerary, or other rows, from another of its periods on."""
    return tuple(itinerary[shift:]) + tuple(itinerary[:shift])


def canonical_itinerary(itinerary):
    """The rotation, period by period, that comes first: equal for all starts along one orbit at one section."""
    return rotate(itinerary, canonical_rotation(itinerary))


def canonical_start(itinerary, points):
    """How many periods to turn an orbit on by, so that its itinerary is `canonical_itinerary`; where several rotations
    are, the least state begins. points: x and v at the start of each period, (periods, 2)."""
    scale = abs(points).max() or 1.0
    states = [tuple(row) for row in (np.round(points / scale, STATE_DIGITS) + 0.0).tolist()]
    return min(range(len(states)), key=lambda k: (rotate(itinerary, k), rotate(states, k)))


def is_same_itinerary(itinerary, other):
    """Whether two itineraries agree cyclically: as many periods, and the same walls hit in the same cyclic order.

    Which period an impact belongs to is not compared: that changes where an impact crosses phase 0, along one branch.
    """
    letters, other_letters = "".join(itinerary), "".join(other)
    return len(itinerary) == len(other) and len(letters) == len(other_letters) and other_letters in letters + letters


def mirror_itinerary(itinerary):
    """The itinerary of the mirror image, left and right exchanged; its section lies half a period on."""
    return tuple(word.translate(_MIRROR_LETTERS) for word in itinerary)
