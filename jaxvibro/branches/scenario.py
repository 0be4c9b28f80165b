"""Classify the dynamics that follow a grazing, and locate the orbits of period adding."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Complex, Float

from continuation.branch_segment import make_limits, partial_result_reason

from ..contact.kinds import contact_of_wall
from ..maps import itinerary as words
from ..orbits.orbit import STABILITY_MARGIN, Orbit
from ..output.table_text import align_columns, multipliers_text
from ..problem.added_impact_orbits import (
    MAX_RETURNS,
    SquareRootMap,
    added_impact_indices,
    added_impact_orbits,
    grazing_traversal_count,
    locate_next_grazing,
)
from ..problem.grazing_return_map import compute_grazing_return
from ..problem.orbit_point import orbit_from_point
from ..problem.soft_wall_grazing import is_smooth_soft_wall
from ..scene import check
from ..scene.scene import SIDES
from .branch import Special

DEFAULT_MAX_RETURNS = 6
ROOT_EXPONENT = 0.5  # the exponent at a rigid wall
OVERLAP_MULTIPLIER, CHAOS_MULTIPLIER = (
    0.25,
    2.0 / 3.0,
)  # between these larger multipliers there is chaos between the windows of period adding


class Follows(Enum):
    """Outcome of a grazing for a motion that is stable before the grazing.

    Attributes
    ----------
    OVERLAPPING
        Period adding; each window of parameters overlaps the next. Attractors depart gradually from the grazing orbit.
    ADDING
        Period adding with chaos between the windows. Attractors depart gradually from the grazing orbit.
    CHAOS
        Chaos alone. Attractors depart gradually from the grazing orbit.
    JUMP
        No attractor remains near the grazing.
    C1
        The motion continues at a soft wall, with a continuous derivative.
    UNSTABLE
        The motion is unstable before the grazing.
    OPEN
        The square-root map does not decide the outcome: there are several grazing contacts, the grazed wall is soft, a
        multiplier is complex or negative, or the sign of C M^n E (see `OneImpact.response`) is lost in rounding.

    Examples
    --------
    >>> jv.Follows.JUMP.value
    'jump'
    """

    OVERLAPPING = "period adding, overlapping"
    ADDING = "period adding, chaos between"
    CHAOS = "chaos"
    JUMP = "jump"
    C1 = "C1"
    UNSTABLE = "unstable"
    OPEN = "open"


GRADUAL_OUTCOMES = (Follows.OVERLAPPING, Follows.ADDING, Follows.CHAOS)


@dataclass(frozen=True)
class OneImpact:
    """Orbits with one additional impact in n returns, predicted by the square-root map.

    Attributes
    ----------
    returns : int
        Number n of returns. A return leads from the grazing contact to the next one, as in `Scenario.matrix`.
    label : str
        Label P n p q of the orbits.
    response : float
        C M^n E, where C is the derivative of the virtual depth with respect to (x, v), M is `Scenario.matrix` and E is
        the direction of the velocity jump. Positive if an impact is followed by a deeper contact n returns later.
    fold : float
        Parameter value of the fold of the orbits, nan if there is none.
    doubling : float
        Parameter value of the period doubling of the orbits, nan if there is none.
    touch : float
        Parameter value at which a flight of the orbits grazes the wall, nan if there is none.
    stable : bool
        True if some of the orbits are stable.

    Examples
    --------
    >>> one_impact = jv.scenario(branch.points("GR")[0]).orbits[0]
    >>> one_impact.returns, one_impact.label, round(one_impact.response, 6)
    (1, 'P111', 4.676962)
    """

    returns: int
    label: str
    response: float
    fold: float
    doubling: float
    touch: float
    stable: bool


@dataclass(frozen=True, eq=False)
class Scenario:
    """Dynamics that follow a grazing.

    Attributes
    ----------
    special : Special
        The grazing.
    follows : Follows
        Outcome for a motion that is stable before the grazing.
    wall : str
        Grazed wall, ``"left"`` or ``"right"``; of two grazed walls the wall with the larger root.
    root : float
        Jump of the velocity divided by the square root of the depth that a contact would have.
    exponent : float
        Exponent of the depth in the change of the motion by a contact, 0.5 at a rigid wall.
    acceleration : float
        Acceleration at the grazing relative to the wall, away from it.
    rate : float
        Derivative of the depth with respect to the parameter.
    side : int
        Side of the parameter on which the depth is positive, 1 or -1.
    half : bool
        True if a return is half of the orbit and the other half is its mirror image.
    matrix : ndarray
        Derivative M of a return without the impact: maps a perturbation of (x, v) at the grazing contact to that at the
        next one. Array of shape (2, 2).
    multipliers : ndarray
        Eigenvalues of `matrix`, complex array of shape (2,), the larger first.
    deeper : int
        First n with C M^n E > 0 (see `OneImpact.response`), 0 if there is none.
    ratio : float
        Limit of the ratio by which the `touch` values of `orbits` approach the grazing from n to n + 1: the inverse
        square of the larger multiplier if attractors depart gradually from the grazing orbit, else nan.
    orbits : tuple of OneImpact
        One entry for each n from 1 on. Empty if the outcome is UNSTABLE, if the wall is soft, or if a return has
        several grazing contacts.

    See Also
    --------
    scenario : Classify the dynamics that follow a grazing.

    Examples
    --------
    >>> scenario = jv.scenario(branch.points("GR")[0])
    >>> scenario.follows, scenario.deeper, round(scenario.root, 6)
    (<Follows.JUMP: 'jump'>, 1, 5.048742)
    """

    special: Special = field(repr=False)
    follows: Follows
    wall: str
    root: float
    exponent: float
    acceleration: float
    rate: float
    side: int
    half: bool
    matrix: Float[np.ndarray, "2 2"]
    multipliers: Complex[np.ndarray, "2"]
    deeper: int
    ratio: float
    orbits: tuple[OneImpact, ...]

    def table(self) -> str:
        """Format the outcome and the orbits with one additional impact.

        Returns
        -------
        str
            Outcome, then one line for each n.
        """
        outcome_lines = [
            f"{self.follows.value}: {self.special.label} touches the {self.wall} wall at {self.special.value:.12g}",
            f"{self._contact_effect_text}, depth {self.rate:+.6g} a unit",
            f"multipliers of a return{' of half the orbit' * self.half}: {multipliers_text(self.multipliers)}",
        ]
        if np.isfinite(self.ratio):
            outcome_lines.append(f"places come nearer by {self.ratio:.6g} each")
        rows: list[tuple[object, ...]] = [("returns", "orbit", "C M^n E", "fold", "doubling", "touch", "stable")]
        for one_impact in self.orbits:
            value_texts = (
                f"{value:.9g}" if np.isfinite(value) else "-"
                for value in (one_impact.fold, one_impact.doubling, one_impact.touch)
            )
            rows.append(
                (
                    one_impact.returns,
                    one_impact.label,
                    one_impact.response,
                    *value_texts,
                    "yes" if one_impact.stable else "no",
                )
            )
        return "\n".join([*outcome_lines, *([align_columns(rows)] if self.orbits else [])])

    @property
    def _contact_effect_text(self):
        if self.exponent == ROOT_EXPONENT:
            return f"velocity jumps by {self.root:.6g} sqrt(depth)"
        return f"change as depth^{self.exponent:g}"


@check.host_only("use located for derivatives of a grazing's value")
def scenario(special: Special, longest: int = DEFAULT_MAX_RETURNS) -> Scenario:
    """Classify the dynamics that follow a grazing.

    The multipliers of the square-root map at the point and the signs of its C M^n E (see `OneImpact.response`) decide.
    No orbit is followed.

    Parameters
    ----------
    special : Special
        GR of a branch, of an orbit that does not stick, with or without impacts, along any parameter. The wall may
        move.
    longest : int, optional
        Largest n, from 1 to 64, for which the orbits with one additional impact in n returns are listed.

    Returns
    -------
    Scenario
        Outcome and orbits.

    Raises
    ------
    ArgumentError
        If `special` is of another kind, belongs to an orbit that sticks, or is no contact from outside the wall; or if
        `longest` is invalid.

    See Also
    --------
    period_adding : Locate the orbits of period adding beyond a grazing.

    Notes
    -----
    At a rigid wall Nordmark's map is derived from the orbit without the grazing contact: a contact of depth d changes
    the velocity by ``root * sqrt(d)``. The parameter values are of first order in the square root of the depth, and
    therefore accurate close to the point. Half of an orbit is analysed if the orbit grazes both walls and is its own
    mirror image. Other orbits with several grazing contacts are OPEN. A soft wall whose force has no jump gives C1.

    Examples
    --------
    >>> print(jv.scenario(branch.points("GR")[0]).table().splitlines()[0])
    jump: P111 touches the right wall at 3.41646015636
    """
    longest = check_max_returns(longest)
    return make_scenario(special, grazing_return_of(special), longest)


def check_max_returns(max_returns):
    """Check the largest number of returns and return it as an int.

    Raises ArgumentError if the number is not between 1 and `MAX_RETURNS`.
    """
    max_returns = check.check_whole_number("longest", max_returns, 1)
    if max_returns > MAX_RETURNS:
        raise check.ArgumentError("longest", f"must be at most {MAX_RETURNS}", max_returns)
    return max_returns


def grazing_return_of(special):
    """Return the `GrazingReturn` of a grazing. Raises ArgumentError if `scenario` does not accept the point."""
    if not isinstance(special, Special) or special.kind != "GR":
        rejected_value = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", "must be a grazing, GR, of a branch", rejected_value)
    if special.orbit.rests:
        raise check.ArgumentError("special", "must be of an orbit that does not stick", special.label)
    grazing_return = compute_grazing_return(special.scene, special.name, special.spot.problem, special.spot.z)
    if grazing_return is None:
        raise check.ArgumentError("special", "must touch a wall from outside", special.label)
    return grazing_return


def make_scenario(special, grazing_return, max_returns):
    """Make the `Scenario` of a grazing from its `GrazingReturn`."""
    dominant_depth = max(
        (omitted_grazing.depth for omitted_grazing in grazing_return.omitted_grazings),
        key=lambda contact_depth: contact_depth.root,
    )
    side, square_root_map = (
        SIDES[int(dominant_depth.side > 0)],
        SquareRootMap(dominant_depth.root, grazing_return.matrix),
    )
    wall, contact = special.scene.walls[side], contact_of_wall(special.scene, side)
    is_single_rigid_contact = not wall.soft and len(grazing_return.omitted_grazings) == 1 + grazing_return.is_half_orbit
    if all(
        is_smooth_soft_wall(special.scene, omitted_grazing.depth.side)
        for omitted_grazing in grazing_return.omitted_grazings
    ):
        follows, deeper, exponent = Follows.C1, 0, contact.grazing_exponent(wall)
    else:
        (follows, deeper), exponent = _classify_outcome(square_root_map, is_single_rigid_contact), ROOT_EXPONENT
    has_map_orbits = is_single_rigid_contact and follows is not Follows.UNSTABLE
    return Scenario(
        special=special,
        follows=follows,
        wall=SIDES[int(dominant_depth.side > 0)],
        root=dominant_depth.root,
        exponent=exponent,
        acceleration=dominant_depth.acceleration,
        rate=dominant_depth.slope,
        side=int(np.sign(dominant_depth.slope)),
        half=grazing_return.is_half_orbit,
        matrix=grazing_return.matrix,
        multipliers=square_root_map.multipliers,
        deeper=deeper,
        ratio=float(square_root_map.multipliers[0].real ** -2) if follows in GRADUAL_OUTCOMES else np.nan,
        orbits=_predict_orbits(special.value, grazing_return, square_root_map, dominant_depth, max(max_returns, deeper))
        if has_map_orbits
        else (),
    )


def _classify_outcome(square_root_map, is_single_rigid_contact):
    """Return the outcome of a square-root map, and the first n with C M^n E > 0, or 0 if there is none."""
    larger_multiplier, smaller_multiplier = square_root_map.multipliers
    if not abs(larger_multiplier) < 1.0 - STABILITY_MARGIN:
        return Follows.UNSTABLE, 0
    deeper = square_root_map.first_positive_response() if is_single_rigid_contact else None
    if deeper:
        return Follows.JUMP, deeper
    if deeper is None or larger_multiplier.imag or smaller_multiplier.real < 0:
        return Follows.OPEN, 0
    if larger_multiplier.real < OVERLAP_MULTIPLIER:
        return Follows.OVERLAPPING, 0
    return (Follows.ADDING if larger_multiplier.real < CHAOS_MULTIPLIER else Follows.CHAOS), 0


def _predict_orbits(grazing_value, grazing_return, square_root_map, dominant_depth, max_returns):
    """Return the `OneImpact` records that the square-root map predicts."""
    responses, predicted_orbits = square_root_map.impact_responses(max_returns), []
    for n_returns in range(1, max_returns + 1):
        window = square_root_map.added_impact_window(n_returns)
        special_roots = window.fold_root, window.doubling_root, window.next_grazing_root
        parameter_values = (
            grazing_value + window.depth(root) / dominant_depth.slope if np.isfinite(root) and root > 0 else np.nan
            for root in special_roots
        )
        predicted_orbits.append(
            OneImpact(
                n_returns,
                _added_impact_label(grazing_return, n_returns),
                float(responses[n_returns]),
                *map(float, parameter_values),
                bool(window.min_stable_root < window.next_grazing_root),
            )
        )
    return tuple(predicted_orbits)


def _added_impact_label(grazing_return, n_grazing_returns):
    """Return the label P n p q of the orbits with one additional impact in n returns."""
    n_traversals = grazing_traversal_count(grazing_return, n_grazing_returns)
    sides = [*np.asarray(grazing_return.reduced_problem.sequence.sides)] * n_traversals + [
        grazing_return.omitted_grazings[k].depth.side
        for _, k in added_impact_indices(grazing_return, n_grazing_returns)
    ]
    orbit_wall_letters = "L" * sum(side < 0 for side in sides) + "R" * sum(side > 0 for side in sides)
    return words.format_label(
        (orbit_wall_letters, *[""] * (n_traversals * int(grazing_return.reduced_problem.sequence.periods) - 1))
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
