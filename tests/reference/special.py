"""Special points of branches of periodic orbits, in as many digits as wanted: a branch follower is held against them.

The unknowns are y = (t_0, u_0, ..., t_(m-1), u_(m-1), p): times and speeds of the impacts, and the scene's parameter.
F(y) = 0 says that the flight from each impact meets the next one, the last one the first n periods later: 2 m rows.
Nothing is divided by a speed, so F is smooth where an impact grazes, and each kind of point is a regular root:

- GR: F = 0 and u_k = 0; or F = 0 and a flight that turns back, as seen from a wall, on that wall.
- SN, PD: F = 0 and det(M - I) = 0 or det(M + I) = 0, times all speeds, as M has a pole where one of them is zero.
- SB, BP: det(M - I) = 0 there too, but branches cross: dF/dy has lost its rank, and Newton's method would fail. Give F
  one more number, F + mu b = 0, and y has a surface to lie on, both branches with it; on them mu is zero, so on the
  surface it is stationary where they cross. With multipliers psi, psi dF/dy = 0 and psi b = 1, that is a regular root,
  and mu = 0 at it says that they do cross.

Derivatives are differences over h = 10^-(digits + 10) at three times as many digits: good to h, at resonance too, where
the closed form of the drive's response loses that many. M is a product of flights and rebounds, apart from dF/dy.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from mpmath import ceil, cos, exp, eye, fabs, log10, matrix, mp, mpf, pi, sin, sqrt, workdps

from .scene import Scene

GUARD = 10  # digits beyond those asked for
ROUNDS = 20  # of Newton's method
SHARP = 1e-9  # a step so much shorter than the one before: the Jacobian may stay
FAR = 1e6  # a step with which there is no hope
ASTRAY = 1e-3  # of 1 + |value|: farther away than that lies another point
FIELDS = {"frequency": "omega", "damping": "gamma"}


class Place(NamedTuple):
    """Position, velocity and acceleration of a wall."""

    x: mpf
    v: mpf
    a: mpf


class Branch(NamedTuple):
    """What is the same all along a branch; the methods take y."""

    scene: Scene
    name: str
    sides: list
    periods: int

    def at(self, y):
        """The scene at y."""
        return with_value(self.scene, self.name, y[-1])

    def next(self, k, y):
        """The impact after impact k, and its time."""
        after = (k + 1) % len(self.sides)
        return after, y[2 * after] + (span(self.at(y), self.periods) if after == 0 else 0)

    def departure(self, k, y):
        """Time and state just after impact k."""
        scene, side, t = self.at(y), self.sides[k], y[2 * k]
        wall = place(scene, side, t)
        return t, wall.x, wall.v - side * restitution(scene, side) * y[2 * k + 1]

    def misses(self, k, y):
        """The two rows of F for the flight from impact k."""
        scene, (after, t) = self.at(y), self.next(k, y)
        x, v = fly(scene, *self.departure(k, y), t)
        wall = place(scene, self.sides[after], t)
        return x - wall.x, v - wall.v - self.sides[after] * y[2 * after + 1]

    def equations(self, y):
        """F."""
        return [each for k in range(len(self.sides)) for each in self.misses(k, y)]

    def jacobian(self, y, h):
        """dF/dy by differences: a row depends on two impacts only."""
        count = len(self.sides)
        rows = matrix(2 * count, len(y))
        for k in range(count):
            after, here = (k + 1) % count, self.misses(k, y)
            for j in {2 * k, 2 * k + 1, 2 * after, 2 * after + 1, len(y) - 1}:
                there = self.misses(k, moved(y, j, h))
                rows[2 * k, j], rows[2 * k + 1, j] = ((b - a) / h for a, b in zip(here, there, strict=True))
        return rows

    def determinant(self, y, sign):
        """det(M - sign I) times the speeds of all impacts."""
        scene, product, shrink, speeds = self.at(y), eye(2), mpf(1), mpf(1)
        for k, side in enumerate(self.sides):
            flight = free(scene.gamma, self.next(k, y)[1] - y[2 * k])
            product = flight * rebound(scene, side, y[2 * k], y[2 * k + 1]) * product
            shrink, speeds = shrink * restitution(scene, side) ** 2, speeds * y[2 * k + 1]
        shrink *= exp(-2 * scene.gamma * span(scene, self.periods))  # det M
        return speeds * (1 + shrink) - sign * (product[0, 0] + product[1, 1])


def special(scene, name, kind, value, times, speeds, sides, periods, touch=None, digits=50):
    """The exact value of the parameter `name`, as an mpf, at a special point given approximately.

    scene: a `Scene` of floats or mpfs. name: dotted, as in jaxvibro; "restitution" is that of both walls. kind: "SN",
    "SB", "BP", "PD" or "GR". value: the parameter to about 1e-6. times (since drive phase 0, rising), speeds (before
    impact, |v - wall's|) and sides (-1 left, 1 right): the orbit's impacts, about. periods: the drive periods it takes.
    touch: (k, time, side) of a GR where the flight after impact k, or the forced response without impacts, touches a
    wall; without it the slowest impact grazes.

    SB and BP are one to it. Whether the orbit passes through a wall on its way is for the caller to see.
    Raises ArithmeticError where Newton's method does not converge, goes elsewhere, or no branches cross (SB, BP).
    """
    value = float(value)
    with workdps(3 * (digits + GUARD) + lost(with_value(scene, name, value))):
        h = mpf(10) ** -(digits + GUARD)
        branch = Branch(exact(scene), name, [int(side) for side in sides], int(periods))
        y = [mpf(float(each)) for pair in zip(times, speeds, strict=True) for each in pair] + [mpf(value)]
        system, start = build(branch, kind, y, touch, h)
        found = newton(system, start, h)
        parameter = found[len(y) - 1]
        if fabs(parameter - value) > ASTRAY * (1 + abs(value)):
            raise ArithmeticError(f"{kind} not near {name} = {value} but {mp.nstr(parameter, 15)}")
        if kind in ("SB", "BP") and fabs(found[-1]) > sqrt(h):
            raise ArithmeticError(f"no branches cross near {name} = {value}: mu = {mp.nstr(found[-1], 5)}")
        return parameter


def orbit(scene, name, value, times, speeds, sides, periods, digits=50):
    """The (time, speed) of each impact, as mpfs, of the periodic orbit at exactly a value, given approximately.

    The rest as in `special`. Raises ArithmeticError where Newton's method does not converge.
    """
    with workdps(3 * (digits + GUARD) + lost(with_value(scene, name, float(value)))):
        h = mpf(10) ** -(digits + GUARD)
        branch = Branch(exact(scene), name, [int(side) for side in sides], int(periods))
        y = [mpf(float(each)) for pair in zip(times, speeds, strict=True) for each in pair]
        found = newton(lambda z: branch.equations([*z, mpf(float(value))]), y, h)
        return list(zip(found[::2], found[1::2], strict=True))


def build(branch, kind, y, touch, h):
    """(equations, first guess) of a kind of special point; the guess begins with y."""
    if kind == "GR" and touch:
        return touching(branch, y, touch)
    if not branch.sides:
        raise ValueError(f"an orbit without impacts has no {kind} without a touch")
    if kind == "GR":
        slowest = min(range(len(branch.sides)), key=lambda k: fabs(y[2 * k + 1]))
        return lambda z: [*branch.equations(z), z[2 * slowest + 1]], y
    if kind in ("SN", "PD"):
        sign = 1 if kind == "SN" else -1
        return lambda z: [*branch.equations(z), branch.determinant(z, sign)], y
    if kind in ("SB", "BP"):
        return crossing(branch, y, h)
    raise ValueError(f"unknown kind {kind!r}")


def touching(branch, y, touch):
    """A flight, or the forced response, turns back on a wall; one unknown more, its time."""
    k, time, side = touch[0], mpf(float(touch[1])), touch[2]
    if branch.sides:
        time = y[2 * k] + (time - y[2 * k]) % span(branch.at(y), branch.periods)

    def system(z):
        scene, (*front, t) = branch.at(z[:-1]), z
        x, v = fly(scene, *branch.departure(k, front), t) if branch.sides else forced(scene, t)
        wall = place(scene, side, t)
        return [*branch.equations(front), x - wall.x, v - wall.v]

    return system, [*y, time]


def crossing(branch, y, h):
    """mu is stationary; unknowns more are psi and, the last, mu."""
    size = len(y) - 1
    psi = np.linalg.svd(np.array(branch.jacobian(y, h).tolist(), dtype=float))[0][:, -1]
    b = [mpf(float(each)) for each in psi]  # dF/dy does not reach it, or hardly

    @cache
    def seen(front):
        return branch.equations(front), branch.jacobian(front, h)

    def system(z):
        (values, slopes), psi, mu = seen(tuple(z[: size + 1])), z[size + 1 : -1], z[-1]
        rows = [f + mu * each for f, each in zip(values, b, strict=True)]
        return [*rows, *(matrix([psi]) * slopes), sum(p * each for p, each in zip(psi, b, strict=True)) - 1]

    return system, [*y, *b, mpf(0)]


def newton(system, z, h):
    """A root of a system near z, to about h; the Jacobian is renewed until its steps shrink fast."""
    last, inverse = mpf("inf"), None
    for _ in range(ROUNDS):
        here = system(z)
        if inverse is None:
            columns = [(matrix(system(moved(z, j, h))) - matrix(here)) / h for j in range(len(z))]
            inverse = matrix([list(column) for column in columns]).T ** -1
        step = inverse * matrix(here)
        z, size = [a - b for a, b in zip(z, step, strict=True)], max(fabs(each) for each in step)
        if size < h * (1 + max(fabs(each) for each in z)):
            return z
        if size > FAR:
            break
        if size > SHARP * last:
            inverse = None
        last = size
    raise ArithmeticError(f"no convergence: the last step is {mp.nstr(size, 5)}")


def moved(y, j, h):
    """y with h added to its j-th number."""
    return [each + h if i == j else each for i, each in enumerate(y)]


def exact(record):
    """A record of floats as one of mpfs of the same value."""
    numbers = (exact(each) if isinstance(each, tuple) else None if each is None else mpf(each) for each in record)
    return record._make(numbers) if hasattr(record, "_make") else tuple(numbers)


def with_value(record, name, value):
    """A record with the number under a dotted name replaced."""
    if name == "restitution" and isinstance(record, Scene):
        return record._replace(
            **{("left", "right")[side > 0]: w._replace(restitution=value) for side, w in record.walls()}
        )
    head, _, rest = name.partition(".")
    head = FIELDS.get(head, head)
    return record._replace(**{head: with_value(getattr(record, head), rest, value) if rest else value})


def lost(scene):
    """Digits that the closed form of the forced response loses near resonance."""
    with workdps(40):
        gamma, omega = mpf(scene.gamma), mpf(scene.omega)
        size = fabs(1 - omega**2) + fabs(2 * gamma * omega)
        return max(0, int(ceil(-log10(size)))) if size else 0


def span(scene, periods):
    """Time of so many drive periods."""
    return 2 * pi * periods / scene.omega


def restitution(scene, side):
    """R of a wall."""
    return (scene.right if side > 0 else scene.left).restitution


def place(scene, side, t):
    """A wall at time t."""
    wall = scene.right if side > 0 else scene.left
    if wall.motion is None:
        return Place(wall.position, mpf(0), mpf(0))
    rate = wall.motion.harmonic * scene.omega
    angle = rate * t + wall.motion.phase
    out = wall.motion.amplitude * cos(angle)
    return Place(wall.position + out, -wall.motion.amplitude * rate * sin(angle), -(rate**2) * out)


def forced(scene, t):
    """State at time t of the motion that the drive alone makes: periodic, or growing at resonance without damping."""
    gamma, omega, angle = scene.gamma, scene.omega, scene.omega * t
    c, s = cos(angle), sin(angle)
    stiff, drag = 1 - omega**2, 2 * gamma * omega
    d = stiff**2 + drag**2
    if d == 0:
        return scene.amplitude * t * s / 2, scene.amplitude * (s + t * c) / 2  # omega = 1
    inphase, behind = scene.amplitude * stiff / d, scene.amplitude * drag / d
    return inphase * c + behind * s, omega * (behind * c - inphase * s)


def free(gamma, t):
    """Flow matrix of x'' + 2 gamma x' + x = 0 over t; below, at and above gamma = 1, its root real or imaginary."""
    root = sqrt(1 - gamma**2)
    c, s = (cos(root * t).real, (sin(root * t) / root).real) if root else (mpf(1), t)
    decay = exp(-gamma * t)
    return decay * matrix([[c + gamma * s, s], [-s, c - gamma * s]])


def fly(scene, start, x, v, end):
    """State at time `end` of a flight that has (x, v) at time `start`."""
    (p, q), (x_forced, v_forced) = forced(scene, start), forced(scene, end)
    e = free(scene.gamma, end - start)
    return x_forced + e[0, 0] * (x - p) + e[0, 1] * (v - q), v_forced + e[1, 0] * (x - p) + e[1, 1] * (v - q)


def rebound(scene, side, t, u):
    """Speed u of an impact times the derivative of the state after it by the state before.

    A state that is dx ahead comes dt = -dx / (v - wall's) late. So dx turns into -R dx, and dv into -R dv less what
    the accelerations add in dt: those before (times R) and after, and the wall's times 1 + R the other way.
    """
    wall, r = place(scene, side, t), restitution(scene, side)
    pull = scene.amplitude * cos(scene.omega * t) - wall.x
    before, after = (pull - 2 * scene.gamma * (wall.v + factor * side * u) for factor in (1, -r))
    return matrix([[-r * u, 0], [side * (after + r * before - (1 + r) * wall.a), -r * u]])
