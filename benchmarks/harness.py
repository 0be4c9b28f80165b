"""Time methods in turn with this package, round after round: changes of the machine's speed affect both."""

import gc
import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rows import spread


class Side(NamedTuple):
    """One method at one setting.

    `prepare` makes, from (n, 3) states, a call without arguments that does the work and waits for its end; `read`
    converts the result of that call into (ends, sides), sides None if there are none. `states` is the number of states
    it maps.
    """

    method: str
    setting: str
    states: int
    prepare: Callable[[np.ndarray], Callable[[], Any]]
    read: Callable[[Any], tuple[np.ndarray, np.ndarray | None]]


class Timing(NamedTuple):
    """Nanoseconds per map of each round for a method, and for this package timed just before it.

    `first` is the seconds of the very first call; `ends` and `sides` are the results of the last round.
    """

    own: np.ndarray
    ours: np.ndarray
    first: float
    ends: np.ndarray
    sides: np.ndarray | None

    @property
    def cost(self):
        """Nanoseconds per map: median and quartiles."""
        return spread(self.own)

    @property
    def ratio(self):
        """Time relative to this package: median and quartiles of the rounds."""
        return spread(self.own / self.ours)


def clock(call):
    """Return the seconds of processor time of a call, and its result.

    On one core this is the wall-clock time without that of other programs.
    """
    start = time.process_time()
    answer = call()
    return time.process_time() - start, answer


def measure(ours, rivals, states, rounds, tell=print):
    """Time each rival Side in turn with this package; returns {Side: Timing} for all."""
    calls, firsts = {}, {}
    for side in (ours, *rivals):
        calls[side] = side.prepare(states[: side.states])
        firsts[side], _ = clock(calls[side])
        tell(f"  first call of {side.method} {side.setting}: {firsts[side]:.2f} s")
    paces, answers = {side: [] for side in rivals}, {}
    with undisturbed():
        for turn in range(rounds):
            for side in rivals:
                before, answers[ours] = clock(calls[ours])
                spent, answers[side] = clock(calls[side])
                after, _ = clock(calls[ours])
                paces[side].append((1e9 * spent / side.states, 5e8 * (before + after) / ours.states))
            tell(f"  round {turn + 1} of {rounds}")
    base = np.array([pace[1] for side in rivals for pace in paces[side]])
    timings = {ours: Timing(base, base, firsts[ours], *ours.read(answers[ours]))}
    for side in rivals:
        own, beside = np.array(paces[side]).T
        timings[side] = Timing(own, beside, firsts[side], *side.read(answers[side]))
    return timings


def in_turn(base, call, rounds):
    """Return the seconds of a call and its time over that of a base around it: arrays, one number per round."""
    call()
    base()
    spent, ratios = [], []
    with undisturbed():
        for _ in range(rounds):
            before, _ = clock(base)
            own, _ = clock(call)
            after, _ = clock(base)
            spent.append(own)
            ratios.append(2.0 * own / (before + after))
    return np.array(spent), np.array(ratios)


def alone(call, rounds):
    """Return the seconds of a warm call: an array, one number per round."""
    call()
    with undisturbed():
        return np.array([clock(call)[0] for _ in range(rounds)])


def repeated(call, times):
    """Make a call that repeats a call."""

    def several():
        for _ in range(times):
            call()

    return several


@contextmanager
def undisturbed():
    """Pause Python's garbage collector."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def latency(call, repeats):
    """Return the wall-clock microseconds of a warm call: one number per call."""
    marks = []
    with undisturbed():
        for _ in range(repeats):
            start = time.perf_counter()
            call()
            marks.append(1e6 * (time.perf_counter() - start))
    return np.array(marks)
