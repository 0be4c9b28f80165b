"""Locate the orbits of period adding beyond a grazing."""

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

MIN_RETURNS = 2  # with an impact in every return the orbit has no other grazing contact


@dataclass(frozen=True)
class PeriodicWindow:
    """Orbits with one additional impact in n returns, located numerically.

    Attributes
    ----------
    returns : int
        Number n of returns.
    predicted : float
        Parameter value of the next grazing of the orbits, predicted by the square-root map.
    found : float
        Parameter value of their first grazing, nan if it is not located.
    wall : str
        Wall that is touched, ``"left"`` or ``"right"``; empty if none.
    ratio : float
        Distance of `found` for n - 1 from the grazing, divided by that of this window.
    orbit : Orbit or None
        Orbit halfway between the onset of stability and the grazing; None if none is located.

    Examples
    --------
    >>> model = jv.make_scene(amplitude=6.0, frequency=2.1, damping=1.2, restitution=0.7, walls=(None, 1.0))
    >>> start = jv.find_orbit(model, jv.State(x=0.0, v=0.0))
    >>> grazing = jv.follow(start, "amplitude", bounds=(6.0, 6.2)).points("GR")[0]
    >>> window = jv.period_adding(grazing, 3).windows[-1]
    >>> window.returns, round(window.found, 6), window.wall
    (3, 6.192965, 'right')
    """

    returns: int
    predicted: float
    found: float
    wall: str
    ratio: float
    orbit: Orbit | None = field(repr=False)


@dataclass(frozen=True, eq=False)
class PeriodAdding:
    """Period adding beyond a grazing.

    Attributes
    ----------
    scenario : Scenario
        Classification of the grazing.
    windows : tuple of PeriodicWindow
        One window for each n from 2 on.
    stopped : str
        Reason for fewer windows than requested, else empty.

    See Also
    --------
    period_adding : Locate the orbits of period adding beyond a grazing.

    Examples
    --------
    >>> model = jv.make_scene(amplitude=6.0, frequency=2.1, damping=1.2, restitution=0.7, walls=(None, 1.0))
    >>> start = jv.find_orbit(model, jv.State(x=0.0, v=0.0))
    >>> grazing = jv.follow(start, "amplitude", bounds=(6.0, 6.2)).points("GR")[0]
    >>> adding = jv.period_adding(grazing, 3)
    >>> len(adding.windows), adding.stopped
    (2, '')
    """

    scenario: Scenario
    windows: tuple[PeriodicWindow, ...]
    stopped: str = ""

    def table(self) -> str:
        """Format the predicted and the located parameter values.

        Returns
        -------
        str
            One line for each n, with the distances from the grazing.
        """
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
    """Locate the orbits of period adding beyond a grazing.

    For each n the orbits with one additional impact in n returns are followed from the grazing along the speed of that
    impact, until a flight touches a wall. The parameter value there is located to rounding. From a period doubling to
    there the orbits are stable, for large n unless CHAOS follows. `follow` continues from the ``orbit`` of each window.

    Parameters
    ----------
    special : Special
        GR of a branch, as for `scenario`.
    longest : int, optional
        Last n, from 1 to 64.
    max_seconds : float, optional
        Wall-clock time in s after which no further n is begun; ``stopped`` then gives the reason. None is no limit.

    Returns
    -------
    PeriodAdding
        Classification and one window for each n from 2 on.

    Raises
    ------
    ArgumentError
        If `scenario` does not accept the point, or no period adding follows the grazing.

    See Also
    --------
    scenario : Classify the dynamics that follow a grazing.

    Examples
    --------
    >>> model = jv.make_scene(amplitude=6.0, frequency=2.1, damping=1.2, restitution=0.7, walls=(None, 1.0))
    >>> start = jv.find_orbit(model, jv.State(x=0.0, v=0.0))
    >>> grazing = jv.follow(start, "amplitude", bounds=(6.0, 6.2)).points("GR")[0]
    >>> adding = jv.period_adding(grazing, 3)
    >>> [window.orbit.label for window in adding.windows]
    ['P201', 'P301']
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
    """Make the `PeriodicWindow` of n returns; `last_value` is the value located for n - 1."""
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
