"""Continue a branch past a CH or RL, at which the sticking phases of its orbits change.

The orbits on the two sides differ in the bounces before a release. The number of bounces grows without bound towards a
CH. The orbit on the other side is found by simulation from the point. A motion that sticks does not depend on its past,
so the simulated motion settles on the orbit that continues the branch. Close to the CH the bounces would be lost in
rounding, and a small interval of the parameter is skipped.
"""

import numpy as np

from continuation.arclength import make_start_point
from continuation.computation_limits import UNLIMITED

from ..flight.wall_positions import adapt_to_moved_walls
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..problem import sticking_limits
from ..problem.branches_from_grazing import BranchFromGrazing
from ..problem.grazing_contact import are_admissible
from ..problem.orbit_conversion import impacts_since_phase_0
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_equations import scene_at
from ..scene.state import State

VALUE_OFFSETS = (
    1e-7,
    1e-6,
    1e-5,
    1e-4,
    1e-3,
)  # relative to 1 + abs(parameter); distances from the point at which the next orbit is searched for
STATE_TOLERANCE = 0.05  # relative to the largest x and v at the section; largest distance of the next orbit
SETTLING_PERIODS = 60  # drive periods
MIN_HOP_MARGIN = (
    0.05  # `ChatterOutcome.hop_margin`; below it the first of the last bounces becomes too long for the series
)
SLOW_SPEED = 1e-6  # scene's lengths per t; below it the flights between impacts are lost in rounding


def has_very_slow_impact(problem, z, grazing_contacts=(), max_speed=SLOW_SPEED):
    """Test whether an orbit has an impact so slow that many more follow before the mass sticks.

    Impacts among the `grazing_contacts` are ignored.
    """
    contact_rows = [contact.row for contact in grazing_contacts if contact.is_impact]
    speeds = z[len(problem.sequence.sides) :][np.setdiff1d(problem.impact_rows, contact_rows)]
    return bool(((speeds > 0) & (speeds < max_speed * problem.length_scale)).any())


def find_sticking_exits(problem, z, parameter_sign, limits=UNLIMITED):
    """Return the list of `BranchFromGrazing` records of a CH or RL, None if the time limit is reached.

    The exits lead to orbits on the other side: towards greater values of the parameter if `parameter_sign` is 1.
    """
    toggled_lift_off_problem = sticking_limits.toggle_early_lift_off(problem, z)
    if toggled_lift_off_problem is not None:
        return [_make_exit_towards(toggled_lift_off_problem, z, parameter_sign)]
    for value_offset in VALUE_OFFSETS:
        if limits.expired:
            return None
        settled_orbit = _settled_orbit(problem, z, z[-1] + parameter_sign * value_offset * (1.0 + abs(z[-1])))
        if settled_orbit is not None and not has_very_slow_impact(*settled_orbit):
            return [_make_exit_towards(*settled_orbit, parameter_sign)]
    return []


def reselect_bounce_rows(problem, z, parameter_sign):
    """Return the `BranchFromGrazing` of the same orbit with other bounces as rows, None if the present rows are
    adequate."""
    if problem.sequence.releases is None or diagnose(problem, z[None]).hop_margin.min() > MIN_HOP_MARGIN:
        return None
    settled_orbit = _settled_orbit(problem, z, z[-1])
    return None if settled_orbit is None else _make_exit_towards(*settled_orbit, parameter_sign)


def _make_exit_towards(problem, z, parameter_sign):
    """Make the `BranchFromGrazing` from a regular point, towards greater values of the parameter if `parameter_sign` is
    1."""
    exit_tangent = problem.tangent(z)
    return _make_exit(problem, z, parameter_sign * np.sign(exit_tangent[-1]) * exit_tangent, z)


def locate_nearby_chatter(problem, z, parameter_sign, limits=UNLIMITED):
    """Find the CH close to a grazing.

    Returns the `BranchFromGrazing` from the CH and the largest residual there, if orbits that stick exist on one of its
    sides. Returns None if no such orbits are found, or the time limit is reached. `parameter_sign` is the sign of the
    change of the parameter along the branch before the grazing.
    """
    for value_offset in VALUE_OFFSETS:
        for search_sign in (parameter_sign, -parameter_sign):
            if limits.expired:
                return None
            value = z[-1] + search_sign * value_offset * (1.0 + abs(z[-1]))
            settled_orbit = _settled_orbit(problem, z, value)
            if settled_orbit is None or _count_sticking_phases(settled_orbit[0]) <= _count_sticking_phases(problem):
                continue
            sticking_problem, nearby_z = settled_orbit
            chatter_point = _nearest_chatter_limit(sticking_problem, nearby_z, z[-1], value)
            if chatter_point is not None:
                exit_tangent = sticking_problem.tangent(chatter_point.z)
                tangent_sign = np.sign(nearby_z[-1] - chatter_point.z[-1]) * np.sign(exit_tangent[-1])
                return _make_exit(
                    sticking_problem, chatter_point.z, tangent_sign * exit_tangent, nearby_z
                ), chatter_point.residual
    return None


def _count_sticking_phases(problem):
    """Return the number of sticking phases of an orbit."""
    return 0 if problem.sequence.releases is None else np.count_nonzero(problem.sequence.releases)


def _nearest_chatter_limit(problem, z, value, orbit_value):
    """Locate the CH, among those of all sticking phases of an orbit, that is nearest to the orbit.

    `orbit_value` is the parameter value of the orbit, and `value` that of the grazing. A CH is ignored if it is more
    than twice as far from `value` as the orbit.
    """
    sticking_rows = np.flatnonzero(np.isfinite(diagnose(problem, z[None]).sticking_time[0]))
    candidates = [
        sticking_limits.locate_sticking_limit(problem, z, int(row), sticking_limits.excess_speeds)
        for row in sticking_rows
    ]
    candidates = [
        candidate
        for candidate in candidates
        if candidate.z is not None and abs(candidate.z[-1] - value) <= 2.0 * abs(orbit_value - value)
    ]
    return min(candidates, key=lambda candidate: abs(candidate.z[-1] - orbit_value), default=None)


def _make_exit(problem, z, exit_tangent, nearby_z):
    """Make a `BranchFromGrazing` without grazing contacts."""
    return BranchFromGrazing(
        problem, make_start_point(z, exit_tangent), nearby_z, diagnose(problem, nearby_z[None]), ()
    )


def _settled_orbit(problem, z, value):
    """Return the equations and z of the orbit on which a motion from z settles, None if no such orbit is close to z."""
    scene = scene_at(problem, np.append(z[:-1], value))
    start_diagnostics, periods = diagnose(problem, z[None]), int(problem.sequence.periods)
    state = adapt_to_moved_walls(scene, State(float(start_diagnostics.x[0, 0]), float(start_diagnostics.v[0, 0])))
    try:
        orbit = find_orbit(scene, State(float(state.x), float(state.v)), periods=periods, settle=SETTLING_PERIODS)
        impacts, _ = impacts_since_phase_0(orbit)
    except (OrbitError, ValueError):
        return None
    if orbit.periods != periods or not impacts:
        return None
    new_problem, new_z = problem.with_impacts(np.append(z[:-1], value), impacts)
    point = new_problem.solve_at(new_z, -1, value, 1.0)
    new_diagnostics = diagnose(new_problem, point.z[None])
    max_distance = STATE_TOLERANCE * max(abs(start_diagnostics.x).max(), abs(start_diagnostics.v).max())
    state_distance = max(
        abs(new_diagnostics.x - start_diagnostics.x).max(), abs(new_diagnostics.v - start_diagnostics.v).max()
    )
    return (
        (new_problem, point.z)
        if point.converged
        and are_admissible(new_problem, point.z, new_diagnostics)[0]
        and state_distance < max_distance
        else None
    )
