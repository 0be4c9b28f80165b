"""The same orbit in other unknowns: its impacts counted from another one, or from another period."""

import numpy as np

REPEATED = 1e-6  # times and speeds as near are one


def images(along, cycle, value, near):
    """The points z near one of them that are the same orbit as a cycle at a value: its impacts counted from another."""
    count, span = int(np.sum(cycle.sides != 0)), float(cycle.periods) * 2.0 * np.pi
    rows = len(along.cycle.sides)
    if len(cycle.sides) != rows or cycle.periods != along.cycle.periods or not rows:
        return
    sides, own = np.asarray(cycle.sides[:count]), np.asarray(along.cycle.sides)
    if count != int(np.sum(own != 0)):
        return
    frequency = float(value) if bool(along.which.frequency) else float(along.scene.frequency)
    span, period = span / frequency, 2.0 * np.pi / frequency
    times, speeds = cycle.times[:count], cycle.speeds[:count]
    for turn in range(count):
        if not np.array_equal(np.roll(sides, -turn), own[:count]):
            continue
        late = np.concatenate([times[turn:], times[:turn] + span])
        late = late - period * np.round((late[0] - near[0]) / period)
        for shift in (-period, 0.0, period):
            z = np.zeros(2 * rows + 1)
            z[:count], z[rows : rows + count], z[-1] = late + shift, np.roll(speeds, -turn), value
            yield z


def is_repeated(along, z):
    """Whether an orbit, but for impacts without speed, is a shorter one, gone through more than once."""
    rows, periods = len(along.cycle.sides), int(along.cycle.periods)
    speeds, sides = z[rows : 2 * rows], np.asarray(along.cycle.sides)
    hit = (sides != 0) & (speeds > REPEATED * speeds.max(initial=0.0))
    turns = np.column_stack([np.diff(z[:rows][hit], append=np.inf), speeds[hit], sides[hit]])
    count, near = len(turns), REPEATED * (1.0 + abs(turns[:-1]).max(initial=0.0))
    for part in range(1, count):
        if count % part == 0 and periods % (count // part) == 0:
            apart = abs(np.roll(turns, part, axis=0) - turns)
            if apart[np.isfinite(apart)].max(initial=0.0) < near:
                return True
    return False
