"""Replay at rigid walls, which have no contact phases.

The interface is that of `linear_contact_replay` and `force_law_replay`; see `contact_replays`.
"""


def start_in_contact(coeffs, current, start_contact, path_end, order):
    """Return (`ExpansionPoint`, pending contact) of a start with a contact; `path_end` is the `PathEnd`."""
    return current, None


def complete_contact(coeffs, current, pending_contact, path_end, order):
    """Move lanes through their pending contact phase."""
    return current


def enter_wall(coeffs, current, side, delay, path_end, order):
    """Return (`ExpansionPoint`, pending contact) of lanes that hit a wall after a delay; side 0 means none."""
    return current, None


def shift_state(coeffs, current, contact, free_state, delay, order):
    """Return (x, v) after a delay; `free_state` is (x, v) of lanes outside soft walls."""
    return free_state
