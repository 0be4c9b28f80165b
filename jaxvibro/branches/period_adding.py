"""Locate the orbits of period adding beyond a grazing."""

from dataclasses import dataclass, field

import numpy as np

from continuation.computation_limits import make_limits, partial_result_reason

from ..orbits.orbit import Orbit
from ..output.table_text import align_columns
from ..problem.added_impact_orbits import added_impact_orbits, locate_next_grazing
from ..problem.orbit_conversion import orbit_from_point
from ..problem.square_root_map import SquareRootMap
from ..scene import check
from ..scene.scene import SIDES
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
        Number n of returns. A return leads from the grazing contact to the next one, as in `Scenario.matrix`.
    predicted : float
        Parameter value of the next grazing of the orbits, predicted by the square-root map.
    found : float
        Located parameter value of this grazing, nan if the grazing is not located.
    wall : str
        Wall that the orbits graze, ``"left"`` or ``"right"``; empty if the grazing is not located.
    ratio : float
        Distance of `found` for n - 1 from the original grazing, divided by the distance of `found` for n.
    orbit : Orbit or None
        Orbit whose additional impact has the mean of the speeds at the onset of stability and at the grazing `found`;
        None if no orbit is located.

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
                    *("-" if text == "nan" else text for text in value_texts),
                )
            )
        ratio_line = f"the ratio tends to {self.scenario.ratio:.6g}"
        return "\n".join([align_columns(rows), ratio_line, *([self.stopped] if self.stopped else [])])


@check.host_only("use located for derivatives of a grazing's value")
def period_adding(
    special: Special, longest: int = DEFAULT_MAX_RETURNS, *, max_seconds: float | None = None
) -> PeriodAdding:
    """Locate the orbits of period adding beyond a grazing.

    For each n the orbits with one additional impact in n returns are followed from the grazing along the speed of that
    impact, until a flight grazes a wall. The parameter value of this next grazing is located to rounding. The orbits
    are stable between a period doubling and the next grazing, but not for large n if the outcome is CHAOS. `follow` can
    start from the ``orbit`` of each window.

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
        If `scenario` does not accept the point, or neither period adding nor chaos follows the grazing.

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
    limits = make_limits(None, max_seconds, None, check.ArgumentError)
    longest = check_max_returns(longest)
    grazing_return = grazing_return_of(special)
    scenario = make_scenario(special, grazing_return, longest)
    if scenario.follows not in GRADUAL_OUTCOMES:
        raise check.ArgumentError(
            "special", "must be a grazing that period adding or chaos follows", scenario.follows.value
        )
    windows: list[PeriodicWindow] = []
    previous_value = np.nan
    for n_returns in range(MIN_RETURNS, longest + 1):
        if limits.expired:
            reason = partial_result_reason(len(windows), longest + 1 - MIN_RETURNS, "windows")
            return PeriodAdding(scenario, tuple(windows), reason)
        windows.append(_make_window(scenario, grazing_return, n_returns, previous_value))
        previous_value = windows[-1].found
    return PeriodAdding(scenario, tuple(windows))


def _make_window(scenario, grazing_return, n_returns, previous_value):
    """Make the `PeriodicWindow` of n returns; `previous_value` is the value located for n - 1."""
    special, doubled_acceleration = scenario.special, 2.0 * scenario.acceleration
    window, predicted_value = (
        SquareRootMap(scenario.root, scenario.matrix).added_impact_window(n_returns),
        scenario.orbits[n_returns - 1].touch,
    )
    orbits_near_grazing = added_impact_orbits(grazing_return, n_returns)
    next_grazing = locate_next_grazing(orbits_near_grazing, window.next_grazing_root * np.sqrt(doubled_acceleration))
    if next_grazing is None:
        return PeriodicWindow(n_returns, predicted_value, np.nan, "", np.nan, None)
    z, side = next_grazing
    value, speed = float(z[-1]), z[orbits_near_grazing.speed_index]
    onset_speed = window.min_stable_root * np.sqrt(doubled_acceleration)
    onset_speed = onset_speed if onset_speed < speed else 0.0
    middle_point = orbits_near_grazing.point_at_speed(z, 0.5 * (onset_speed + speed))
    orbit_point = orbits_near_grazing.orbit_point_at(middle_point.z, middle_point.residual)
    orbit = (
        orbit_from_point(special.scene.replace(**{special.name: orbit_point.value}), orbit_point)
        if middle_point.converged
        else None
    )
    ratio = (previous_value - special.value) / (value - special.value)
    return PeriodicWindow(n_returns, predicted_value, value, SIDES[int(side > 0)], ratio, orbit)
