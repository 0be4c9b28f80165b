"""Closed forms of simple periodic orbits in mpmath, derived from the flow and the rebound alone.

Write x = forced response (p, q) + free part h. After an impact at a wall s on side k (+1 right, -1 left) with speed u
before it, h = (s - p, -k R u - q); before the next one it is the free flow E of that. With n periods between impacts on
one wall, E [h0 + (0, -k R u)] = h0 + (0, k u), h0 = (s - p, -q); in a mirror-symmetric orbit with half a period between
the impacts on -s and s the right side is minus that. So h0 = k u (a, b), and p^2 + q^2 / omega^2 = A^2 / D is a
quadratic in u. Every argument is the exact number it stores; mpmath's precision is the caller's. gamma < 1, D > 0.
"""

from typing import NamedTuple

from mpmath import atan2, cos, exp, fmod, matrix, mpf, pi, sin, sqrt


class Periodic(NamedTuple):
    """speed before impact u, drive phase of the impact in [0, 2 pi), and the state after it."""

    speed: mpf
    phase: mpf
    x: mpf
    v: mpf


class Fold(NamedTuple):
    """Amplitude of the double root and its speed; a saddle-node only where the speed is > 0."""

    amplitude: mpf
    speed: mpf


def denominator(gamma, omega):
    """D = (1 - omega^2)^2 + 4 gamma^2 omega^2."""
    gamma, omega = mpf(gamma), mpf(omega)
    return (1 - omega**2) ** 2 + (2 * gamma * omega) ** 2


def forced(gamma, omega, amplitude, phase):
    """State of the orbit without impact (P100) at a drive phase."""
    gamma, omega, amplitude, d = mpf(gamma), mpf(omega), mpf(amplitude), denominator(gamma, omega)
    inphase, behind = amplitude * (1 - omega**2) / d, amplitude * 2 * gamma * omega / d
    c, s = cos(phase), sin(phase)
    return inphase * c + behind * s, omega * (behind * c - inphase * s)


def grazing(gamma, omega, wall):
    """Amplitude at which P100 touches a wall at distance `wall`."""
    return abs(mpf(wall)) * sqrt(denominator(gamma, omega))


def free_flow(gamma, t):
    """Flow matrix of x'' + 2 gamma x' + x = 0 over t, gamma < 1."""
    gamma = mpf(gamma)
    root = sqrt(1 - gamma**2)
    c, s = exp(-gamma * t) * cos(root * t), exp(-gamma * t) * sin(root * t) / root
    return matrix([[c + gamma * s, s], [-s, c - gamma * s]])


def coefficients(gamma, omega, restitution, periods, symmetric):
    """(a, b) with free part u (a, b) at the impact; symmetric takes half a period and the mirror."""
    length, mirror = (pi / mpf(omega), -1) if symmetric else (2 * pi * periods / mpf(omega), 1)
    e = free_flow(gamma, length)
    right = matrix([0, mirror]) + e * matrix([0, mpf(restitution)])
    left = e - mirror * matrix([[1, 0], [0, 1]])
    det = left[0, 0] * left[1, 1] - left[0, 1] * left[1, 0]
    a = (left[1, 1] * right[0] - left[0, 1] * right[1]) / det
    b = (left[0, 0] * right[1] - left[1, 0] * right[0]) / det
    return a, b


def orbits(gamma, omega, amplitude, restitution, wall, side=1, periods=1, symmetric=False):
    """Orbits with one impact on `wall` in so many periods (P101, P110, P201), or symmetric P111 between -wall and wall.

    A list of at most two Periodic with speed > 0, the faster first. Each solves the impact's equations; whether it
    passes through a wall on the way is for the caller to see.
    """
    s, a_drive, omega = mpf(wall), mpf(amplitude), mpf(omega)
    d = denominator(gamma, omega)
    a, b = coefficients(gamma, omega, restitution, periods, symmetric)
    size = a**2 + b**2 / omega**2
    inner = (side * s * a) ** 2 - size * (s**2 - a_drive**2 / d)
    if inner < 0:
        return []
    speeds = [(side * s * a + sign * sqrt(inner)) / size for sign in (1, -1)]
    found = []
    for u in speeds:
        if u > 0:
            phase = phase_of(gamma, omega, a_drive, s - side * a * u, -side * b * u)
            found.append(Periodic(u, phase, s, -side * mpf(restitution) * u))
    return found


def phase_of(gamma, omega, amplitude, p, q):
    """Drive phase in [0, 2 pi) at which the forced response is (p, q)."""
    stiff, drag = 1 - omega**2, 2 * mpf(gamma) * omega
    phase = atan2(drag * p - stiff * q / omega, stiff * p + drag * q / omega)
    return fmod(phase + 2 * pi, 2 * pi) if amplitude > 0 else fmod(phase + 3 * pi, 2 * pi)


def at_phase(gamma, omega, amplitude, orbit, phase=0, symmetric=False):
    """State (x, v) of an orbit where the drive phase first is `phase` after its impact on the wall it was made for."""
    angle = fmod(mpf(phase) - orbit.phase + 4 * pi, 2 * pi)
    if symmetric and angle > pi:
        x, v = at_phase(gamma, omega, amplitude, orbit, mpf(phase) - pi)
        return -x, -v
    p, q = forced(gamma, omega, amplitude, orbit.phase)
    free = free_flow(gamma, angle / mpf(omega)) * matrix([orbit.x - p, orbit.v - q])
    p, q = forced(gamma, omega, amplitude, phase)
    return p + free[0], q + free[1]


def fold(gamma, omega, restitution, wall, side=1, periods=1, symmetric=False):
    """Fold of the orbits above: where the quadratic for u has its double root."""
    a, b = coefficients(gamma, omega, restitution, periods, symmetric)
    size = a**2 + (b / mpf(omega)) ** 2
    wall = mpf(wall)
    return Fold(sqrt(denominator(gamma, omega) / size) * abs(wall * b) / mpf(omega), side * wall * a / size)


def multipliers(gamma, omega, amplitude, restitution, orbit, periods=1, symmetric=False):
    """Floquet's multipliers of an orbit of `orbits`: eigenvalues of flight times saltation, squared where symmetric."""
    gamma, omega, r = mpf(gamma), mpf(omega), mpf(restitution)
    length = pi / omega if symmetric else 2 * pi * periods / omega
    before = -orbit.v / r
    force = mpf(amplitude) * cos(orbit.phase) - orbit.x
    shear = (force - 2 * gamma * orbit.v + r * (force - 2 * gamma * before)) / before
    m = free_flow(gamma, length) * matrix([[-r, 0], [shear, -r]])
    half, product = (m[0, 0] + m[1, 1]) / 2, m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    root = sqrt(half**2 - product)
    found = [half + root, half - root]
    return [each**2 for each in found] if symmetric else found
