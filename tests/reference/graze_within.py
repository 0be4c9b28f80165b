"""Orbits that touch soft walls at rest, a contact each, in mpmath to 34 digits: nothing is shared with the package.

Unknowns are, of each contact, when it begins, how fast, and how long it lasts; the motion free and within a wall is the
textbook's closed form. A grazing from within adds the frequency, and the time within one contact at which the mass is
at its wall without speed, but for what is past it.
"""

from typing import NamedTuple

from mpmath import cos, exp, matrix, mp, mpc, mpf, pi, sin, sqrt

DIGITS = 40


class Oscillator(NamedTuple):
    """x'' + 2 gamma x' + x = amplitude cos(frequency t); walls: {side: (position, stiffness, damping)}, soft."""

    amplitude: float
    gamma: float
    walls: dict


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


def left(one, sides, periods, frequency, contacts):
    """What is left of the equations: of each contact that it ends at its wall, and that the flight from there ends at
    the next, with its speed. contacts: (time, speed, stay) of each."""
    found = []
    for k, (side, (time, speed, stay)) in enumerate(zip(sides, contacts, strict=True)):
        last = k == len(sides) - 1
        after, ahead, _ = contacts[0 if last else k + 1]
        ahead, after = (ahead, after + (periods * 2 * pi / frequency if last else 0))
        wall, aim = mpf(one.walls[side][0]), sides[0 if last else k + 1]
        x, v = flown(one, side, frequency, time, stay, wall, side * speed)
        found.append(x - wall)
        x, v = flown(one, 0, frequency, time + stay, after - time - stay, wall, v)
        found += [x - mpf(one.walls[aim][0]), aim * v - ahead]
    return found


def solved(function, start):
    """The root near a start, by Newton's method with differences."""
    mp.dps = DIGITS
    point = matrix([mpf(each) for each in start])
    for _ in range(20):
        value = matrix(function(list(point)))
        slopes = differences(function, list(point))
        step = mp.lu_solve(slopes, value)
        point -= step
        if mp.norm(step, mp.inf) < mpf(10) ** -34:
            return list(point)
    raise ArithmeticError("Newton's method led to no root")


def differences(function, point):
    """The slopes of a function at a point."""
    small, size = mpf(10) ** -20, len(point)
    found = matrix(size, size)
    for k in range(size):
        ends = []
        for sign in (1, -1):
            moved = list(point)
            moved[k] += sign * small
            ends.append(function(moved))
        for row, (up, down) in enumerate(zip(*ends, strict=True)):
            found[row, k] = (up - down) / (2 * small)
    return found


def orbit(one, sides, periods, frequency, contacts):
    """The contacts (time, speed, stay) of the orbit near some."""
    start = [number for each in contacts for number in each]

    def function(numbers):
        return left(one, sides, periods, mpf(frequency), triples(numbers))

    return triples(solved(function, start))


def grazing(one, sides, periods, frequency, contacts, row, late):
    """(frequency, contacts, the touch's time since the contact in a row began) of the grazing from within near some."""
    start = [number for each in contacts for number in each] + [frequency, late]

    def function(numbers):
        *rest, frequency, late = numbers
        given = triples(rest)
        time, speed, _ = given[row]
        side = sides[row]
        x, v = flown(one, side, frequency, time, late, mpf(one.walls[side][0]), side * speed)
        return [*left(one, sides, periods, frequency, given), x - mpf(one.walls[side][0]), v]

    *rest, frequency, late = solved(function, start)
    return frequency, triples(rest), late


def triples(numbers):
    return [tuple(numbers[k : k + 3]) for k in range(0, len(numbers), 3)]
