"""Period adding beyond a grazing, found: `period_adding`."""

from dataclasses import dataclass, field

import numpy as np

from continuation.limits import limits_of, partial_reason

from ..orbits.orbit import Orbit
from ..output.table_text import align_columns
from ..problem.one_impact_orbits import locate_next_grazing, one_impact_orbits
from ..problem.orbit_point import orbit_from_row
from ..problem.square_root_map import SquareRootMap
from ..scene import check
from ..scene.scene import SIDES
from ..scene.typical_scales import scene_length
from .branch import Special
from .scenario import (
    DEFAULT_MAX_RETURNS,
    GRADUAL_OUTCOMES,
    Scenario,
    check_max_returns,
    grazing_return_of,
    make_scenario,
)

MIN_RETURNS = 2  # returns: with one impact in each there is no other to be met


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
        for window in self.windows:
            value_texts = [f"{window.predicted:.12g}", f"{window.found:.12g}"]
            value_texts += [f"{entry:.6g}" for entry in (window.predicted - value, window.found - value, window.ratio)]
            rows.append(
                (
                    window.returns,
                    window.orbit.label if window.orbit else "-",
                    *(_dash_if_nan(entry) for entry in value_texts),
                )
            )
        limit_line = f"the ratio tends to {self.scenario.ratio:.6g}"
        return "\n".join([align_columns(rows), limit_line, *([self.stopped] if self.stopped else [])])


def _dash_if_nan(text):
    return "-" if text == "nan" else text


@check.host_only("use located for derivatives of a grazing's value")
def period_adding(
    special: Special, longest: int = DEFAULT_MAX_RETURNS, *, max_seconds: float | None = None
) -> PeriodAdding:
    """The places where the orbits of period adding beyond a grazing touch a wall once more: a `PeriodAdding`.

    special, longest: as of `scenario`. For each n the orbits with one impact besides in n returns are followed from the
    grazing on along the speed of that impact, until a flight touches a wall; the place is located to rounding. From a
    period doubling to there they are stable, for large n if not CHAOS follows. `follow` goes on from the `orbit` of
    each. max_seconds: wall-clock time, s, after which no further n is begun, which `stopped` then tells; None is no
    limit.

    Raises what `scenario` raises, and ArgumentError for a grazing that no period adding follows.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    longest = check_max_returns(longest)
    grazing_return = grazing_return_of(special)
    scenario = make_scenario(special, grazing_return, longest)
    if scenario.follows not in GRADUAL_OUTCOMES:
        raise check.ArgumentError(
            "special", "must be a grazing that period adding or chaos follows", scenario.follows.value
        )
    windows: list[PeriodicWindow] = []
    length_scale, last_value = scene_length(special.scene), np.nan
    for n in range(MIN_RETURNS, longest + 1):
        if limits.expired:
            reason = partial_reason(len(windows), longest + 1 - MIN_RETURNS, "windows")
            return PeriodAdding(scenario, tuple(windows), reason)
        windows.append(_make_window(scenario, grazing_return, n, length_scale, last_value))
        last_value = windows[-1].found
    return PeriodAdding(scenario, tuple(windows))


def _make_window(scenario, grazing_return, n, length_scale, last_value):
    """The `PeriodicWindow` of n returns; last_value: the place found for n - 1."""
    special, doubled_acceleration = scenario.special, 2.0 * scenario.acceleration
    window, predicted = SquareRootMap(scenario.root, scenario.matrix).window(n), scenario.orbits[n - 1].touch
    orbits = one_impact_orbits(grazing_return, n, length_scale)
    grazing_point = locate_next_grazing(orbits, window.grazing_root * np.sqrt(doubled_acceleration))
    if grazing_point is None:
        return PeriodicWindow(n, predicted, np.nan, "", np.nan, None)
    z, side = grazing_point
    value, speed = float(z[-1]), z[orbits.speed_index]
    start_speed = window.min_stable_root * np.sqrt(doubled_acceleration)
    start_speed = start_speed if start_speed < speed else 0.0
    middle_point = orbits.point_at_speed(z, 0.5 * (start_speed + speed))
    orbit_row = orbits.orbit_row_at(middle_point.z, middle_point.residual)
    orbit = (
        orbit_from_row(special.scene.replace(**{special.name: orbit_row.value}), orbit_row)
        if middle_point.converged
        else None
    )
    ratio = (last_value - special.value) / (value - special.value)
    return PeriodicWindow(n, predicted, value, SIDES[int(side > 0)], ratio, orbit)
