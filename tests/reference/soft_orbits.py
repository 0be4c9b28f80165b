"""Orbits between soft walls at rest by closed forms, in mpmath to 40 digits: nothing is shared with the package.

Unknowns are, of each contact, when it begins, how fast, and how long it lasts; the motion free and within a wall is the
textbook's closed form. A grazing from within adds the frequency, and the time within one contact at which the mass is
at its wall without speed. A saddle-node adds the frequency, and has a singular Jacobian.
"""

from typing import NamedTuple

import mpmath
from mpmath import cos, exp, matrix, mp, mpc, mpf, pi, sin, sqrt

DIGITS, STEP = 40, mpf(10) ** -20


class Oscillator(NamedTuple):
    """x'' + 2 gamma x' + x = amplitude cos(frequency t); walls: {side: (position, stiffness, damping)}, soft."""

    amplitude: float
    gamma: float
    walls: dict


def symmetric(amplitude, gamma, damping, stiffness):
    """Return the oscillator between equal soft walls at -1 and 1."""
    return Oscillator(amplitude, gamma, {side: (side, stiffness, damping) for side in (-1, 1)})


def forced(one, stiffness, gamma, constant, frequency, time):
    """x and v of the steady motion."""
    turn = mpf(one.amplitude) * exp(mpc(0, 1) * frequency * time)
    turn /= stiffness - frequency**2 + mpc(0, 2) * gamma * frequency
    return turn.real + constant / stiffness, -frequency * turn.imag


def flown(one, side, frequency, start, time, x, v):
    """(x, v) a time after a start: within the wall on a side, free where that is 0."""
    stiffness, gamma, constant = mpf(1), mpf(one.gamma), mpf(0)
    if side:
        place, soft, damping = map(mpf, one.walls[side])
        stiffness, gamma, constant = 1 + soft, damping, soft * place
    p, q = forced(one, stiffness, gamma, constant, frequency, start)
    x, v = x - p, v - q
    own = sqrt(mpc(stiffness - gamma**2))
    fade, cosine = exp(-gamma * time), cos(own * time)
    sine = sin(own * time) / own
    a = (fade * ((cosine + gamma * sine) * x + sine * v)).real
    b = (fade * ((cosine - gamma * sine) * v - stiffness * sine * x)).real
    p, q = forced(one, stiffness, gamma, constant, frequency, start + time)
    return a + p, b + q


@mpmath.workdps(DIGITS)
def height(one, frequency, time, speed):
    """The largest x within the right wall after an entry."""
    place, stiffness, _ = one.walls[1]
    half = pi / sqrt(mpf(1 + stiffness))
    turn = mp.findroot(lambda t: flown(one, 1, frequency, time, t, place, speed)[1], (0, half), solver="anderson")
    return flown(one, 1, frequency, time, turn, place, speed)[0]


def duration(one, side, frequency, time, speed, samples=400):
    """The duration of a contact."""
    wall, span = one.walls[side][0], 2 * pi / frequency / samples

    def depth(late):
        return side * (flown(one, side, frequency, time, late, wall, side * speed)[0] - wall)

    end = next(k for k in range(1, samples) if depth(k * span) <= 0)
    return mp.findroot(depth, ((end - 1) * span or span / 2, end * span), solver="anderson")


def residuals(one, sides, frequency, numbers, periods=1):
    """What is left of the equations: of each contact that it ends at its wall, and that the flight from there ends at
    the next, with its speed. periods: 1, or 1 / 2 for an orbit whose second half is the mirror image of its first."""
    found, contacts = [], triples(numbers)
    for k, (side, (time, speed, stay)) in enumerate(zip(sides, contacts, strict=True)):
        last = k == len(sides) - 1
        after, ahead, _ = contacts[0 if last else k + 1]
        after += periods * 2 * pi / frequency if last else 0
        aim = sides[0] * (-1 if periods < 1 else 1) if last else sides[k + 1]
        wall = mpf(one.walls[side][0])
        x, v = flown(one, side, frequency, time, stay, wall, side * speed)
        found.append(x - wall)
        x, v = flown(one, 0, frequency, time + stay, after - time - stay, wall, v)
        found += [x - mpf(one.walls[aim][0]), aim * v - ahead]
    return found


def solved(function, start):
    """The root near a start, by Newton's method with differences."""
    point = matrix([mpf(each) for each in start])
    for _ in range(20):
        step = mp.lu_solve(differences(function, list(point)), matrix(function(list(point))))
        point -= step
        if mp.norm(step, mp.inf) < mpf(10) ** -30:
            return list(point)
    raise ArithmeticError("Newton's method led to no root")


def differences(function, point):
    """The slopes of a function at a point, rows by rows."""
    columns = []
    for k in range(len(point)):
        ends = [function([each + sign * STEP * (j == k) for j, each in enumerate(point)]) for sign in (1, -1)]
        columns.append([(up - down) / (2 * STEP) for up, down in zip(*ends, strict=True)])
    return matrix(columns).T


@mpmath.workdps(DIGITS)
def grazing(one, sides, frequency, contacts, row, late):
    """The frequency of the grazing from within near some contacts; late: the touch's time since that in a row began."""

    def function(numbers):
        *rest, frequency, late = numbers
        time, speed, _ = triples(rest)[row]
        wall = mpf(one.walls[sides[row]][0])
        x, v = flown(one, sides[row], frequency, time, late, wall, sides[row] * speed)
        return [*residuals(one, sides, frequency, rest), x - wall, v]

    return solved(function, [*(number for each in contacts for number in each), frequency, late])[-2]


@mpmath.workdps(DIGITS + 20)
def fold(one, frequency, phase, speed, duration):
    """The frequency of the saddle-node near an orbit of mirror images, with one contact each; phase: of the drive when
    that with the right wall begins."""

    def function(numbers):
        *contact, frequency = numbers

        def equations(contact):
            return residuals(one, (1,), frequency, contact, mpf(1) / 2)

        return [*equations(contact), mp.det(differences(equations, contact))]

    return solved(function, [mpf(phase) / mpf(frequency), speed, duration, frequency])[-1]


def free_grazing(amplitude, gamma):
    """The higher frequency at which the motion without impacts has the amplitude 1."""
    half = 1 - 2 * mpf(gamma) ** 2
    return sqrt(half + sqrt(half * half - 1 + mpf(amplitude) ** 2))


def triples(numbers):
    return [tuple(numbers[k : k + 3]) for k in range(0, len(numbers), 3)]
