"""The largest abs x of the orbits of a branch, and of one orbit."""

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import Orbit
from ..problem.orbit_point import OrbitPoint, set_up_problem
from ..scene import check
from .branch import Branch
from .largest_position import branch_peak_positions, peak_positions


@check.host_only("use strobe")
def peaks(branch: Branch) -> Float[np.ndarray, " points"]:
    """The largest abs x on the orbit of each point of a `Branch`, (points,), in the scene's lengths.

    Raises ArgumentError for what is no `Branch`.
    """
    if not isinstance(branch, Branch):
        raise check.ArgumentError("branch", "must be a Branch, as follow gives it", branch)
    return branch_peak_positions(branch)


@check.host_only("use strobe")
def peak(orbit: Orbit) -> float:
    """The largest abs x on an `Orbit` of separate impacts, a number in the scene's lengths.

    Raises ArgumentError for an orbit that rests on a wall.
    """
    if not isinstance(orbit, Orbit) or (orbit.unknowns == "state" and orbit.impacts.count):
        raise check.ArgumentError("orbit", "must be an Orbit of separate impacts, as find_orbit gives it", orbit)
    scene, state, impacts = orbit.scene, orbit.state, orbit.impacts
    x, v, phase = (float(np.asarray(value)) for value in (state.x, state.v, state.phase))
    start_time = phase / float(scene.frequency)
    impact_columns = np.asarray(impacts.time) + start_time, np.asarray(impacts.speed), np.asarray(impacts.side, float)
    orbit_row = OrbitPoint(float(scene.amplitude), *impact_columns, orbit.periods, x, v, orbit.residual)
    problem, z = set_up_problem(scene, "amplitude", orbit_row)
    if not len(orbit_row.times):
        z = np.array([orbit_row.x, orbit_row.v, orbit_row.value])
        problem = problem._replace(sequence=problem.sequence._replace(phase=np.asarray(phase)))
    return float(peak_positions(problem, z[None])[0])
