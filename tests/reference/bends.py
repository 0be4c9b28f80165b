"""How the parameter bends along the branches at an SN, PD or SB, in as many digits as wanted: no normal form is taken.

The others are sought themselves, near the point's orbit: of an SN those at either side along its null vector, of a PD
or SB those whose halves are u + s d and u - s d, as `codim` has them, for s and 2 s. s is so small that what is beyond
s^2 is rounding.
"""

from mpmath import mpf, workdps

from .codim import Orbits, null, slopes
from .special import GUARD, exact, lost, newton, with_value


def bend(scene, name, kind, value, times, speeds, sides, periods, length, digits=30):
    """b of the orbits at value + b s^2, s being the root mean square over the impacts of the changes of time, and of
    speed over a length: an mpf. kind: "SN", "PD" or "SB"; the others as of `special.special`.

    Raises ArithmeticError where Newton's method does not converge.
    """
    other = "damping" if name == "frequency" else "frequency"
    at = with_value(scene, name, float(value))
    with workdps(4 * (digits + GUARD) + lost(at)):
        h, s = mpf(10) ** -(digits + GUARD), mpf(10) ** -8
        count, half = len(sides), kind == "SB"
        own = count // 2 if half else count
        share = mpf(int(periods)) / 2 if half else int(periods)
        orbits = Orbits(exact(scene), (name, other), [int(each) for each in sides[:own]], share, -1 if half else 1)
        q = exact(scene).omega if other == "frequency" else exact(scene).gamma
        u = [mpf(float(each)) for pair in zip(times[:own], speeds[:own], strict=True) for each in pair]
        scale = [1 if k % 2 == 0 else 1 / mpf(float(length)) for k in range(len(u))]
        find = _fold if kind == "SN" else _fork
        found, d = find(orbits, u, mpf(float(value)), q, s, h)
        return found / (sum((a * b) ** 2 for a, b in zip(d, scale, strict=True)) / own)


def _fold(orbits, u, p, q, s, h):
    """(b along a change, that change)."""
    size = len(u)
    *start, p = newton(
        lambda z: [*orbits.equations(z[:-1], z[-1], q), orbits.determinant(z[:-1], z[-1], q)], [*u, p], h
    )
    _, d = null(slopes(lambda u: orbits.equations(u, p, q), start, h))

    def aside(way):
        def system(z):
            along = sum(a * (b - c) for a, b, c in zip(d, z, start, strict=False))
            return [*orbits.equations(z[:size], z[-1], q), along - way * s]

        return newton(system, [*(a + way * s * b for a, b in zip(start, d, strict=True)), p], h)

    one, other = aside(1), aside(-1)
    change = [(a - b) / (2 * s) for a, b in zip(one[:size], other[:size], strict=True)]
    return (one[-1] + other[-1] - 2 * p) / (2 * s**2), change


def _fork(orbits, u, p, q, s, h):
    """(b along a change, that change)."""
    size, none = len(u), [mpf(0)] * len(u)

    def odd(more):
        return [(a - b) / 2 for a, b in zip(*orbits.halves(u, more, p, q), strict=True)]

    _, d = null(slopes(odd, none, h))

    def aside(s):
        def system(z):
            u, v, p = z[:size], z[size : 2 * size], z[-1]
            one, other = orbits.halves(u, [s * each for each in v], p, q)
            both = list(zip(one, other, strict=True))
            even, odd = [(a + b) / 2 for a, b in both], [(a - b) / (2 * s) for a, b in both]
            return [*even, *odd, sum(a * b for a, b in zip(d, v, strict=True)) - 1]

        return newton(system, [*u, *d, p], h)

    near, far = aside(s), aside(2 * s)
    return (far[-1] - near[-1]) / (3 * s**2), near[size : 2 * size]
