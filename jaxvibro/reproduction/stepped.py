"""The paper's method in NumPy lanes: fixed-step Runge-Kutta 4, contact bracketed by halving and reversing the step.

Cheng and Xu 2007: at a crossing the step is halved and reversed until the contact lies within 1e-6 of a step. Between
walls at -1 and 1, from phase 0 on.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

BLOCK = 8192
BRACKET = 1e-6
ROOM = 30  # impacts in a period: complete chatter has them without end, and a lane stops there


class Drive(NamedTuple):
    """What is equal in all lanes: omega, gamma, R."""

    frequency: float
    damping: float
    restitution: float


class SteppedLanes(NamedTuple):
    """Lanes still on their way; move is the next step, beyond tells that the last one ended past a wall."""

    row: Int[np.ndarray, " lanes"]
    x: Float[np.ndarray, " lanes"]
    v: Float[np.ndarray, " lanes"]
    amplitude: Float[np.ndarray, " lanes"]
    time: Float[np.ndarray, " lanes"]
    move: Float[np.ndarray, " lanes"]
    searching: Bool[np.ndarray, " lanes"]
    beyond: Bool[np.ndarray, " lanes"]
    count: Int[np.ndarray, " lanes"]  # type: ignore[assignment]  # hides tuple's method


class Stepped(NamedTuple):
    """ends: (n, 2), x and v after a period; sides, times: of the impacts, (n, room), 0 and inf in empty slots."""

    ends: Float[np.ndarray, "rows 2"]
    sides: Int[np.ndarray, "rows room"]
    times: Float[np.ndarray, "rows room"]


def strobe(drive, states, steps, bracket=BRACKET, room=ROOM):
    """`Stepped`: rows (x, v, A) one drive period on, in so many steps a period; bracket: of a step."""
    shape = len(states), room
    found = Stepped(states[:, :2].copy(), np.zeros(shape, np.int8), np.full(shape, np.inf))
    for first in range(0, len(states), BLOCK):
        _block(drive, np.arange(first, min(first + BLOCK, len(states))), states, found, steps, bracket)
    return found


def _block(drive, rows, states, found, steps, bracket):
    """Fills in the results of some rows."""
    period, room = 2.0 * np.pi / drive.frequency, found.sides.shape[1]
    length = period / steps
    x, v, amplitude = states[rows].T.copy()
    zero, no = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    none = np.zeros(len(rows), dtype=int)
    lanes = SteppedLanes(rows, x, v, amplitude, zero, np.full(len(rows), length), no, no, none)
    while lanes.row.size:
        lanes, hit = _turn(drive, lanes, length, period, bracket)
        if hit.size:
            _rebound(drive, lanes, hit, found)
        # the last step is exactly the time left, so what remains is rounding
        done = (lanes.count == room) | (~lanes.searching & (period - lanes.time < 1e-9 * length))
        if done.any():
            found.ends[lanes.row[done]] = np.stack([lanes.x[done], lanes.v[done]], axis=1)
            lanes = SteppedLanes(*(part[~done] for part in lanes))


def _turn(drive, lanes, length, period, bracket):
    """One step in every lane: the lanes, and which of them have just found their contact."""
    x, v = _step(drive, lanes.x, lanes.v, lanes.amplitude, lanes.time, lanes.move)
    time = lanes.time + lanes.move
    beyond = np.abs(x) > 1
    searching = lanes.searching | beyond
    hit = searching & (np.abs(lanes.move) <= bracket * length)
    search = np.where(beyond == lanes.beyond, 0.5, -0.5) * lanes.move
    flying = hit | ~searching
    move = np.where(flying, np.minimum(length, period - time), search)
    lanes = lanes._replace(x=x, v=v, time=time, move=move, searching=searching & ~hit, beyond=beyond & ~hit)
    return lanes, np.flatnonzero(hit)


def _step(drive, x, v, amplitude, time, span):
    """Runge and Kutta's step of order 4, of a length that may be negative."""
    half, twice = 0.5 * span, 2 * drive.damping
    start, middle, end = (amplitude * np.cos(drive.frequency * (time + s)) for s in (0.0, half, span))
    a1 = start - x - twice * v
    v2 = v + half * a1
    a2 = middle - (x + half * v) - twice * v2
    v3 = v + half * a2
    a3 = middle - (x + half * v2) - twice * v3
    v4 = v + span * a3
    a4 = end - (x + span * v3) - twice * v4
    return x + span / 6 * (v + 2 * (v2 + v3) + v4), v + span / 6 * (a1 + 2 * (a2 + a3) + a4)


def _rebound(drive, lanes, hit, found):
    """Puts lanes that found their contact on the wall, turns them round and notes the impact."""
    side = np.sign(lanes.x[hit])
    lanes.x[hit] = side
    lanes.v[hit] *= -drive.restitution
    slot = lanes.row[hit], lanes.count[hit]
    found.sides[slot], found.times[slot] = side, lanes.time[hit]
    lanes.count[hit] += 1
