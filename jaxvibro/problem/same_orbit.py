"""The same orbit in other unknowns: its impacts counted from another one, or from another period."""

import numpy as np

from ..orbits.orbit_comparison import meetings, times_round
from .equations import number_there

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
    return times_round(impacts(along, z), int(along.cycle.periods), REPEATED) > 1


def turns(along, z, times, sides):
    """Which of some touches each is when an orbit, repeated but for impacts without speed, has gone through the shorter
    one so many times: (times round, touches), the first row being each itself."""
    periods = int(along.cycle.periods)
    rounds = times_round(impacts(along, z), periods, REPEATED)
    span = periods * 2.0 * np.pi / number_there(along, z, "frequency")
    late = times - times[:, None] - span / rounds * np.arange(rounds)[:, None, None]
    apart = abs(late - span * np.round(late / span)) + span * (sides != sides[:, None])
    return apart.argmin(axis=2)


def impacts(along, z, length=None):
    """The impacts of an orbit in order as points (`orbit_comparison`), speeds over a length per t or the largest."""
    rows = len(along.cycle.sides)
    times, speeds = z[:rows], z[rows : 2 * rows]
    length = length or speeds.max(initial=0.0) or 1.0
    return meetings(number_there(along, z, "frequency"), times, along.cycle.sides, speeds, length)
