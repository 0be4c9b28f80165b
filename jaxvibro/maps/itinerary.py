"""Itineraries of orbits, with their labels and mirror images.

An itinerary is the sequence of walls hit, a tuple of words of "L" and "R", one for each drive period: ("LR",) or
("LRL", "R"). Orbits are compared cyclically, because the starting point on an orbit is arbitrary. The stored rotation
is the `canonical_itinerary`.
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
        If the argument is not an itinerary, or if the number of words is not `periods`.
    """
    rule_text = 'must be words of "L" and "R", one for each drive period, as ("LR",)'
    if not isinstance(itinerary, tuple | list) or not itinerary:
        raise check.ArgumentError("itinerary", rule_text, itinerary)
    if not all(isinstance(word, str) and set(word) <= {"L", "R"} for word in itinerary):
        raise check.ArgumentError("itinerary", rule_text, itinerary)
    if periods not in (None, len(itinerary)):
        raise check.ArgumentError("periods", f"must be the number of words, {len(itinerary)}, or None", periods)
    return tuple(itinerary)


def itinerary_of_rows(sides_by_period):
    """Convert the sides of impacts in each period to an itinerary.

    Parameters
    ----------
    sides_by_period : array_like of int
        Sides -1, 1 or 0 (empty slot), of shape (periods, slots).

    Returns
    -------
    tuple of str
        The itinerary.
    """
    return tuple(
        "".join(LETTERS[side] for side in period_sides if side) for period_sides in np.asarray(sides_by_period).tolist()
    )


def itinerary_of_impacts(impact_times, impact_sides, periods, drive_period):
    """Convert the impacts of one strobe over several periods to an itinerary.

    An impact at the end of a period belongs to the period that ends. An impact at time 0 belongs to the first period.

    Parameters
    ----------
    impact_times, impact_sides : array_like
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
    impact_times, impact_sides = np.asarray(impact_times), np.asarray(impact_sides)
    is_impact = impact_sides != 0
    rounding_tolerance = (
        8.0 * np.finfo(impact_times.dtype).eps * periods
    )  # rounding may put an impact this far beyond the end
    period_index = np.clip(
        np.ceil(impact_times[is_impact] / drive_period - rounding_tolerance).astype(int) - 1, 0, periods - 1
    )
    return tuple(
        "".join(LETTERS[int(wall_side)] for wall_side in impact_sides[is_impact][period_index == period_number])
        for period_number in range(periods)
    )


def itinerary_of_orbit(impact_times, impact_sides, periods, drive_period):
    """Return the canonical itinerary of a periodic orbit from its impacts in any order.

    An impact at the phase of the section belongs to the period that ends.

    Parameters
    ----------
    impact_times, impact_sides : array_like
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
    section_times = np.mod(np.asarray(impact_times) - SECTION_TOLERANCE * drive_period, periods * drive_period)
    time_order = np.argsort(section_times)
    period_index = np.minimum(section_times[time_order] // drive_period, periods - 1)
    ordered_sides = np.asarray(impact_sides)[time_order]
    return canonical_itinerary(
        tuple(
            "".join(LETTERS[int(wall_side)] for wall_side in ordered_sides[period_index == period_number])
            for period_number in range(periods)
        )
    )


def sides_of_itinerary(itinerary):
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
    return np.array([1.0 if wall_letter == "R" else -1.0 for wall_letter in "".join(itinerary)])


def format_label(itinerary, chatter_wall_letters=""):
    """Format the label P n p q of an itinerary: n drive periods, p left and q right impacts.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.
    chatter_wall_letters : str, optional
        Letters of walls on which the mass sticks after complete chatter. The count of these walls is "inf": P1-0-inf.

    Returns
    -------
    str
        The label. If a number has more than one digit, hyphens separate the numbers, as in P8-8-16.
    """
    impact_letters = "".join(itinerary)
    impact_counts = ["inf" if side in chatter_wall_letters else str(impact_letters.count(side)) for side in "LR"]
    label_numbers = [str(len(itinerary)), *impact_counts]
    return "P" + ("" if all(len(label_number) == 1 for label_number in label_numbers) else "-").join(label_numbers)


def minimal_period(sequence):
    """Return the smallest number of entries after which a periodic sequence repeats.

    The number divides the length of the sequence: it is 1 for ("LR", "LR"), and 3 for ("LR", "R", "LR").
    """
    sequence, sequence_length = tuple(sequence), len(sequence)
    return next(
        (
            candidate_period
            for candidate_period in range(1, sequence_length + 1)
            if sequence_length % candidate_period == 0
            and sequence == sequence[:candidate_period] * (sequence_length // candidate_period)
        ),
        sequence_length,
    )


def canonical_shift(sequence):
    """Return the shift that gives the lexicographically smallest rotation of a sequence."""
    sequence = tuple(sequence)
    return min(range(len(sequence)), key=lambda k: sequence[k:] + sequence[:k], default=0)


def rotate_periods(period_entries, new_first_period):
    """Rotate a sequence with an entry for each period so that another period comes first.

    Parameters
    ----------
    period_entries : sequence
        An entry for each period.
    new_first_period : int
        Index of the new first period.

    Returns
    -------
    tuple
        The rotated entries.
    """
    return tuple(period_entries[new_first_period:]) + tuple(period_entries[:new_first_period])


def canonical_itinerary(itinerary):
    """Return the lexicographically smallest rotation of an itinerary, which does not depend on its first period."""
    return rotate_periods(itinerary, canonical_shift(itinerary))


def canonical_start_period(itinerary, period_start_points):
    """Return the period with which the canonical itinerary of an orbit begins.

    If several rotations give the canonical itinerary, the rotation with the smallest states is chosen.

    Parameters
    ----------
    itinerary : sequence of str
        A word for each period.
    period_start_points : numpy.ndarray
        x and v at the start of each period, of shape (periods, 2).

    Returns
    -------
    int
        Number of periods by which to rotate the orbit.
    """
    largest_component = abs(period_start_points).max() or 1.0
    rounded_states = [
        tuple(row) for row in (np.round(period_start_points / largest_component, STATE_DIGITS) + 0.0).tolist()
    ]
    return min(
        range(len(rounded_states)), key=lambda k: (rotate_periods(itinerary, k), rotate_periods(rounded_states, k))
    )


def is_same_itinerary(itinerary, other_itinerary):
    """Test whether two itineraries agree cyclically.

    Itineraries agree if the numbers of periods and the cyclic sequences of walls are equal. The period of an impact is
    ignored, because it changes along a branch where an impact crosses phase 0.

    Parameters
    ----------
    itinerary, other_itinerary : sequence of str
        A word for each period.

    Returns
    -------
    bool
        True if the itineraries agree.
    """
    joined_letters, other_joined_letters = "".join(itinerary), "".join(other_itinerary)
    return (
        len(itinerary) == len(other_itinerary)
        and len(joined_letters) == len(other_joined_letters)
        and other_joined_letters in joined_letters + joined_letters
    )


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
