"""Continue a branch past a CH or RL, between orbits that stick and orbits that do not, or stick differently.

The orbits on the two sides differ in their bounces before a release; towards a CH there are ever more of them. The
orbit on the other side is found by simulation from the point: a motion that sticks does not depend on its past, so a
flight from the orbit settles on the one that continues the branch. Close to the CH, where the bounces would be lost in
rounding, a small interval is skipped.
"""

import numpy as np

from continuation.event_search import unit_tangent
from continuation.intermediate_points import start_point
from continuation.limits import UNLIMITED

from ..flight.wall_positions import clamp_to_walls
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..problem import sticking_limits
from ..problem.diagnostics import diagnose
from ..problem.equations import continuation_problem, scene_at
from ..problem.grazing import GrazingExit, padded_sequence
from ..problem.grazing_contact import admissible, arclength_weights
from ..problem.orbit_conversion import correct_to_value, orbit_row_of
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


def is_chatter(problem, z, length_scale, grazing_contacts=(), max_speed=SLOW_SPEED):
    """Test whether an impact is so slow that many more follow before the mass sticks, except at some grazings."""
    contact_rows = [contact.row for contact in grazing_contacts if contact.is_impact]
    speeds = z[len(problem.sequence.sides) :][np.setdiff1d(problem.impact_rows, contact_rows)]
    return bool(((speeds > 0) & (speeds < max_speed * length_scale)).any())


def find_sticking_exits(problem, z, sign, length_scale, limits=UNLIMITED):
    """Return the list of `GrazingExit` records of a CH or RL, None if the time is over.

    They are orbits on the other side: towards greater values of the parameter if `sign` is 1.
    """
    lifted_problem = sticking_limits.toggle_lift_off(problem, z, length_scale)
    if lifted_problem is not None:
        return [_exit_towards(lifted_problem, z, sign, length_scale)]
    for offset in VALUE_OFFSETS:
        if limits.expired:
            return None
        settled_orbit = _settled_orbit(problem, z, z[-1] + sign * offset * (1.0 + abs(z[-1])))
        if settled_orbit is not None and not is_chatter(*settled_orbit, length_scale):
            return [_exit_towards(*settled_orbit, sign, length_scale)]
    return []


def repartition_impacts(problem, z, sign, length_scale):
    """Return the `GrazingExit` of the same orbit with other bounces as rows, None if its own rows are adequate."""
    if problem.sequence.releases is None or diagnose(problem, z[None]).hop_margin.min() > MIN_HOP_MARGIN:
        return None
    settled_orbit = _settled_orbit(problem, z, z[-1])
    return None if settled_orbit is None else _exit_towards(*settled_orbit, sign, length_scale)


def _exit_towards(problem, z, sign, length_scale):
    """Make the `GrazingExit` from a regular point, towards greater values of the parameter if `sign` is 1."""
    exit_tangent = unit_tangent(continuation_problem(problem), z, arclength_weights(problem, length_scale), problem)
    return _make_exit(problem, z, sign * np.sign(exit_tangent[-1]) * exit_tangent, z)


def complete_chatter(problem, z, sign, length_scale, limits=UNLIMITED):
    """Find the CH close to a grazing.

    Returns the `GrazingExit` from the CH and the largest residual there, if orbits that stick exist on one of its
    sides. Returns None if none are found, or the time is over. `sign` is the direction in which the branch came.
    """
    for offset in VALUE_OFFSETS:
        for direction in (sign, -sign):
            if limits.expired:
                return None
            value = z[-1] + direction * offset * (1.0 + abs(z[-1]))
            settled_orbit = _settled_orbit(problem, z, value)
            if settled_orbit is None or _count_sticking(settled_orbit[0]) <= _count_sticking(problem):
                continue
            new_problem, nearby_z = settled_orbit
            chatter_point = _nearest_chatter_point(new_problem, nearby_z, z[-1], value)
            if chatter_point is not None:
                exit_tangent = unit_tangent(
                    continuation_problem(new_problem),
                    chatter_point.z,
                    arclength_weights(new_problem, length_scale),
                    new_problem,
                )
                orientation = np.sign(nearby_z[-1] - chatter_point.z[-1]) * np.sign(exit_tangent[-1])
                return _make_exit(
                    new_problem, chatter_point.z, orientation * exit_tangent, nearby_z
                ), chatter_point.residual
    return None


def _count_sticking(problem):
    """Return the number of sticking phases of an orbit."""
    return 0 if problem.sequence.releases is None else np.count_nonzero(problem.sequence.releases)


def _nearest_chatter_point(problem, z, value, orbit_value):
    """Locate the CH of one of the sticking phases of an orbit, about as far from a value as the orbit itself."""
    rows = np.flatnonzero(np.isfinite(diagnose(problem, z[None]).sticking_time[0]))
    candidates = [
        sticking_limits.locate_sticking_limit(problem, z, int(row), sticking_limits.excess_speeds) for row in rows
    ]
    candidates = [
        candidate
        for candidate in candidates
        if candidate.z is not None and abs(candidate.z[-1] - value) <= 2.0 * abs(orbit_value - value)
    ]
    return min(candidates, key=lambda candidate: abs(candidate.z[-1] - orbit_value), default=None)


def _make_exit(problem, z, exit_tangent, nearby_z):
    """Make a `GrazingExit` without grazing contacts."""
    return GrazingExit(problem, start_point(z, exit_tangent), nearby_z, diagnose(problem, nearby_z[None]), ())


def _settled_orbit(problem, z, value):
    """Return the equations and z of the orbit on which a motion from z settles, None if it is not close."""
    scene = scene_at(problem, np.append(z[:-1], value))
    diagnostics, periods = diagnose(problem, z[None]), int(problem.sequence.periods)
    state = clamp_to_walls(scene, State(float(diagnostics.x[0, 0]), float(diagnostics.v[0, 0])))
    try:
        orbit = find_orbit(scene, State(float(state.x), float(state.v)), periods=periods, settle=SETTLING_PERIODS)
        orbit_row = orbit_row_of(orbit, value)
    except (OrbitError, ValueError):
        return None
    if orbit.periods != periods or not len(orbit_row.times):
        return None
    new_problem = problem._replace(
        sequence=padded_sequence(problem, list(zip(orbit_row.times, orbit_row.speeds, orbit_row.sides, strict=True)))
    )
    point = correct_to_value(
        new_problem, np.concatenate([new_problem.sequence.times, new_problem.sequence.speeds, [value]]), value
    )
    new_diagnostics = diagnose(new_problem, point.z[None])
    max_distance = STATE_TOLERANCE * max(abs(diagnostics.x).max(), abs(diagnostics.v).max())
    state_distance = max(abs(new_diagnostics.x - diagnostics.x).max(), abs(new_diagnostics.v - diagnostics.v).max())
    return (
        (new_problem, point.z)
        if point.converged and admissible(new_problem, point.z, new_diagnostics)[0] and state_distance < max_distance
        else None
    )
