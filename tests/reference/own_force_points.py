"""Special points of impact oscillators under forces that are no spring: their equations by the map of a period, in as
many digits as mpmath is set to; derivatives by differences in these. Walls with a contact law have equal numbers, those
of the left one."""

from dataclasses import dataclass, replace

from mpmath import mp, mpf

from . import own_force

APART = mpf(10) ** -11  # of states, for the map's derivative: right to 22 digits
STEP = mpf(10) ** -8  # of unknowns and numbers, for derivatives of equations: right to 13
SHALLOW = mpf(10) ** -5  # no impact where the mass turns back so little behind a wall
DIGITS = 30


@dataclass(frozen=True)
class Case:
    """A special point of an orbit.

    kind: "SN", "PD", "SB", "GR", "NS" or "NSA" (multipliers of product 1); force: its name; numbers: {name: value} of
    the scene, by its own names; name: of the parameter; touch: of a GR the place of the touch among the orbit's turning
    points by the walls.
    """

    kind: str
    force: str
    numbers: dict
    name: str
    periods: int
    touch: int | None = None

    def flown(self, x, v, value, periods, moved=()):
        """Over so many periods, of the parameter at a value; moved: numbers moved by so much, (name, change)."""
        numbers = self.numbers | {self.name: value}
        for name, change in moved:
            numbers[name] = mpf(numbers[name]) + change
        own = {name.removeprefix("force."): each for name, each in numbers.items() if name.startswith("force.")}
        walls, bounces = [], []
        for side in ("left", "right"):
            walls.append(numbers.get(f"{side}.position"))
            bounces.append(numbers.get(f"{side}.restitution", 0))
        push = [numbers.get(f"left.law.{name}", 0) for name in ("stiffness", "dissipation")]
        given = numbers["amplitude"], numbers["frequency"], tuple(walls), tuple(bounces)
        more = {"shallow": SHALLOW, "push": push if push[0] else None}
        return own_force.flown(own_force.FORCES[self.force], own, *given, x, v, periods, **more)

    def equations(self, unknowns, moved=()):
        """What is 0 at the point: of x, v and the parameter's value."""
        x, v, value = unknowns
        sign = -1 if self.kind == "SB" else 1  # a symmetric orbit is turned about by half of its time
        time = mpf(self.periods) / 2 if self.kind == "SB" else self.periods

        def end(x, v):
            flight = self.flown(x, v, value, time, moved)
            return [sign * each for each in flight.end], flight

        (a, b), flight = end(x, v)
        found = [a - x, b - v]
        if self.kind == "GR":
            return [*found, by_walls(flight)[self.touch][2]]
        rows = [end(x + APART, v)[0], end(x - APART, v)[0], end(x, v + APART)[0], end(x, v - APART)[0]]
        (a, c), (b, d) = ([(p - q) / (2 * APART) for p, q in zip(*pair, strict=True)] for pair in (rows[:2], rows[2:]))
        if self.kind in ("NS", "NSA"):
            return [*found, a * d - b * c - 1]
        eigen = 1 if self.kind == "SN" else -1
        return [*found, 1 - eigen * (a + d) + a * d - b * c]

    def slopes(self, unknowns):
        """The Jacobian by the unknowns, those that are looked for."""
        columns = [self.change(unknowns, lambda sign, k=k: (moved(unknowns, k, sign * STEP), ())) for k in range(3)]
        return mp.matrix(columns).T

    def change(self, unknowns, at):
        """The derivative of the equations along a way."""
        ends = [self.equations(*at(sign)) for sign in (1, -1)]
        return [(a - b) / (2 * STEP) for a, b in zip(*ends, strict=True)]

    def gradient(self, unknowns, ways):
        """{name: the derivative of the parameter's value} along ways {name: [(number, weight)]}, and the value's change
        in a Newton step as "value"."""
        slopes = self.slopes(unknowns)
        found = {"value": mp.lu_solve(slopes, mp.matrix(self.equations(unknowns)))[2]}
        for name, way in ways.items():

            def at(sign, way=way):
                return unknowns, [(each, sign * weight * STEP) for each, weight in way]

            found[name] = -mp.lu_solve(slopes, mp.matrix(self.change(unknowns, at)))[2]
        return found


def by_walls(flight):
    """Its turning points, those towards the left wall first."""
    return sorted(flight.turns, key=lambda one: (one[1], one[0]))


def touching(case, x, v, value):
    """The `Case` of a GR with the touch that is nearest to a wall."""
    turns = by_walls(case.flown(x, v, value, case.periods))
    touch = min(range(len(turns)), key=lambda k: abs(turns[k][2]))
    return replace(case, touch=touch)


def moved(values, place, change):
    return [each + (change if k == place else 0) for k, each in enumerate(values)]
