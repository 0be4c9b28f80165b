"""Whether an orbit that was found at a value of the parameter lies on a branch."""

import numpy as np

from ..orbits.orbit_comparison import is_same_orbit
from ..problem import same_orbit
from ..problem.diagnostics import diagnose
from ..problem.equations import number_there
from ..problem.orbit_on_branch import impacts, place_orbit
from ..problem.orbit_rows import row_of, spot_of
from ..problem.orbit_start import bring_to

NEAR = 0.15  # of a branch's largest x and v: a state so near to its points is looked at more closely
ON = 1e-5  # of the largest speed: an orbit with impacts as near is on the branch
ENDLESS = 1e-4  # of the largest x and v: the same of one that rests, as a start has settled on it


def is_on(probe, branch):
    """Whether what a probe settled on is an orbit of a branch."""
    if branch.data.sizes["period"] != probe.spot.periods:
        return False
    gaps, points = branch.values - probe.spot.value, np.stack([branch.data[key].values for key in "xv"], axis=2)
    size = NEAR * abs(points).max()
    for place in np.flatnonzero(gaps[:-1] * gaps[1:] <= 0):
        if _is_near(probe, points[place : place + 2], size) and _is_there(probe, branch, place):
            return True
    return False


def _is_near(probe, points, size):
    """Whether a probe's states are as near to those of one of some points of a branch, counted from any period."""
    turns = [np.roll(row, k, axis=0) for row in points for k in range(len(row))]
    return any(abs(turn - probe.points).max() < size for turn in turns)


def _is_there(probe, branch, place):
    """Whether Newton's method leads from one of a branch's two points to the very orbit."""
    spots = (spot_of(row_of(branch.data, k), branch.name) for k in (place, place + 1))
    return any(settled_at(probe, *place_orbit(branch.scene, branch.name, spot)) is not None for spot in spots)


def settled_at(probe, along, z):
    """(along, z) at a probe's value, None where Newton's method does not come to its orbit from z."""
    found = bring_to(along, z, probe.spot.value)
    return (along, found.z) if found.met and _is_orbit(probe, along, found.z) else None


def _is_orbit(probe, along, z):
    if probe.endless:
        look, size = diagnose(along, z[None]), abs(probe.points).max()
        turned = np.roll(probe.points, 1, axis=0)  # the last is at phase 0 too
        return abs(np.stack([look.x[0], look.v[0]], 1) - turned).max() < ENDLESS * max(1.0, size)
    if not len(along.cycle.sides):
        return not len(probe.spot.times) and abs(z[:2] - probe.points[0]).max() < ON * max(1.0, abs(probe.points).max())
    pace = probe.spot.speeds.max(initial=0.0)
    theirs = impacts(probe.spot, number_there(along, z, "frequency"), pace)
    return is_same_orbit(same_orbit.impacts(along, z, pace), theirs, ON)
