"""Rigid walls: no stay is to be made again. The interface is that of `contact_replay` and `pushed_replay`, see
`stay_replays`."""


def start_in_contact(coeffs, current, start_contact, path_end, order):
    """(`taylor.Now`, what is still to be gone through) of a start; start_contact: its contact; path_end: the
    `PathEnd`."""
    return current, None


def complete_contact(coeffs, current, pending_contact, path_end, order):
    """Lanes brought through what was still to be gone through."""
    return current


def enter_wall(coeffs, current, side, delay, path_end, order):
    """(`taylor.Now`, what is still to be gone through) of lanes that hit the wall on a side a little later than now;
    side: 0 of those that hit none."""
    return current, None


def shift_state(coeffs, current, contact, free_state, delay, order):
    """(x, v) a time later. contact: of the lanes; free_state: (x, v) of those that are within no soft wall."""
    return free_state
