"""Multipliers of a periodic orbit in high precision: Newton's method on its state by `slopes`, then trace and
determinant of the derivative."""

from typing import NamedTuple

from flint import acb, arb, ctx

from . import slopes

ROUNDS = 6


class Impacts(NamedTuple):
    """Times since the start and sides of an orbit's impacts."""

    times: list
    sides: list

    @property
    def count(self):
        """How many there are."""
        return len(self.times)


def orbit(scene, x, v, phase, times, sides, periods):
    """((x, v), multipliers) of the orbit near a state, polished: balls, the larger multiplier first."""
    with ctx.workprec(slopes.PRECISION):
        x, v, impacts = arb(x), arb(v), Impacts([arb(float(each)) for each in times], list(sides))
        for _ in range(ROUNDS):
            draw = (scene, x, v, phase)
            end = slopes.replay(
                slopes.with_numbers(draw, [arb(each) for each in slopes.numbers(draw)]), impacts, periods
            )
            units = [[1.0 if k == j else 0.0 for j in range(len(slopes.names(scene)))] for k in (0, 1)]
            (a, c), (b, d) = (slopes.derivative(draw, impacts, unit, 1, periods)[:2] for unit in units)
            miss = end[0] - x, end[1] - v
            determinant = (1 - a) * (1 - d) - b * c
            x = (x + ((1 - d) * miss[0] + b * miss[1]) / determinant).mid()
            v = (v + (c * miss[0] + (1 - a) * miss[1]) / determinant).mid()
            impacts = Impacts([each.mid() for each in end[2 : 2 + impacts.count]], impacts.sides)
        half = (a + d) / 2
        root = acb((half * half - (a * d - b * c)).mid()).sqrt()
        found = [complex(acb(half.mid()) + root), complex(acb(half.mid()) - root)]
        return (float(x), float(v)), sorted(found, key=lambda each: (-abs(each), -each.imag))
