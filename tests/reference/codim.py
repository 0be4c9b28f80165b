"""Points of codimension two, in as many digits as wanted: loci of special points are held against them.

The unknowns begin with u = (t_0, u_0, ..., t_(m-1), u_(m-1)), times and speeds of the impacts of an orbit, or of half
a symmetric orbit, whose other half is the mirror image; both parameters p and q come last. F(u, p, q) = 0 are the rows
of `special`, of the flights from these impacts. Each kind of point is a regular root:

- GR, RG: F = 0, the slowest impact has no speed, and det(M - I) times the speeds is 0. Where a speed is 0 this is minus
  the trace of M times the speeds, and det(M + I) times the speeds is plus that: SN and PD come there together.
- GR where a flight touches a wall: det(M - I) = 0, or det(M + I) = 0, and the flight turns back on the wall.
- CP: F = 0, G = det(M - I) times the speeds = 0, and G is stationary along the null vector of dF/du.
- GPD, DSB: no normal form is taken. The doubled orbits, or the asymmetric ones, are (u + s d, u - s d), each half of
  it; with F split into its even part and its odd part over s, u and d are smooth in s^2. At the point, orbits of s and
  2 s lie at the same parameters, to the first order in s^2: the fold of that branch has come onto the PD or SB. s is
  10^-(digits / 2 + 5), and the differences of both orbits over s^2 are unknowns, so nothing is nearly singular.
"""

from typing import NamedTuple

import numpy as np
from mpmath import eye, fabs, matrix, mpf, workdps

from .scene import Scene
from .special import (
    GUARD,
    Branch,
    exact,
    fly,
    free,
    lost,
    moved,
    newton,
    place,
    rebound,
    restitution,
    span,
    with_value,
)

FAR = 1e-3  # of 1 + |value|: another point


class Orbits(NamedTuple):
    """Orbits of two parameters: sides and drive periods of the first half; turn: -1 if the other mirrors it, else 1."""

    scene: Scene
    names: tuple[str, str]
    sides: list
    periods: int | mpf
    turn: int

    def branch(self, q):
        """The whole orbit, both halves, along the first parameter."""
        scene = with_value(self.scene, self.names[1], q)
        return Branch(scene, self.names[0], [*self.sides, *(self.turn * side for side in self.sides)], 2 * self.periods)

    def whole(self, u, more, p, q):
        """y of the orbit whose halves are u + more and u - more."""
        late = span(with_value(with_value(self.scene, self.names[1], q), self.names[0], p), self.periods)
        first = [a + b for a, b in zip(u, more, strict=True)]
        other = [a - b + (late if k % 2 == 0 else 0) for k, (a, b) in enumerate(zip(u, more, strict=True))]
        return [*first, *other, p]

    def halves(self, u, more, p, q):
        """The rows of F of the first half, and of the other half turned."""
        branch, y, count = self.branch(q), self.whole(u, more, p, q), len(self.sides)
        rows = [each for k in range(2 * count) for each in branch.misses(k, y)]
        return rows[: 2 * count], [self.turn * each for each in rows[2 * count :]]

    def equations(self, u, p, q):
        """F."""
        return self.halves(u, [mpf(0)] * len(u), p, q)[0]

    def determinant(self, u, p, q, closing=1):
        """det(M - closing I) times the speeds, M being that of the half."""
        branch, y = self.branch(q), self.whole(u, [mpf(0)] * len(u), p, q)
        scene, product, speeds, shrink = branch.at(y), mpf(self.turn) * eye(2), mpf(1), mpf(1)
        for k, side in enumerate(self.sides):
            flight = free(scene.gamma, branch.next(k, y)[1] - y[2 * k])
            step = rebound(scene, side, y[2 * k], y[2 * k + 1])
            product, speeds = flight * step * product, speeds * y[2 * k + 1]
            shrink *= restitution(scene, side) ** 2 * (flight[0, 0] * flight[1, 1] - flight[0, 1] * flight[1, 0])
        return speeds * (1 + shrink) - closing * (product[0, 0] + product[1, 1])


def codim(scene, names, kind, values, times, speeds, sides, periods, half=False, touch=None, digits=40):
    """The exact values of two parameters, as mpfs, at a point of codimension two given approximately.

    kind: "GR" or "RG" (an SN, PD or SB ends where an impact has no speed), "CP", "GPD" or "DSB". half: whether the
    orbit is symmetric and stays so; a DSB has it true. touch: (k, time, side, "SN" or "PD") of a GR where the flight
    after impact k touches a wall. The others: as of `special`, a pair in place of one parameter.
    Raises ArithmeticError where Newton's method does not converge or goes elsewhere.
    """
    values = [float(each) for each in values]
    at = with_value(with_value(scene, names[0], values[0]), names[1], values[1])
    with workdps(4 * (digits + GUARD) + lost(at)):
        h = mpf(10) ** -(digits + GUARD)
        count, half = len(sides), half or kind == "DSB"
        own = count // 2 if half else count
        orbits = Orbits(
            exact(scene),
            tuple(names),
            [int(side) for side in sides[:own]],
            mpf(int(periods)) / 2 if half else int(periods),
            -1 if half else 1,
        )
        u = [mpf(float(each)) for pair in zip(times[:own], speeds[:own], strict=True) for each in pair]
        build = {"GR": grazing, "RG": grazing, "CP": cusp, "GPD": flat, "DSB": flat}[kind]
        near = [mpf(each) for each in values]
        system, start = touching(orbits, u, near, touch) if touch else build(orbits, u, near, h)
        found = newton(system, start, h)[-2:]
        if any(fabs(a - b) > FAR * (1 + abs(b)) for a, b in zip(found, values, strict=True)):
            raise ArithmeticError(f"no {kind} near {values} but at {[float(each) for each in found]}")
        return tuple(found)


def grazing(orbits, u, values, h):
    """(equations, first guess): an impact without speed, and a trace of zero."""
    slowest = min(range(len(u) // 2), key=lambda k: fabs(u[2 * k + 1]))

    def system(z):
        *u, p, q = z
        return [*orbits.equations(u, p, q), u[2 * slowest + 1], orbits.determinant(u, p, q)]

    return system, [*u, *values]


def touching(orbits, u, values, touch):
    """(equations, first guess): an SN or a PD, and a flight that turns back on a wall at a time that is unknown too."""
    k, time, side, kind = touch
    closing = -1 if kind == "PD" else 1

    def system(z):
        *u, t, p, q = z
        branch, y = orbits.branch(q), orbits.whole(u, [mpf(0)] * len(u), p, q)
        x, v = fly(branch.at(y), *branch.departure(k, y), t)
        wall = place(branch.at(y), side, t)
        return [*orbits.equations(u, p, q), orbits.determinant(u, p, q, closing), x - wall.x, v - wall.v]

    return system, [*u, mpf(float(time)), *values]


def cusp(orbits, u, values, h):
    """(equations, first guess): a fold that is stationary along its null vector."""
    left, right = null(slopes(lambda u: orbits.equations(u, *values), u, h))
    border = matrix([*(mpf(0) for _ in u), mpf(1)])

    def system(z):
        *u, p, q = z
        rows, size = slopes(lambda u: orbits.equations(u, p, q), u, h), len(u)
        bordered = matrix(size + 1, size + 1)
        for i in range(size):
            bordered[i, size], bordered[size, i] = left[i], right[i]
            for j in range(size):
                bordered[i, j] = rows[i, j]
        v = (bordered**-1) * border
        here = orbits.determinant(u, p, q)
        ahead = orbits.determinant([a + h * b for a, b in zip(u, list(v)[:size], strict=True)], p, q)
        return [*orbits.equations(u, p, q), here, (ahead - here) / h]

    return system, [*u, *values]


def flat(orbits, u, values, h):
    """(equations, first guess): orbits of s and 2 s at the same parameters."""
    size, s = len(u), mpf(10) ** -(GUARD // 2) * h ** mpf(0.5)
    none = [mpf(0)] * size

    def odd(more):
        return [(a - b) / 2 for a, b in zip(*orbits.halves(u, more, *values), strict=True)]

    _, d = null(slopes(odd, none, h))

    def parts(u, d, s, p, q):
        one, other = orbits.halves(u, [s * each for each in d], p, q)
        both = list(zip(one, other, strict=True))
        return [(a + b) / 2 for a, b in both] + [(a - b) / (2 * s) for a, b in both]

    def system(z):
        u, v, more_u, more_v = (z[k * size : (k + 1) * size] for k in range(4))
        p, q = z[-2:]
        here = parts(u, v, s, p, q)
        far = [[a + s * s * b for a, b in zip(*each, strict=True)] for each in ((u, more_u), (v, more_v))]
        there = parts(*far, 2 * s, p, q)
        change = [(b - a) / s**2 for a, b in zip(here, there, strict=True)]
        ends = [sum(a * b for a, b in zip(d, each, strict=True)) for each in (v, more_v)]
        return [*here, *change, ends[0] - 1, ends[1]]

    return system, [*u, *d, *none, *none, *values]


def slopes(function, u, h):
    """Derivative by differences."""
    here = matrix(function(u))
    columns = [list((matrix(function(moved(u, j, h))) - here) / h) for j in range(len(u))]
    return matrix(columns).T


def null(rows):
    """Left and right null vectors of a matrix, about, as mpfs of length 1."""
    left, _, right = np.linalg.svd(np.array(rows.tolist(), dtype=float))
    return [mpf(float(each)) for each in left[:, -1]], [mpf(float(each)) for each in right[-1]]
