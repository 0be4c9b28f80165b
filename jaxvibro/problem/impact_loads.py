"""Compute the loads of impacts on walls: speeds and energies.

A rigid wall takes the energy (1 - R^2) u^2 / 2 in the frame of the wall, where u is the relative speed before the
impact. Before the mass sticks, the impacts after the last recorded impact take the remaining energy (R u)^2 / 2.
Energies have the unit K length^2, and powers have the unit K length^2 w0, where K is the stiffness of the spring and w0
is the natural frequency.
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


def work_rate(sides, speeds, restitutions, orbit_duration):
    """Return the mean power that the walls take at impacts, for each point.

    Parameters
    ----------
    sides : ndarray
        Sides as in the data of a branch, array of shape (points, impacts).
    speeds : ndarray
        Speeds relative to the wall, array of shape (points, impacts).
    restitutions : dict of str to ndarray
        Restitution of each wall, arrays of shape (points,), nan for soft walls.
    orbit_duration : ndarray
        Duration of each orbit, array of shape (points,).

    Returns
    -------
    ndarray
        Array of shape (points,), nan if an impact is on a soft wall, because the energy loss does not follow
        from the speed and the restitution.
    """
    restitution = np.zeros(sides.shape)
    for side, wall_sign in SIDE_SIGNS.items():
        if side in restitutions:
            restitution = np.where(np.sign(sides) == wall_sign, restitutions[side][:, None], restitution)
    return (
        np.where(_are_impacts(sides), impact_energy_loss(speeds, restitution, _are_last_impacts(sides)), 0.0).sum(
            axis=1
        )
        / orbit_duration
    )


def _are_impacts(sides):
    return abs(sides) == Contact.LANDED


def _are_last_impacts(sides):
    """Mark the last recorded impacts before the mass sticks."""
    is_last_before_sticking = np.zeros(sides.shape, bool)
    for side_pattern in np.unique(sides, axis=0):
        impact_column_indices = np.flatnonzero(side_pattern)
        last_impact_indices = impact_column_indices[
            abs(np.roll(side_pattern[impact_column_indices], -1)) >= Contact.STUCK
        ]
        is_last_before_sticking[np.ix_((sides == side_pattern).all(axis=1), last_impact_indices)] = True
    return is_last_before_sticking & _are_impacts(sides)
