"""Test whether an orbit at a parameter value lies on a branch."""

import numpy as np

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.orbit_diagnostics import diagnose
from ..problem.orbit_equivalence import comparison_points
from .branch import branch_point

PREFILTER_TOLERANCE = 0.15  # relative to the largest x and v of the branch; closer states are tested by Newton's method
ORBIT_TOLERANCE = 1e-5  # relative to the largest speed; largest difference of impacts of one orbit
CHATTER_TOLERANCE = 1e-4  # relative to the largest x and v; largest difference of states of one orbit that sticks


def is_on_branch(seed_orbit, branch):
    """Test whether a seed orbit lies on a branch."""
    if branch.data.sizes["period"] != seed_orbit.point.periods:
        return False
    value_offsets, branch_states = (
        branch.values - seed_orbit.point.value,
        np.stack([branch.data[key].values for key in "xv"], axis=2),
    )
    max_distance = PREFILTER_TOLERANCE * abs(branch_states).max()
    for row_before in np.flatnonzero(value_offsets[:-1] * value_offsets[1:] <= 0):
        if _are_states_near(
            seed_orbit, branch_states[row_before : row_before + 2], max_distance
        ) and _converges_to_seed_orbit(seed_orbit, branch, row_before):
            return True
    return False


def _are_states_near(seed_orbit, branch_states, max_distance):
    """Test whether the states of a seed orbit are near those of a point of a branch, up to a shift of periods."""
    shifted_branch_states = [
        np.roll(point_states, period_shift, axis=0)
        for point_states in branch_states
        for period_shift in range(len(point_states))
    ]
    return any(
        abs(shifted_states - seed_orbit.section_states).max() < max_distance for shifted_states in shifted_branch_states
    )


def _converges_to_seed_orbit(seed_orbit, branch, row_before):
    """Test whether Newton's method leads from one of two adjacent points of a branch to the seed orbit."""
    points = (branch_point(branch, row) for row in (row_before, row_before + 1))
    return any(correct_to_seed_orbit(seed_orbit, point.problem, point.z) is not None for point in points)


def correct_to_seed_orbit(seed_orbit, problem, z):
    """Correct z to the parameter value of a seed orbit by Newton's method.

    Returns the equations and z at this value, or None if the method does not converge to the seed orbit.
    """
    point = problem.solve_at(z, -1, seed_orbit.point.value, 1.0)
    return (problem, point.z) if point.converged and _is_seed_orbit(seed_orbit, problem, point.z) else None


def _is_seed_orbit(seed_orbit, problem, z):
    if seed_orbit.may_stick:
        diagnostics, state_scale = diagnose(problem, z[None]), abs(seed_orbit.section_states).max()
        seed_states = np.roll(seed_orbit.section_states, 1, axis=0)  # the last state is at phase 0
        return abs(np.stack([diagnostics.x[0], diagnostics.v[0]], 1) - seed_states).max() < CHATTER_TOLERANCE * max(
            1.0, state_scale
        )
    if not len(problem.sequence.sides):
        return not seed_orbit.point.problem.n_rows and abs(
            z[:2] - seed_orbit.section_states[0]
        ).max() < ORBIT_TOLERANCE * max(1.0, abs(seed_orbit.section_states).max())
    speed_scale = seed_orbit.point.speeds.max(initial=0.0)
    seed_impacts = comparison_points(seed_orbit.point.problem, seed_orbit.point.z, speed_scale)
    return is_same_orbit(comparison_points(problem, z, speed_scale), seed_impacts, ORBIT_TOLERANCE)
