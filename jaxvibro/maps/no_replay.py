"""Rigid walls: no stay is to be made again. The interface is that of `contact_replay` and `pushed_replay`, see
`stay_replays`."""


def begun(frame, now, given, end, order):
    """(`taylor.Now`, what is still to be gone through) of a start; given: its contact; end: the `PathEnd`."""
    return now, None


def gone(frame, now, entry, end, order):
    """Lanes brought through what was still to be gone through."""
    return now


def entered(frame, now, side, late, end, order):
    """(`taylor.Now`, what is still to be gone through) of lanes that hit the wall on a side a little later than now;
    side: 0 of those that hit none."""
    return now, None


def shifted(frame, now, contact, free, late, order):
    """(x, v) a time later. contact: of the lanes; free: (x, v) of those that are within no soft wall."""
    return free
