"""Itineraries: the walls hit, as a word of "L" and "R" for each drive period; labels P n p q; mirror images.

An itinerary is a tuple of words, one for each period: ("LR",) or ("LRL", "R"). Orbits are compared cyclically: the
starting point on the orbit does not matter. Stored is one rotation, the `canonical_itinerary`, whatever rotation a
solver began with.
"""

import numpy as np

from ..scene import check

LETTERS = {-1: "L", 1: "R"}
SECTION_TOLERANCE = 1e-9  # of a drive period: an impact this soon after the section's phase counts as at it
STATE_DIGITS = 9  # relative to the largest number: states that agree to this many digits are equal
_MIRROR_LETTERS = str.maketrans("LR", "RL")


def validate_itinerary(itinerary, periods=None):
    """Validate an itinerary and return it as a tuple of words.

    Parameters
    ----------
    itinerary : sequence of str
        A word of "L" and "R" for each period.
    periods : int, optional
        Expected number of words.

    Returns
    -------
    tuple of str
        The itinerary.

    Raises
    ------
    ArgumentError
        If it is not an itinerary, or has another number of words.
    """
    rule = 'must be words of "L" and "R", one for each drive period, as ("LR",)'
    if not isinstance(itinerary, tuple | list) or not itinerary:
        raise check.ArgumentError("itinerary", rule, itinerary)
    if not all(isinstance(word, str) and set(word) <= {"L", "R"} for word in itinerary):
        raise check.ArgumentError("itinerary", rule, itinerary)
    if periods not in (None, len(itinerary)):
        raise check.ArgumentError("periods", f"must be the number of words, {len(itinerary)}, or None", periods)
    return tuple(itinerary)


def words_of_rows(side_rows):
    """Convert impacts that are recorded period by period to an itinerary.

    Parameters
    ----------
    side_rows : array_like of int
        Sides -1, 1 or 0 (empty slot), of shape (periods, slots).

    Returns
    -------
    tuple of str
        The itinerary.
    """
    return tuple("".join(LETTERS[side] for side in row if side) for row in np.asarray(side_rows).tolist())


def words_of_impacts(time, side, periods, drive_period):
    """Convert the impacts of one strobe over several periods to an itinerary.

    An impact at the end of a period belongs to the period that ends, one at time 0 to the first.

    Parameters
    ----------
    time, side : array_like
        Times, in t, and sides of the slots.
    periods : int
        Number of drive periods.
    drive_period : float
        Length of a drive period, in t.

    Returns
    -------
    tuple of str
        The itinerary.
    """
    time, side = np.asarray(time), np.asarray(side)
    is_impact = side != 0
    tolerance = 8.0 * np.finfo(time.dtype).eps * periods  # rounding may put an impact this far beyond the end
    period_index = np.clip(np.ceil(time[is_impact] / drive_period - tolerance).astype(int) - 1, 0, periods - 1)
    return tuple(
        "".join(LETTERS[int(wall_side)] for wall_side in side[is_impact][period_index == period])
        for period in range(periods)
    )


def itinerary_of_orbit(time, side, periods, drive_period):
    """Return the canonical itinerary of a periodic orbit from its impacts in any order.

    An impact at the phase of the section belongs to the period that ends.

    Parameters
    ----------
    time, side : array_like
        Times since the phase of the section, in t, and sides of the impacts.
    periods : int
        Number of drive periods.
    drive_period : float
        Length of a drive period, in t.

    Returns
    -------
    tuple of str
        The canonical itinerary.
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
    """Convert an itinerary to sides.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.

    Returns
    -------
    numpy.ndarray
        -1 for each impact on the left wall, 1 on the right, in order; of shape (impacts,).
    """
    return np.array([1.0 if letter == "R" else -1.0 for letter in "".join(itinerary)])


def label(itinerary, chatter_walls=""):
    """Format the label P n p q of an itinerary: n drive periods, p left and q right impacts.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.
    chatter_walls : str, optional
        Letters of the walls on which the mass comes to stick by complete chatter. Their count is "inf", as in P1-0-inf.

    Returns
    -------
    str
        The label. Hyphens separate the numbers as soon as one has two digits, as in P8-8-16.
    """
    letters = "".join(itinerary)
    wall_counts = ["inf" if side in chatter_walls else str(letters.count(side)) for side in "LR"]
    counts = [str(len(itinerary)), *wall_counts]
    return "P" + ("" if all(len(count) == 1 for count in counts) else "-").join(counts)


def minimal_period(sequence):
    """Return the smallest number of entries after which a periodic sequence repeats.

    It divides the length: ("LR", "LR") has 1, ("LR", "R", "LR") has 3.
    """
    sequence, size = tuple(sequence), len(sequence)
    return next((n for n in range(1, size + 1) if size % n == 0 and sequence == sequence[:n] * (size // n)), size)


def canonical_rotation(sequence):
    """Return the rotation by which a cyclic sequence comes first among its rotations."""
    sequence = tuple(sequence)
    return min(range(len(sequence)), key=lambda k: sequence[k:] + sequence[:k], default=0)


def rotate(itinerary, shift):
    """Rotate an itinerary, or other rows, to begin with another period.

    Parameters
    ----------
    itinerary : sequence
        An entry for each period.
    shift : int
        Index of the new first period.

    Returns
    -------
    tuple
        The rotated entries.
    """
    return tuple(itinerary[shift:]) + tuple(itinerary[:shift])


def canonical_itinerary(itinerary):
    """Return the rotation, period by period, that comes first: equal for all starts on one orbit at one section."""
    return rotate(itinerary, canonical_rotation(itinerary))


def canonical_start(itinerary, points):
    """Return the period with which the canonical itinerary of an orbit begins.

    If several rotations are canonical, the smallest state decides.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.
    points : numpy.ndarray
        x and v at the start of each period, of shape (periods, 2).

    Returns
    -------
    int
        Number of periods by which to rotate the orbit.
    """
    scale = abs(points).max() or 1.0
    states = [tuple(row) for row in (np.round(points / scale, STATE_DIGITS) + 0.0).tolist()]
    return min(range(len(states)), key=lambda k: (rotate(itinerary, k), rotate(states, k)))


def is_same_itinerary(itinerary, other):
    """Test that two itineraries agree cyclically.

    They have the same number of periods and hit the same walls in the same cyclic order. The period to which an impact
    belongs is not compared: it changes along a branch where an impact crosses phase 0.

    Parameters
    ----------
    itinerary, other : sequence of str
        A word for each period.

    Returns
    -------
    bool
        True if they agree.
    """
    letters, other_letters = "".join(itinerary), "".join(other)
    return len(itinerary) == len(other) and len(letters) == len(other_letters) and other_letters in letters + letters


def mirror_itinerary(itinerary):
    """Exchange left and right in an itinerary; the section of the mirror image lies half a period later.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.

    Returns
    -------
    tuple of str
        Itinerary of the mirror image.
    """
    return tuple(word.translate(_MIRROR_LETTERS) for word in itinerary)
