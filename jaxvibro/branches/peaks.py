"""Compute the largest ``|x|`` of the orbits of a branch, and of one orbit."""

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import Orbit
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from .branch import Branch
from .largest_position import branch_peak_positions, peak_positions


@check.host_only("use strobe")
def peaks(branch: Branch) -> Float[np.ndarray, " points"]:
    """Compute the largest ``|x|`` of each orbit of a branch.

    Parameters
    ----------
    branch : Branch
        Branch.

    Returns
    -------
    ndarray
        Largest ``|x|`` at each point, array of shape (points,), in lengths of the scene.

    Raises
    ------
    ArgumentError
        If `branch` is not a `Branch`.

    See Also
    --------
    peak : Compute the largest ``|x|`` of one orbit.

    Examples
    --------
    >>> jv.peaks(branch).shape == (len(branch),)
    True
    """
    if not isinstance(branch, Branch):
        raise check.ArgumentError("branch", "must be a Branch, as follow returns", branch)
    return branch_peak_positions(branch)


@check.host_only("use strobe")
def peak(orbit: Orbit) -> float:
    """Compute the largest ``|x|`` of an orbit.

    Parameters
    ----------
    orbit : Orbit
        Orbit that does not stick.

    Returns
    -------
    float
        Largest ``|x|``, in lengths of the scene.

    Raises
    ------
    ArgumentError
        If the orbit sticks to a wall.

    See Also
    --------
    peaks : Compute the largest ``|x|`` of each orbit of a branch.

    Examples
    --------
    >>> round(jv.peak(orbit), 6)
    1.0
    """
    if not isinstance(orbit, Orbit) or (orbit.unknowns == "state" and orbit.impacts.count):
        raise check.ArgumentError("orbit", "must be an Orbit that does not stick, as find_orbit returns", orbit)
    scene, state, impacts = orbit.scene, orbit.state, orbit.impacts
    x, v, phase = (float(np.asarray(value)) for value in (state.x, state.v, state.phase))
    start_time = phase / float(scene.frequency)
    impact_columns = np.asarray(impacts.time) + start_time, np.asarray(impacts.speed), np.asarray(impacts.side, float)
    problem, z = make_orbit_problem(scene, "amplitude", periods=orbit.periods), np.array([x, v, float(scene.amplitude)])
    if len(impacts.time):
        problem, z = problem.with_impacts(z, list(zip(*impact_columns, strict=True)))
    else:
        problem = problem._replace(sequence=problem.sequence._replace(phase=np.asarray(phase)))
    return float(peak_positions(problem, z[None])[0])
