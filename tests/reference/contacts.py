"""The first contact of many free flights: certified turning points in double, decided in 80-bit floats."""

from typing import NamedTuple

import numpy as np

from . import taylor
from .lanes import LONG, clearance, drive_phase, response_size, state, take

SLACK = 1e-12
DEEPEST = 30
EDGE = 1e-6


class Pieces(NamedTuple):
    """Stretches of time [low, high] of lanes."""

    lane: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Points(NamedTuple):
    """Turning points of one wall's clearance c with the starts and ends, sorted by lane and time; bend = c''."""

    lane: np.ndarray
    time: np.ndarray
    c: np.ndarray
    bend: np.ndarray
    turning: np.ndarray


def fastest(lanes):
    """The largest rate in a flight, 1 / the length of a piece to begin with."""
    rates = [wall.harmonic * lanes.omega for wall in lanes.walls]
    return np.maximum.reduce([1 + 2 * lanes.gamma, lanes.omega, *rates])


def cut(lanes, horizon):
    """Every lane's [0, horizon] in pieces of equal length."""
    count = np.ceil(horizon * fastest(lanes)).astype(int)
    lane = np.repeat(np.arange(len(lanes.x)), count)
    step = np.arange(len(lane)) - np.repeat(np.cumsum(count) - count, count)
    width, last = horizon[lane], count[lane]
    return Pieces(lane, width * (step / last), width * ((step + 1) / last))


def settle(lanes, wall, pieces):
    """Masks over the pieces: c' keeps its sign; c'' keeps its sign. Certified, in double with slack."""
    some, other = take(lanes, pieces.lane), take(wall, pieces.lane)
    middle = 0.5 * (pieces.low + pieces.high)
    radius = 0.5 * (pieces.high - pieces.low) * (1 + 1e-9) + 1e-14
    x, v = state(some, middle)
    theta, a = drive_phase(some, middle), some.amplitude
    own = taylor.response(some.gamma, some.omega, x, v, a * np.cos(theta), -a * np.sin(theta))
    rate = wall.harmonic * some.omega
    psi = wall.harmonic * theta + other.phase
    b = other.swing if wall.harmonic else np.zeros_like(x)
    walls = taylor.motion(rate, b * np.cos(psi), b * np.sin(psi))
    series = [w - y for w, y in zip(walls, own, strict=True)]
    energy, grown = np.hypot(x, v), np.exp(2 * some.gamma * radius)
    bound = taylor.ceiling(some.gamma, some.omega, np.abs(a), energy, radius, grown) + np.abs(b) * rate**taylor.ORDER
    size = energy + np.abs(a) * (1 + 1 / response_size(some.gamma, some.omega)) + np.abs(b)
    fast = fastest(some)
    sure = [
        np.abs(series[k]) > 1.001 * taylor.spread(series, k, radius, bound) + SLACK * size * fast**k for k in (1, 2)
    ]
    return sure[0], sure[1]


def bent(lanes, wall, horizon):
    """Pieces on which c'' keeps its sign and c' does not surely; lanes in which that stayed undecided."""
    pieces, kept = cut(lanes, horizon), []
    for _ in range(DEEPEST):
        steady, curved = settle(lanes, wall, pieces)
        kept.append([array[curved & ~steady] for array in pieces])
        lane, low, high = (array[~curved & ~steady] for array in pieces)
        if len(lane) == 0:
            break
        middle = 0.5 * (low + high)
        pieces = Pieces(np.tile(lane, 2), np.concatenate([low, middle]), np.concatenate([middle, high]))
    bad = np.zeros(len(lanes.x), bool)
    bad[lane] = True
    return Pieces(*(np.concatenate(arrays) for arrays in zip(*kept, strict=True))), bad


def zero(function, low, high, guess):
    """Zeros of function(index, t) -> (value, slope), monotone on [low, high] with a change of sign; 80 bit."""
    low, high, t = low.astype(LONG), high.astype(LONG), guess.astype(LONG)
    index = np.arange(len(t))
    rising = function(index, high)[0] > 0
    for _ in range(100):
        value, slope = function(index, t[index])
        up = (value > 0) == rising[index]
        high[index], low[index] = np.where(up, t[index], high[index]), np.where(up, low[index], t[index])
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t[index] - value / slope
        inside = (newton >= low[index]) & (newton <= high[index])
        new = np.where(inside, newton, 0.5 * (low[index] + high[index]))
        moved = np.abs(new - t[index]) > 4e-19 * (1 + np.abs(new))
        t[index] = new
        index = index[moved]
        if len(index) == 0:
            break
    return t


def points(lanes, wall, horizon):
    """All turning points of a wall's clearance up to the horizon, with both ends; and the lanes left undecided."""
    pieces, bad = bent(lanes, wall, horizon)

    def slope(index, t):
        lane = pieces.lane[index]
        return clearance(take(lanes, lane), take(wall, lane), t)[1:]

    every = np.arange(len(pieces.lane))
    change = np.sign(slope(every, pieces.low.astype(LONG))[0]) != np.sign(slope(every, pieces.high.astype(LONG))[0])
    pieces = Pieces(*(array[change] for array in pieces))
    turn = zero(slope, pieces.low, pieces.high, 0.5 * (pieces.low + pieces.high))
    ends, n = np.arange(len(lanes.x)), len(lanes.x)
    lane = np.concatenate([pieces.lane, ends, ends])
    time = np.concatenate([turn, np.zeros(n, LONG), horizon.astype(LONG)])
    turning = np.arange(len(lane)) < len(turn)
    order = np.lexsort((time, lane))
    lane, time, turning = lane[order], time[order], turning[order]
    c, _, bend = clearance(take(lanes, lane), take(wall, lane), time)
    return Points(lane, time, c, bend, turning), bad


def first_of_wall(lanes, wall, found):
    """Per lane the time at which the wall's clearance first passes 0 (inf if never), and c at the point after it."""
    falls = np.flatnonzero((found.lane[1:] == found.lane[:-1]) & (found.c[1:] < 0) & (found.c[:-1] > 0)) + 1
    lane, first = np.unique(found.lane[falls], return_index=True)
    at = falls[first]
    low, high = found.time[at - 1], found.time[at]
    with np.errstate(invalid="ignore", divide="ignore"):
        guess = high - np.sqrt(-2 * found.c[at] / found.bend[at])
    guess = np.where((guess > low) & (guess < high), guess, 0.5 * (low + high))

    def value(index, t):
        return clearance(take(lanes, lane[index]), take(wall, lane[index]), t)[:2]

    time = np.full(len(lanes.x), np.inf, LONG)
    time[lane] = zero(value, low, high, guess)
    after = np.full(len(lanes.x), np.inf, LONG)
    after[lane] = high
    return time, after


def first_contact(lanes, horizon, least):
    """Per lane: time (inf if none), side (0 if none), relative speed there, and whether all that is beyond doubt.

    In doubt are lanes with a minimum of a clearance within `least` of 0 that decides, a start or end too near a wall,
    two contacts at once, or a contact at the horizon.
    """
    n = len(lanes.x)
    sure, each = np.ones(n, bool), []
    for wall in lanes.walls:
        found, bad = points(lanes, wall, horizon)
        each.append((*first_of_wall(lanes, wall, found), found))
        sure &= ~bad
        begin = found.time == 0
        sure[found.lane[begin & (found.c < least[found.lane])]] = False
    times = np.array([time for time, _, _ in each])
    pick, time = np.argmin(times, axis=0), np.min(times, axis=0)
    for own, after, found in each:
        until = np.where(own == time, np.maximum(after, time), time)
        matters = (found.time <= until[found.lane]) & found.turning
        near = np.abs(found.c) < least[found.lane]
        last = (found.time == horizon[found.lane]) & (time[found.lane] == np.inf) & (np.abs(found.c) < EDGE)
        sure[found.lane[(matters & near) | last]] = False
    sure &= ~(np.isfinite(time) & (np.sum(times < time + EDGE, axis=0) > 1)) & ~(np.abs(horizon - time) < EDGE)
    side, speed = np.zeros(n, int), np.zeros(n, LONG)
    for k, wall in enumerate(lanes.walls):
        mine = np.flatnonzero(np.isfinite(time) & (pick == k))
        side[mine] = wall.side
        speed[mine] = np.abs(clearance(take(lanes, mine), take(wall, mine), time[mine])[1])
    return time, side, speed, sure
