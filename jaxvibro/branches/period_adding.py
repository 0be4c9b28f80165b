"""Period adding beyond a grazing, found: `period_adding`."""

from dataclasses import dataclass, field

import numpy as np

from continuation.limits import limits_of, partial_reason

from ..orbits.orbit import Orbit
from ..output.table_text import columns
from ..problem.one_impact import next_touch, one_impact_orbits
from ..problem.orbit_on_branch import described_orbit
from ..problem.square_root_map import SquareRootMap
from ..scene import check
from ..scene.scale import scene_length
from ..scene.scene import SIDES
from .branch import Special
from .scenario import GRADUAL, LONGEST, Scenario, checked_longest, returned, scenario_of

FIRST = 2  # returns: with one impact in each there is no other to be met


@dataclass(frozen=True)
class PeriodicWindow:
    """The orbits with one impact besides in n returns, as `period_adding` found them.

    returns: n; predicted: the parameter's value where they touch the wall once more, by the square-root map; found:
    where they touch a wall first, nan where that was not found; wall: which, "left" or "right", "" where none; ratio:
    how far the place found for n - 1 is from the grazing, over how far this one is; orbit: one of them, halfway from
    where they become stable to the touch; None where none was found.
    """

    returns: int
    predicted: float
    found: float
    wall: str
    ratio: float
    orbit: Orbit | None = field(repr=False)


@dataclass(frozen=True, eq=False)
class PeriodAdding:
    """What was found beyond a grazing. scenario: what its signs say; windows: a `PeriodicWindow` for each n from 2
    on; stopped: why there are fewer than were asked for, else ""."""

    scenario: Scenario
    windows: tuple[PeriodicWindow, ...]
    stopped: str = ""

    def table(self) -> str:
        """The places predicted and found, and how far from the grazing, as a text, a line for each n."""
        value = self.scenario.special.value
        rows: list[tuple[object, ...]] = [
            ("returns", "orbit", "predicted", "found", "predicted away", "found away", "ratio")
        ]
        for one in self.windows:
            told = [f"{one.predicted:.12g}", f"{one.found:.12g}"]
            told += [f"{each:.6g}" for each in (one.predicted - value, one.found - value, one.ratio)]
            rows.append((one.returns, one.orbit.label if one.orbit else "-", *(_or_dash(each) for each in told)))
        tends = f"the ratio tends to {self.scenario.ratio:.6g}"
        return "\n".join([columns(rows), tends, *([self.stopped] if self.stopped else [])])


def _or_dash(text):
    return "-" if text == "nan" else text


@check.host("use located for derivatives of a grazing's value")
def period_adding(special: Special, longest: int = LONGEST, *, max_seconds: float | None = None) -> PeriodAdding:
    """The places where the orbits of period adding beyond a grazing touch a wall once more: a `PeriodAdding`.

    special, longest: as of `scenario`. For each n the orbits with one impact besides in n returns are followed from the
    grazing on along the speed of that impact, until a flight touches a wall; the place is located to rounding. From a
    period doubling to there they are stable, for large n if not CHAOS follows. `follow` goes on from the `orbit` of
    each. max_seconds: wall-clock time, s, after which no further n is begun, which `stopped` then tells; None is no
    limit.

    Raises what `scenario` raises, and ArgumentError for a grazing that no period adding follows.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    longest = checked_longest(longest)
    given = returned(special)
    told = scenario_of(special, given, longest)
    if told.follows not in GRADUAL:
        raise check.ArgumentError(
            "special", "must be a grazing that period adding or chaos follows", told.follows.value
        )
    windows: list[PeriodicWindow] = []
    length, last = scene_length(special.scene), np.nan
    for n in range(FIRST, longest + 1):
        if limits.expired:
            reason = partial_reason(len(windows), longest + 1 - FIRST, "windows")
            return PeriodAdding(told, tuple(windows), reason)
        windows.append(_window(told, given, n, length, last))
        last = windows[-1].found
    return PeriodAdding(told, tuple(windows))


def _window(told, given, n, length, last):
    """The `PeriodicWindow` of n returns; last: the place found for n - 1."""
    special, pull = told.special, 2.0 * told.acceleration
    near, predicted = SquareRootMap(told.root, told.matrix).window(n), told.orbits[n - 1].touch
    orbits = one_impact_orbits(given, n, length)
    touch = next_touch(orbits, near.touch * np.sqrt(pull))
    if touch is None:
        return PeriodicWindow(n, predicted, np.nan, "", np.nan, None)
    z, side = touch
    found, speed = float(z[-1]), z[orbits.place]
    begin = near.stable * np.sqrt(pull)
    begin = begin if begin < speed else 0.0
    middle = orbits.at(z, 0.5 * (begin + speed))
    spot = orbits.spot(middle.z, middle.residual)
    orbit = described_orbit(special.scene.replace(**{special.name: spot.value}), spot) if middle.met else None
    ratio = (last - special.value) / (found - special.value)
    return PeriodicWindow(n, predicted, found, SIDES[int(side > 0)], ratio, orbit)
