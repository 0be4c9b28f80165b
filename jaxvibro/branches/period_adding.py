"""Period adding beyond a grazing, found: `period_adding`."""

from dataclasses import dataclass, field

import numpy as np

from ..orbits.orbit import Orbit
from ..output.table_text import columns
from ..problem.one_impact import next_touch, one_impact_orbits
from ..problem.orbit_on_branch import described_orbit
from ..problem.square_root_map import SquareRootMap
from ..scene import check
from ..scene.scale import scene_length
from .branch import Special
from .scenario import LONGEST, Follows, Scenario, checked_longest, returned, scenario_of

GRADUAL = (Follows.OVERLAPPING, Follows.ADDING, Follows.CHAOS)
FIRST = 2  # returns: with one impact in each there is no other to be met


@dataclass(frozen=True)
class Stretch:
    """The orbits with one impact besides in n returns. returns: n; predicted: the parameter's value where they meet the
    wall once more, by the square-root map; found: the same of the orbits themselves, nan where it was not found; ratio:
    the place found for n - 1 over this one, as seen from the grazing; orbit: one of them, halfway from where they are
    to be stable to the touch; None where none was found."""

    returns: int
    predicted: float
    found: float
    ratio: float
    orbit: Orbit | None = field(repr=False)


@dataclass(frozen=True, eq=False)
class PeriodAdding:
    """What was found beyond a grazing. scenario: what its signs say; stretches: a `Stretch` for each n from 2 on."""

    scenario: Scenario
    stretches: tuple[Stretch, ...]

    def table(self) -> str:
        """The places predicted and found as a text, a line for each n."""
        limit, rows = self.scenario.limit, [("returns", "orbit", "predicted", "found", "ratio")]
        for one in self.stretches:
            places = (f"{each:.12g}" if np.isfinite(each) else "-" for each in (one.predicted, one.found))
            ratio = f"{one.ratio:.6g}" if np.isfinite(one.ratio) else "-"
            rows.append((one.returns, one.orbit.label if one.orbit else "-", *places, ratio))
        return f"{columns(rows)}\nthe ratio tends to {limit:.6g}"


@check.host("use located for derivatives of a grazing's value")
def period_adding(special: Special, longest: int = LONGEST) -> PeriodAdding:
    """The places where the orbits of period adding beyond a grazing meet the wall once more: a `PeriodAdding`.

    special, longest: as of `scenario`. For each n the orbits with one impact besides in n returns are followed from the
    grazing on along the speed of that impact, until a flight touches a wall; the place is located to rounding. They are
    stable before that, from a period doubling on, if the scenario is no `CHAOS`.

    Raises what `scenario` raises, and ArgumentError for a grazing that no period adding follows.
    """
    longest = checked_longest(longest)
    given = returned(special)
    told = scenario_of(special, given, longest)
    if told.follows not in GRADUAL:
        raise check.ArgumentError("special", "must be a grazing that period adding or chaos follows", told.follows.value)
    length, stretches, last = scene_length(special.scene), [], np.nan
    for n in range(FIRST, longest + 1):
        stretches.append(_stretch(told, given, n, length, last))
        last = stretches[-1].found
    return PeriodAdding(told, tuple(stretches))


def _stretch(told, given, n, length, last):
    """The `Stretch` of n returns; last: the place found for n - 1."""
    special, pull = told.special, 2.0 * told.acceleration
    near, predicted = SquareRootMap(told.root, told.matrix).stretch(n), told.orbits[n - 1].touch
    orbits = one_impact_orbits(given, n, length)
    touch = next_touch(orbits, near.touch * np.sqrt(pull), length)
    if touch is None:
        return Stretch(n, predicted, np.nan, np.nan, None)
    z, _ = touch
    found, speed = float(z[-1]), z[orbits.index]
    begin = min(near.stable * np.sqrt(pull), speed) if np.isfinite(near.stable) else 0.0
    middle = orbits.at(z, 0.5 * (begin + speed))
    spot = orbits.spot(middle.z, middle.residual)
    orbit = described_orbit(special.scene.replace(**{special.name: spot.value}), spot) if middle.met else None
    return Stretch(n, predicted, found, (last - special.value) / (found - special.value), orbit)
