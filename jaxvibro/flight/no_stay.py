"""Rigid walls: nothing stays within one. The interface is that of `spring_stay` and `pushed_stay`, see `stays`."""


def begin(frame, path):
    """(frame as the lanes feel it, path, the lanes' contact where it matters to the flow, the derivatives' bias)."""
    return frame, path, None, ()


def going(path):
    """The path of the lanes that a step is for: those that are not, have no time to go."""
    return path


def facing(frame, contact, side, way, on, swing):
    """(the wall that is met, as `soft_contact.counted`, lanes that are on it, a bound on its motion, the side that it
    is met from, reach^k / k! of each lane)."""
    return way, on, swing, side, frame.weights


def bias(frame, path):
    """The bias of the acceleration and of its change, see `flow.extend`."""
    return None, None


def reach(frame):
    """The longest step, within walls too."""
    return frame.reach


def unbegun(none):
    """What the lanes' waits within a wall begin with; none: 0 of each lane."""


def paused(frame, path, wait, due, idle):
    """(path, wait) of the lanes that wait within a wall brought on. due: whether one has waited long enough; idle:
    whether none can do anything else."""
    return path, wait
