"""The largest abs x of the orbits of a branch, and of one orbit."""

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import Orbit
from ..problem.orbit_on_branch import OrbitPoint, place_orbit
from ..scene import check
from .branch import Branch
from .largest_position import largest, largest_of


@check.host("use strobe")
def peaks(branch: Branch) -> Float[np.ndarray, " points"]:
    """The largest abs x on the orbit of each point of a `Branch`, (points,), in the scene's lengths.

    Raises ArgumentError for what is no `Branch`.
    """
    if not isinstance(branch, Branch):
        raise check.ArgumentError("branch", "must be a Branch, as follow gives it", branch)
    return largest_of(branch)


@check.host("use strobe")
def peak(orbit: Orbit) -> float:
    """The largest abs x on an `Orbit` of separate impacts, a number in the scene's lengths.

    Raises ArgumentError for an orbit that rests on a wall.
    """
    if not isinstance(orbit, Orbit) or (orbit.unknowns == "state" and orbit.impacts.count):
        raise check.ArgumentError("orbit", "must be an Orbit of separate impacts, as find_orbit gives it", orbit)
    scene, state, impacts = orbit.scene, orbit.state, orbit.impacts
    x, v, phase = (float(np.asarray(each)) for each in (state.x, state.v, state.phase))
    late = phase / float(scene.frequency)
    rows = np.asarray(impacts.time) + late, np.asarray(impacts.speed), np.asarray(impacts.side, float)
    spot = OrbitPoint(float(scene.amplitude), *rows, orbit.periods, x, v, orbit.residual)
    along, z = place_orbit(scene, "amplitude", spot)
    if not len(spot.times):
        z = np.array([spot.x, spot.v, spot.value])
        along = along._replace(cycle=along.cycle._replace(phase=np.asarray(phase)))
    return float(largest(along, z[None])[0])
