"""Compute free flight of many lanes in 80-bit floats, accurate at resonance and at any damping.

Divided differences avoid quotients by D or by sqrt(1 - gamma^2). x'' + 2 gamma x' + x = Re(A exp(i (theta + omega t))).
From rest at 0 the response is A exp(i theta) times the divided difference of exp(s t) over s = i omega, a, b, where a
and b are the roots of s^2 + 2 gamma s + 1.
"""

from typing import NamedTuple

import numpy as np

LONG = np.longdouble


class Wall(NamedTuple):
    """Wall of every lane: side -1 or 1, harmonic (0: fixed), and (lanes,) position, motion amplitude and phase."""

    side: int
    harmonic: int
    position: np.ndarray
    swing: np.ndarray
    phase: np.ndarray

    def some(self, lanes):
        """Select lanes."""
        return self._replace(**{name: getattr(self, name)[lanes] for name in ("position", "swing", "phase")})


class Lanes(NamedTuple):
    """Oscillators, (lanes,) each: parameters, and the state at drive phase `phase`."""

    gamma: np.ndarray
    omega: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    x: np.ndarray
    v: np.ndarray

    def some(self, lanes):
        """Select lanes."""
        return Lanes(*(each[lanes] for each in self))


def quotient(z):
    """Compute (exp(z) - 1) / z of complex numbers, 1 at 0."""
    near = np.abs(z) < 1e-30
    safe = np.where(near, 1, z)
    real, imaginary = safe.real, safe.imag
    half = np.sin(imaginary / 2)
    grown = np.expm1(real) * np.cos(imaginary) - 2 * half * half + 1j * np.exp(real) * np.sin(imaginary)
    return np.where(near, 1, grown / safe)


def roots(gamma):
    """Return the roots a, b of s^2 + 2 gamma s + 1, complex, a the slower one."""
    square = (1 - gamma) * (1 + gamma)
    root = np.sqrt(np.abs(square))
    fast = gamma + root
    under = square > 0
    return np.where(under, -gamma + 1j * root, -1 / fast), np.where(under, -gamma - 1j * root, -fast)


def fly(lanes, t):
    """Return (x, v) after the time t, which may be negative."""
    gamma, omega, amplitude, phase, x, v = (each.astype(LONG) for each in lanes)
    t = np.asarray(t, LONG)
    a, b = roots(gamma)
    drive = 1j * omega
    slow = np.exp(a * t)
    free = slow * t * quotient((b - a) * t)  # divided difference of exp(s t) over a, b: the impulse response, real
    mixed = slow * t * quotient((drive - a) * t)
    driven = (mixed - free) / (drive - b)
    pushed = amplitude * np.exp(1j * phase)
    position = (slow - a * free) * x + free * v  # exp(a t) = E11 + a E12
    speed = -free * x + (slow + b * free) * v
    return position.real + (pushed * driven).real, speed.real + (pushed * (b * driven + mixed)).real


def acceleration(lanes, x, v, t):
    """Return x'' of free flight at the time t."""
    angle = lanes.phase.astype(LONG) + lanes.omega.astype(LONG) * t
    return lanes.amplitude * np.cos(angle) - 2 * lanes.gamma.astype(LONG) * v - x


def course(lanes, wall, t):
    """Return position, velocity and acceleration of a wall."""
    place, nothing = wall.position.astype(LONG), np.zeros(len(wall.position), LONG)
    if not wall.harmonic:
        return place, nothing, nothing
    rate = wall.harmonic * lanes.omega.astype(LONG)
    angle = wall.harmonic * (lanes.phase.astype(LONG) + lanes.omega.astype(LONG) * t) + wall.phase.astype(LONG)
    swing = wall.swing.astype(LONG)
    return place + swing * np.cos(angle), -rate * swing * np.sin(angle), -rate * rate * swing * np.cos(angle)


def clearance(lanes, wall, t):
    """Return side (x_wall - x) and its first two derivatives at the time t."""
    x, v = fly(lanes, t)
    place, speed, change = course(lanes, wall, t)
    bend = change - acceleration(lanes, x, v, t)
    return wall.side * (place - x), wall.side * (speed - v), wall.side * bend
