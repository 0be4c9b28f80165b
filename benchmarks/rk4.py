"""The paper's method in NumPy lanes: fixed-step Runge-Kutta 4, contact bracketed by halving and reversing the step.

Cheng and Xu 2007: at a crossing the step is halved and reversed until the contact lies within 1e-6 of a step.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, blank

BLOCK = 8192
BRACKET = 1e-6


class Lanes(NamedTuple):
    """Lanes still on their way; move is the next step, beyond tells that the last one ended past a wall."""

    row: np.ndarray
    x: np.ndarray
    v: np.ndarray
    amplitude: np.ndarray
    time: np.ndarray
    move: np.ndarray
    searching: np.ndarray
    beyond: np.ndarray
    count: np.ndarray


def step(x, v, amplitude, time, span):
    """Advance lanes by one Runge-Kutta 4 step of length span, which may be negative."""
    half = 0.5 * span
    start, middle, end = (amplitude * np.cos(OMEGA * (time + s)) for s in (0.0, half, span))
    a1 = start - x - 2 * GAMMA * v
    v2 = v + half * a1
    a2 = middle - (x + half * v) - 2 * GAMMA * v2
    v3 = v + half * a2
    a3 = middle - (x + half * v2) - 2 * GAMMA * v3
    v4 = v + span * a3
    a4 = end - (x + span * v3) - 2 * GAMMA * v4
    return x + span / 6 * (v + 2 * (v2 + v3) + v4), v + span / 6 * (a1 + 2 * (a2 + a3) + a4)


def turn(lanes, length):
    """Take one step in every lane; return the lanes and which of them have just found their contact."""
    x, v = step(lanes.x, lanes.v, lanes.amplitude, lanes.time, lanes.move)
    time = lanes.time + lanes.move
    beyond = np.abs(x) > 1
    searching = lanes.searching | beyond
    found = searching & (np.abs(lanes.move) <= BRACKET * length)
    search = np.where(beyond == lanes.beyond, 0.5, -0.5) * lanes.move
    flying = found | ~searching
    move = np.where(flying, np.minimum(length, PERIOD - time), search)
    lanes = lanes._replace(x=x, v=v, time=time, move=move, searching=searching & ~found, beyond=beyond & ~found)
    return lanes, np.flatnonzero(found)


def rebound(lanes, found, result):
    """Put lanes that found their contact on the wall, turn them round and note the impact."""
    side = np.sign(lanes.x[found])
    lanes.x[found] = side
    lanes.v[found] *= -RESTITUTION
    slot = lanes.row[found], lanes.count[found]
    result.sides[slot], result.times[slot] = side, lanes.time[found]
    lanes.count[found] += 1


def strobe_block(rows, states, result, length):
    """Fill the results of some rows."""
    x, v, amplitude = states[rows].T.copy()
    zero, no = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    lanes = Lanes(rows, x, v, amplitude, zero, np.full(len(rows), length), no, no, np.zeros(len(rows), dtype=int))
    while lanes.row.size:
        lanes, found = turn(lanes, length)
        if found.size:
            rebound(lanes, found, result)
        # the last step is exactly the time left, so what remains is rounding
        done = (lanes.count == CAP) | (~lanes.searching & (PERIOD - lanes.time < 1e-9 * length))
        if done.any():
            result.ends[lanes.row[done]] = np.stack([lanes.x[done], lanes.v[done]], axis=1)
            lanes = Lanes(*(part[~done] for part in lanes))


def strobe(states, steps=400):
    """Map (n, 3) states x, x', A through one period in the given number of steps a period; returns Strobes."""
    result = blank(states)
    rows = np.arange(len(states))
    for first in range(0, len(states), BLOCK):
        strobe_block(rows[first : first + BLOCK], states, result, PERIOD / steps)
    return result
