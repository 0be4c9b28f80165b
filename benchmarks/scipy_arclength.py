"""Follow a branch of periodic orbits with SciPy: DOP853, finite differences, pseudo-arclength in A."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.scipy_ivp import passes
from benchmarks.work import CAP

TOLERANCE = 1e-9  # rtol and atol of the integrator
NEAR = 1e-8  # tolerance of the corrector's last step
# The error of a central difference is smallest, about 1e-8, for steps from 1e-6 to 1e-4. The longest of these is best
# where the integrator rejects a step on one side only, so that its error jumps.
PROBE = 1e-4
TRIES, FEW = 8, 4  # largest number of maps of the corrector; number up to which the step grows
GROWTH, LONGEST, SHORTEST = 1.3, 4.0, 1e-4  # growth of the step; its limits relative to the first step
# Distance of returns from which the corrector starts; largest number of drive periods before.
SETTLED, MOST = 1e-3, 1000
FREE = np.array([0.0, 0.0, 1.0])  # the direction of A


class Point(NamedTuple):
    """Point (x, v, A) of the branch, the (2, 3) derivatives of the map, and the unit tangent of the branch."""

    place: np.ndarray
    slopes: np.ndarray
    tangent: np.ndarray


def branch(points, amplitude=2.0, omega=2.1, gamma=0.05, restitution=0.7, step=0.05):
    """Follow the orbit that (0.9, -1.1) approaches, by default P111, to larger amplitudes, with walls at -1 and 1.

    Pseudo-arclength continuation (Keller 1977) of the fixed points of the map over one drive period.
    points: number of points, including the first. step: arclength in (x, v, A) to the second point; it adapts from
    there. Returns values (points,), the amplitudes; states (points, 2), x and v at phase 0; multipliers (points, 2),
    complex. Raises RuntimeError if no orbit is approached or the step becomes too short: a grazing, an impact at phase
    0.
    """
    strobe = stroboscopic(omega, gamma, restitution)
    found, length = [start(strobe, amplitude)], step
    while len(found) < points:
        place, maps = correct(strobe, found[-1], length)
        if place is None:
            length *= 0.5
            if length < SHORTEST * step:
                raise RuntimeError(f"the branch is lost after {len(found)} points at A = {found[-1].place[2]:.6g}")
            continue
        found.append(survey(strobe, place, found[-1].tangent))
        if maps <= FEW:
            length = min(GROWTH * length, LONGEST * step)
    places = np.array([point.place for point in found])
    return places[:, 2], places[:, :2], np.array([eigenvalues(point.slopes) for point in found])


def stroboscopic(omega, gamma, restitution, sides=(-1, 1), periods=1) -> Callable[[np.ndarray], np.ndarray]:
    """Make the map of x, v, A to x and v some drive periods after phase 0, nan beyond a wall or after CAP impacts.

    `sides` are those of the walls, at -1 and 1.
    """
    length, walls = 2 * math.pi * periods / omega, [passes(side, 1.0) for side in sides]

    def field(t, y, amplitude):
        return y[1], amplitude * math.cos(omega * t) - y[0] - 2 * gamma * y[1]

    def strobe(place):
        x, v, amplitude = place
        if any(side * x > 1.0 for side in sides):
            return np.full(2, np.nan)
        time, y, given = 0.0, (x, v), {"rtol": TOLERANCE, "atol": TOLERANCE, "args": (amplitude,)}
        for _ in range(CAP):
            flight = solve_ivp(field, (time, length), y, "DOP853", events=walls, **given)
            time, y = flight.t[-1], flight.y[:, -1]
            if flight.status != 1:
                return y
            y = (math.copysign(1.0, y[0]), -restitution * y[1])
        return np.full(2, np.nan)

    return strobe


def start(strobe, amplitude):
    """Return the Point that the state (0.9, -1.1) approaches."""
    state = np.array([0.9, -1.1])
    for _ in range(MOST):
        last, state = state, strobe((*state, amplitude))
        if abs(state - last).max() < SETTLED:
            break
    settled = np.array([*state, amplitude])
    # In the direction of A the corrector's plane is that of the requested amplitude; the step length is 0.
    place, _ = correct(strobe, Point(settled, differences(strobe, settled), FREE), 0.0)
    if place is None:
        raise RuntimeError(f"no orbit of one period is settled on at A = {amplitude:g}")
    return survey(strobe, place, FREE)


def correct(strobe, base, length):
    """Compute the orbit in the plane perpendicular to the tangent at a length from a Point.

    Returns its x, v, A, or None on failure, and the number of maps. Newton's method starts with the Jacobian at the
    base and updates it by Broyden's formula: with new differences at every iterate the branch takes nearly twice as
    many maps.
    """
    guess = base.place + length * base.tangent
    matrix, place = np.vstack([base.slopes - np.eye(2, 3), base.tangent]), guess
    move = None
    for maps in range(1, TRIES + 1):
        residual = np.append(strobe(place) - place[:2], base.tangent @ (place - guess))
        if not np.isfinite(residual).all():
            break
        if move is not None:
            matrix = matrix + np.outer(residual, move) / (move @ move)
        move = np.linalg.solve(matrix, -residual)
        place = place + move
        if abs(move).max() < NEAR:
            return place, maps
    return None, maps


def survey(strobe, place, before):
    """Return the Point at a solution, with a tangent within a right angle of the previous one."""
    slopes = differences(strobe, place)
    tangent = np.cross(*(slopes - np.eye(2, 3)))
    tangent *= math.copysign(1.0, tangent @ before) / np.linalg.norm(tangent)
    return Point(place, slopes, tangent)


def differences(strobe, place):
    """Compute the (2, 3) derivatives of the map by central differences."""
    probes = PROBE * np.eye(3)
    return np.column_stack([strobe(place + probe) - strobe(place - probe) for probe in probes]) / (2 * PROBE)


def eigenvalues(slopes):
    """Compute the Floquet multipliers, complex, in descending order."""
    values = np.linalg.eigvals(slopes[:, :2]).astype(complex)
    return values[np.argsort(-abs(values), kind="stable")]
