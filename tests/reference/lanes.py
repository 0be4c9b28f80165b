"""Many free flights at once in numpy: exact flow and clearance at the precision of the times given (80 bit, double)."""

from typing import NamedTuple

import numpy as np
from jax import tree

LONG = np.longdouble


class Side(NamedTuple):
    """A wall of each lane: side -1 or +1, harmonic (0: at rest), position, swing (its amplitude) and phase: arrays."""

    side: int
    harmonic: int
    position: np.ndarray
    swing: np.ndarray
    phase: np.ndarray


class Lanes(NamedTuple):
    """Starts of free flights at t = 0 as doubles, all arrays of one shape: x, v at drive phase `phase`."""

    gamma: np.ndarray
    omega: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    x: np.ndarray
    v: np.ndarray
    walls: list


def take(lanes, index):
    """Return the lanes of an index, repeats allowed, of any record of arrays."""
    return tree.map(lambda leaf: leaf[index] if np.ndim(leaf) else leaf, lanes)


def response_size(gamma, omega):
    """sqrt(D), so that the forced amplitude is A / sqrt(D)."""
    return np.hypot((1 - omega) * (1 + omega), 2 * gamma * omega)


def steady(lanes, theta):
    """The forced response (x, v) at drive phase theta."""
    g, w, a = (array.astype(theta.dtype) for array in (lanes.gamma, lanes.omega, lanes.amplitude))
    stiff, drag = (1 - w) * (1 + w), 2 * g * w
    size = a / (stiff * stiff + drag * drag)
    sin, cos = np.sin(theta), np.cos(theta)
    return size * (stiff * cos + drag * sin), size * w * (drag * cos - stiff * sin)


def unforced(gamma, x, v, t):
    """(x, v) after t without drive, for any gamma >= 0; t may be negative."""
    g = gamma.astype(t.dtype)
    square = (1 - g) * (1 + g)
    root = np.sqrt(np.abs(square))
    angle = root * t
    under, over = square > 0, square < 0
    c, s = np.ones_like(t), t.copy()
    c[under], s[under] = np.cos(angle[under]), np.sin(angle[under]) / root[under]
    c[over], s[over] = np.cosh(angle[over]), np.sinh(angle[over]) / root[over]
    decay = np.exp(-g * t)
    c, s = c * decay, s * decay
    return (c + g * s) * x + s * v, (c - g * s) * v - s * x


def drive_phase(lanes, t):
    """theta at t."""
    return lanes.phase.astype(t.dtype) + lanes.omega.astype(t.dtype) * t


def travel(lanes, x, v, begin, end):
    """(x, v) at time `end` of the flight that is at (x, v) at time `begin` (arrays; forward or backward)."""
    p, q = steady(lanes, drive_phase(lanes, begin))
    dx, dv = unforced(lanes.gamma, x - p, v - q, end - begin)
    p, q = steady(lanes, drive_phase(lanes, end))
    return p + dx, q + dv


def state(lanes, t):
    """(x, v) at t from the lanes' own start."""
    return travel(lanes, lanes.x.astype(t.dtype), lanes.v.astype(t.dtype), np.zeros_like(t), t)


def wall_course(lanes, wall, t):
    """Position, velocity and acceleration of a wall at t."""
    place = wall.position.astype(t.dtype)
    if wall.harmonic == 0:
        return place, np.zeros_like(t), np.zeros_like(t)
    rate = wall.harmonic * lanes.omega.astype(t.dtype)
    psi = wall.harmonic * drive_phase(lanes, t) + wall.phase.astype(t.dtype)
    b = wall.swing.astype(t.dtype)
    swing = b * np.cos(psi)
    return place + swing, -rate * b * np.sin(psi), -rate * rate * swing


def acceleration(lanes, x, v, t):
    """x'' of free flight."""
    return lanes.amplitude * np.cos(drive_phase(lanes, t)) - 2 * lanes.gamma * v - x


def clearance(lanes, wall, t):
    """c = side (x_wall - x) and its first two derivatives at t."""
    x, v = state(lanes, t)
    place, speed, change = wall_course(lanes, wall, t)
    side = wall.side
    return side * (place - x), side * (speed - v), side * (change - acceleration(lanes, x, v, t))


def scale(lanes):
    """Largest of the walls' reach, the forced amplitude and the free part's hypot(x, v) at the start."""
    p, q = steady(lanes, lanes.phase)
    reach = [np.abs(wall.position) + (np.abs(wall.swing) if wall.harmonic else 0) for wall in lanes.walls]
    forced = np.abs(lanes.amplitude) / response_size(lanes.gamma, lanes.omega)
    return np.maximum.reduce([*reach, forced, np.hypot(lanes.x - p, lanes.v - q)])
