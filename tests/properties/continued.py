"""Problems of the continuation package with random numbers, whose branches and special points are known.

The random numbers are arguments of one function for each kind, so that its programs serve all draws. A solution is
u = mix w, where w are coordinates in which it is simple.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

import continuation as co
from continuation.problem import ORBITS, System
from tests.reference import maps
from tests.tiers import generator


@dataclass(frozen=True)
class Case:
    """A branch along the parameter m with its reference values.

    solution: from (w, p) to residuals that vanish on the branch. eigenvalues: from (w, p) to the eigenvalues or
    multipliers. specials: (kind, (*w, m)) in the order of the branch or in reverse. ends: the bounds, 0 or 1, at which
    it ends, sorted. emanating: {kind: (from (w, p) to residuals that vanish on the branches which leave there, their
    special points (kind, m) beside those of the branch itself)}. curves: {kind: (bounds of m and n, from (w, p) to
    residuals, [(kind, (*w, m, n)) of codimension two])}. slope: {kind: from w to dm/dn of the special point}.
    """

    system: System
    w: list
    at: dict
    bounds: tuple
    specials: list
    ends: list
    solution: Callable
    eigenvalues: Callable
    args: Any = None
    emanating: dict = field(default_factory=dict)
    curves: dict = field(default_factory=dict)
    slope: dict = field(default_factory=dict)

    def trace(self, **changes):
        given = {"u": self.unknowns(self.w), "at": self.at, "along": "m", "bounds": self.bounds, "args": self.args}
        return co.trace(self.system, **(given | changes))

    def unknowns(self, w):
        return self.args["mix"] @ w if self.args else np.asarray(w, float)

    def coordinates(self, branch):
        """Return (w, p) of a branch, (unknowns, points) and {name: (points,)}."""
        w = np.linalg.solve(self.args["mix"], branch.u.T) if self.args else branch.u.T
        return w, self.at | branch.p


@dataclass(frozen=True)
class Problem:
    """A kind of problem: its name, and a function from a random generator to a Case."""

    name: str
    make: Callable

    def draw(self, number):
        return self.make(generator(self, number))


def mixed(function):
    """Return a function of (u, p, args) from a function of (w, p, args) to a tuple."""
    return lambda u, p, args: args["mix"] @ jnp.stack(function(args["unmix"] @ u, p, args))


def arguments(rng, size=2, **numbers):
    matrix = np.eye(size) + rng.uniform(-0.3, 0.3, (size, size))
    return {"mix": matrix, "unmix": np.linalg.inv(matrix)} | numbers


def real_roots(coefficients):
    """Return the roots of a polynomial all of whose roots are real, in increasing order."""
    with mpmath.workdps(40):
        roots = mpmath.polyroots([mpmath.mpf(float(each)) for each in coefficients[::-1]], 200, extraprec=200, asc=True)
        return sorted(float(root.real) for root in roots)


@co.equilibria
@mixed
def stretched(w, p, args):
    return p["m"] - jnp.polyval(args["q"], w[0]), w[0] ** 2 - w[1]


def polynomial(rng):
    """Folds at the critical values of a polynomial with one to four critical points, and neutral saddles."""
    count = int(rng.integers(1, 5))
    critical = -1.0 + np.cumsum(rng.uniform(0.4, 0.9, count))
    q = np.polyint(rng.choice([-3.0, 3.0]) * np.poly(critical), k=rng.normal())
    slope, start, right = np.polyder(q), critical[0] - 0.1, int(q[0] > 0)
    folds = [("SN", [x, x * x, np.polyval(q, x)]) for x in real_roots(slope)]
    values = [w[-1] for _, w in folds]
    return Case(
        stretched,
        [start, start**2],
        {"m": np.polyval(q, start)},
        (min(values) - 1.0, max(values) + 1.0),
        folds,
        sorted([right, right if count % 2 else 1 - right]),
        lambda w, p: [p["m"] - np.polyval(q, w[0]), w[0] ** 2 - w[1]],
        lambda w, p: [-np.polyval(slope, w[0]), -1.0 + 0.0 * w[0]],
        arguments(rng, q=np.append(np.zeros(5 - count), q)[-6:]),
    )


@co.equilibria
@mixed
def two_curves(w, p, args):
    return (w[0] - args["s"] * p["m"]) * (p["m"] - args["c"] - args["k"] * w[0] ** 2), w[0] ** 2 - w[1]


def crossing(rng):
    """A line that crosses a parabola at two branch points."""
    s, k, c = rng.uniform(0.4, 1.2), rng.uniform(0.5, 1.5), -rng.uniform(0.3, 1.0)
    low, high = real_roots([s * s * k, -1.0, c])
    bounds = min(low, c) - 0.7, high + 0.7

    def on_parabola(w, p):
        return [p["m"] - c - k * w[0] ** 2, w[1] - w[0] ** 2]

    return Case(
        two_curves,
        [s * bounds[0], (s * bounds[0]) ** 2],
        {"m": bounds[0]},
        bounds,
        [("BP", [s * m, (s * m) ** 2, m]) for m in (low, high)],
        [0, 1],
        lambda w, p: [w[0] - s * p["m"], w[1] - w[0] ** 2],
        lambda w, p: [on_parabola(w, p)[0], -1.0 + 0.0 * w[0]],
        arguments(rng, s=s, k=k, c=c),
        {"BP": (on_parabola, [("SN", c)])},
    )


@co.equilibria
@mixed
def folded(w, p, args):
    x, m, n = w[0] - args["x"], p["m"] - args["m"], p["n"] - args["n"]
    return m + args["k"] * n * x - x**3, w[0] ** 2 - w[1]


def cusp(rng):
    """Two folds, whose curves meet in a cusp."""
    x, m, n, k = *rng.normal(size=3), rng.uniform(0.5, 2.0)
    own = rng.uniform(0.5, 1.5)
    turn = np.sqrt(k * own / 3.0)
    folds = [("SN", [x + s * turn, (x + s * turn) ** 2, m - 2.0 * s * turn**3]) for s in (-1.0, 1.0)]
    start = x - turn - 0.3
    return Case(
        folded,
        [start, start**2],
        {"m": m + (start - x) ** 3 - k * own * (start - x), "n": n + own},
        (m - 8.0, m + 8.0),
        folds,
        [0, 1],
        lambda w, p: [p["m"] - m + k * own * (w[0] - x) - (w[0] - x) ** 3, w[1] - w[0] ** 2],
        lambda w, p: [k * own - 3.0 * (w[0] - x) ** 2, -1.0 + 0.0 * w[0]],
        arguments(rng, x=x, m=m, n=n, k=k),
        curves={
            "SN": (
                ((m - 8.0, m + 8.0), (n - 0.5, n + 3.0)),
                lambda w, p: [27.0 * (p["m"] - m) ** 2 - 4.0 * (k * (p["n"] - n)) ** 3, w[1] - w[0] ** 2],
                [("CP", [x, x * x, m, n])],
            )
        },
        slope={"SN": lambda w: -k * (w[0] - x)},
    )


def bent(w):
    return w[0], w[1] + 0.3 * w[0] ** 2


def unbent(w):
    return w[0], w[1] - 0.3 * w[0] ** 2


@co.equilibria
@mixed
def oscillator(w, p, args):
    """z' = (m + i f) z + n z |z|^2 - z |z|^4 in other coordinates."""
    x, y = unbent(w)
    size = x * x + y * y
    grow = p["m"] + p["n"] * size - size * size
    dx, dy = grow * x - args["f"] * y, grow * y + args["f"] * x
    return dx, dy + 0.6 * x * dx


@co.fixed_points
@mixed
def rotation(w, p, args):
    """z -> exp(i f) (1 + m + n |z|^2) z in other coordinates, and contraction by 1/2 across the plane."""
    x, y = unbent(w)
    size, cos, sin = 1.0 + p["m"] + p["n"] * (x * x + y * y), jnp.cos(args["f"]), jnp.sin(args["f"])
    return *bent((size * (cos * x - sin * y), size * (sin * x + cos * y))), 0.5 * w[2] + x * x


def from_focus(system, kind, codim2, rng, low, high, eigenvalues):
    """Return the case of a focus at w = 0 that loses its stability at m = 0, supercritically for n < 0."""
    f, n, size = rng.uniform(low, high), rng.uniform(0.2, 0.5), 3 if kind == "NS" else 2

    def values(w, p):
        rest = [np.full(len(w[0]), 0.5)] * (size - 2)
        return [eigenvalues(p["m"], f), np.conj(eigenvalues(p["m"], f)), *rest]

    return Case(
        system,
        np.zeros(size),
        {"m": -0.13, "n": n},
        (-0.2, 0.3),
        [(kind, np.zeros(size + 1))],
        [0, 1],
        lambda w, p: w,
        values,
        arguments(rng, size, f=f),
        curves={kind: (((-0.5, 0.5), (-1.0, 1.0)), lambda w, p: [*w, p["m"]], [(codim2, np.zeros(size + 2))])},
        slope={kind: lambda w: 0.0},
    )


def hopf(rng):
    return from_focus(oscillator, "HB", "GH", rng, 0.6, 2.0, lambda m, f: m + 1j * f)


def neimark_sacker(rng):
    return from_focus(rotation, "NS", "CH", rng, 0.5, 1.3, lambda m, f: (1.0 + m) * np.exp(1j * f))


HENON = co.fixed_points(lambda u, p, args: jnp.stack([p["m"] - u[0] ** 2 + p["n"] * u[1], u[0]]))


def henon(rng):
    """With multipliers k and -n / k: folds at m = -(1 - n)^2 / 4, doublings at m = 3 (1 - n)^2 / 4."""
    n = rng.uniform(-0.7, 0.6)
    s = 1.0 - n

    def multipliers(w, p):
        root = np.sqrt(w[0] ** 2 + p["n"] + 0j)
        return [-w[0] + root, -w[0] - root]

    def on_curve(factor):
        return lambda w, p: [p["m"] - factor * (1.0 - p["n"]) ** 2, w[0] - w[1]]

    bounds, last = ((-9.0, 9.0), (-1.8, 1.8)), s * s + 0.25 * (1.0 + n) ** 2
    with mpmath.workdps(40):
        last = float(maps.doubled_cycle(n, [*np.roots([1.0, -s, s * s - last]).real, last])[2])
    return Case(
        HENON,
        [0.0, 0.0],
        {"m": 0.0, "n": n},
        (-3.0, 3.3),
        [("SN", [-0.5 * s, -0.5 * s, -0.25 * s * s]), ("PD", [0.5 * s, 0.5 * s, 0.75 * s * s])],
        [1, 1],
        lambda w, p: [p["m"] - w[0] ** 2 - s * w[0], w[1] - w[0]],
        multipliers,
        None,
        {"PD": (lambda w, p: [w[0] + w[1] - s, w[0] * w[1] - s * s + p["m"]], [("PD", last)])},
        {
            "SN": (bounds, on_curve(-0.25), [("FF", [0.0, 0.0, 0.0, 1.0]), ("R1", [-1.0, -1.0, -1.0, -1.0])]),
            "PD": (bounds, on_curve(0.75), [("FF", [0.0, 0.0, 0.0, 1.0]), ("R2", [1.0, 1.0, 3.0, -1.0])]),
        },
        {"SN": lambda w: 0.5 * s, "PD": lambda w: -1.5 * s},
    )


def exprel(x):
    """(exp(x) - 1) / x, smooth at 0."""
    small = abs(x) < 0.02
    safe = jnp.where(small, 1.0, x)
    series = 1.0 + x / 2 * (1.0 + x / 3 * (1.0 + x / 4 * (1.0 + x / 5 * (1.0 + x / 6))))
    return jnp.where(small, series, jnp.expm1(safe) / safe)


def ring(u, time, speed):
    """(angle at the start, a circle of radius 1 that attracts, the angle at the end)."""
    size, angle = jnp.hypot(u[0], u[1]), jnp.arctan2(u[1], u[0])
    new = 1.0 / jnp.sqrt(1.0 + (1.0 / size**2 - 1.0) * jnp.exp(-2.0 * time))
    after = angle + speed * time
    return angle, new * jnp.stack([jnp.cos(after), jnp.sin(after)]), after


def band(u, time, p, args):
    """About the circle a strip that makes half a turn in a round, along which a' = m a - a^3, b' = -b."""
    before, middle, after = ring(u, time, p["n"])
    (e, n), (f, k) = (
        [jnp.stack([jnp.cos(h), jnp.sin(h)]), jnp.stack([-jnp.sin(h), jnp.cos(h)])] for h in (before / 2, after / 2)
    )
    a, b = u[2:] @ e, u[2:] @ n
    a = a * jnp.exp(p["m"] * time) / jnp.sqrt(1.0 + 2.0 * a * a * time * exprel(2.0 * p["m"] * time))
    return jnp.concatenate([middle, a * f + b * jnp.exp(-time) * k])


def spiral(u, time, p, args):
    """About the circle a spiral, c' = (m + i n) c."""
    middle = ring(u, time, 1.0)[1]
    cos, sin = jnp.cos(p["n"] * time), jnp.sin(p["n"] * time)
    return jnp.concatenate([middle, jnp.exp(p["m"] * time) * jnp.array([[cos, -sin], [sin, cos]]) @ u[2:]])


def flown(fly, segments):
    """Return the system of periodic orbits of a flow in closed form."""

    def field(u, p, args):
        return jax.jvp(lambda time: fly(u, time, p, args), (0.0,), (1.0,))[1]

    return System(field, ORBITS, 1, fly, segments)


FLOWN = {band: flown(band, 3), spiral: flown(spiral, 1)}


def circle(segments, speed=1.0):
    angles = 2.0 * np.pi * np.arange(segments) / segments
    points = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles, 0.0 * angles], 1)
    return np.append(points.reshape(-1), 2.0 * np.pi / speed)


def orbit_on_circle(fly, at, bounds, kind, multipliers, **more):
    period = 2.0 * np.pi / (at["n"] if fly is band else 1.0)
    start = circle(FLOWN[fly].segments, 2.0 * np.pi / period)

    def solution(w, p):
        return [*(w[2 + k] for k in range(0, len(w) - 1, 4)), w[-1] - period, np.hypot(w[0], w[1]) - 1.0]

    special = [(kind, [*start, 0.0])]
    return Case(FLOWN[fly], start, at, bounds, special, [0, 1], solution, multipliers, **more)


def doubling_orbit(rng):
    """An orbit that doubles its period at m = 0."""
    n = rng.uniform(1.2, 2.0)
    period = 2.0 * np.pi / n

    def multipliers(w, p):
        one = np.ones(len(w[0]))
        return [-np.exp(period * p["m"]), -np.exp(-period) * one, np.exp(-2.0 * period) * one]

    def on_double(w, p):
        return [w[-1] - 2.0 * period, w[2] ** 2 + w[3] ** 2 - p["m"]]

    at = {"m": -0.17, "n": n}
    return orbit_on_circle(band, at, (-0.3, 0.3), "PD", multipliers, emanating={"PD": (on_double, [])})


def neimark_sacker_orbit(rng):
    """An orbit from which a torus leaves at m = 0."""
    n = rng.uniform(0.26, 0.32)

    def multipliers(w, p):
        turn = np.exp(2.0 * np.pi * (p["m"] + 1j * n))
        return [turn, np.conj(turn), np.exp(-4.0 * np.pi) + 0.0 * p["m"]]

    resonances = [("R3", [*circle(1), 0.0, 1.0 / 3.0]), ("R4", [*circle(1), 0.0, 0.25])]
    curves = {"NS": (((-1.0, 1.0), (0.2, 0.4)), lambda w, p: [p["m"]], resonances)}
    at = {"m": -0.13, "n": n}
    return orbit_on_circle(spiral, at, (-0.2, 0.2), "NS", multipliers, curves=curves)


PROBLEMS = {
    make.__name__: Problem(make.__name__, make)
    for make in (polynomial, crossing, cusp, hopf, neimark_sacker, henon, doubling_orbit, neimark_sacker_orbit)
}
