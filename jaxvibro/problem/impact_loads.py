"""Compute the loads of impacts on walls: speeds and energy.

An impact at a rigid wall takes the energy (1 - R^2) u^2 / 2 in the frame of the wall, u being the speed before it
relative to the wall. Before the mass sticks, the impacts that are not recorded take the remaining energy (R u)^2 / 2.
Energies are in the unit K length^2, powers in K length^2 w0.
"""

import numpy as np

from ..maps.wall_loads import impact_energy_loss
from ..scene.codes import Contact

SIDE_SIGNS = {"left": -1, "right": 1}


def largest_speed(sides, speeds):
    """Return the largest speed before an impact at each point.

    Parameters
    ----------
    sides : ndarray
        Sides as in the data of a branch, array of shape (points, impacts).
    speeds : ndarray
        Speeds relative to the wall, array of shape (points, impacts).

    Returns
    -------
    ndarray
        Array of shape (points,), 0 without impacts.
    """
    return np.max(speeds, axis=1, initial=0.0, where=_are_impacts(sides))


def work_rate(sides, speeds, restitutions, duration):
    """Return the rate at which impacts take energy at each point.

    Parameters
    ----------
    sides : ndarray
        Sides as in the data of a branch, array of shape (points, impacts).
    speeds : ndarray
        Speeds relative to the wall, array of shape (points, impacts).
    restitutions : dict of str to ndarray
        Restitution of each wall, arrays of shape (points,), nan for soft walls.
    duration : ndarray
        Duration of each orbit, array of shape (points,).

    Returns
    -------
    ndarray
        Array of shape (points,), nan if a soft wall is hit, whose energy loss depends on the drive.
    """
    restitution = np.zeros(sides.shape)
    for side, sign in SIDE_SIGNS.items():
        if side in restitutions:
            restitution = np.where(np.sign(sides) == sign, restitutions[side][:, None], restitution)
    return (
        np.where(_are_impacts(sides), impact_energy_loss(speeds, restitution, _find_last_impacts(sides)), 0.0).sum(
            axis=1
        )
        / duration
    )


def _are_impacts(sides):
    return abs(sides) == Contact.LANDED


def _find_last_impacts(sides):
    """Mark the last recorded impacts before the mass sticks."""
    is_last = np.zeros(sides.shape, bool)
    for pattern in np.unique(sides, axis=0):
        impact_columns = np.flatnonzero(pattern)
        last_columns = impact_columns[abs(np.roll(pattern[impact_columns], -1)) >= Contact.STUCK]
        is_last[np.ix_((sides == pattern).all(axis=1), last_columns)] = True
    return is_last & _are_impacts(sides)
