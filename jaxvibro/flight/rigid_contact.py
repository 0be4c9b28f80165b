"""Rigid walls: nothing stays within one. The interface is that of `spring_stay` and `pushed_stay`, see `stays`."""


def prepare_step(coeffs, path):
    """(frame as the lanes feel it, path, the lanes' contact where it matters to the flow, the derivatives' bias)."""
    return coeffs, path, None, ()


def active_path(path):
    """The path of the lanes that a step is for: those that are not, have no time to go."""
    return path


def target_wall(coeffs, contact, side, wall_derivs, is_leaving, wall_remainder):
    """(the wall that is met, as `soft_contact.counted`, lanes that are on it, a bound on its motion, the side that it
    is met from, reach^k / k! of each lane)."""
    return wall_derivs, is_leaving, wall_remainder, side, coeffs.taylor_weights


def extra_force(coeffs, path):
    """The bias of the acceleration and of its change, see `flow.extend`."""
    return None, None


def max_step(coeffs):
    """The longest step, within walls too."""
    return coeffs.max_step


def initial_wait(zero):
    """What the lanes' waits within a wall begin with; zero: 0 of each lane."""


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """(path, wait) of the lanes that wait within a wall brought on. is_due: whether one has waited long enough; idle:
    whether none can do anything else."""
    return path, wait_count
