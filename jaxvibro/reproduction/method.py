"""The paper's method of integration: what a contact bracketed to 1e-6 of a step leaves of a strobe."""

import numpy as np

from ..maps.strobe import strobe
from ..scene.state import State
from .claim import own, statement
from .stepped import BRACKET, ROOM, Drive
from .stepped import strobe as stepped

STARTS, STEPS = 4096, (100, 400, 1600)  # the steps in a period are not printed
FINE = 1e-12  # of a step: a bracket that leaves the integrator's own error


def claims(scene):
    """How near the contacts are, and what error that leaves of a strobe, in a scene with walls at -1 and 1."""
    draw = np.random.default_rng(0)
    low, high = [-1.0, -3.0, 0.0], [1.0, 3.0, 6.0]
    states = draw.uniform(low, high, (STARTS, len(low)))
    end, impacts = strobe(scene.replace(amplitude=states[:, 2]), State(states[:, 0], states[:, 1]), slots=ROOM)
    exact, sides = np.stack([np.asarray(end.x), np.asarray(end.v)], axis=1), np.asarray(impacts.side)
    drive = Drive(*(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution")))
    found = [[stepped(drive, states, steps, bracket) for bracket in (BRACKET, FINE)] for steps in STEPS]
    yield _bracketed(found, 2.0 * np.pi / drive.frequency)
    errors = np.array([[_error(one, exact, sides) for one in pair] for pair in found])
    told = "; ".join(
        f"{steps} steps a period: {coarse:.2g}, the integrator alone {fine:.2g}"
        for steps, (coarse, fine) in zip(STEPS, errors, strict=True)
    )
    order = np.log(errors[-2, 0] / errors[-1, 0]) / np.log(STEPS[-1] / STEPS[-2])
    text = f"that bracket makes a strobe's error fall like the step, not like its fourth power: {told} (order)"
    yield own("method", text, (float(order), 0.1), low=0.8, high=1.2)


def _bracketed(found, period):
    """How far the first contacts are from the integrator's own, in steps."""
    gaps = []
    for (coarse, fine), steps in zip(found, STEPS, strict=True):
        met = (coarse.sides[:, 0] == fine.sides[:, 0]) & (coarse.sides[:, 0] != 0)
        gaps.append(abs(coarse.times[met, 0] - fine.times[met, 0]).max() * steps / period)
    told = ", ".join(f"{steps}" for steps in STEPS)
    text = (
        f"a contact is bracketed to 1e-6 of a step (first contacts of {STARTS} starts, {told} steps a period; the "
        "farthest from where the integrator crosses the wall, in steps)"
    )
    return statement("method", text, (float(max(gaps)), 2.0 * FINE), high=BRACKET)


def _error(found, exact, sides):
    """The median error of the states after a period, of those that hit the walls that they should, once at least."""
    count = min(sides.shape[1], found.sides.shape[1])
    same = (found.sides[:, :count] == sides[:, :count]).all(axis=1) & (sides[:, 0] != 0)
    return float(np.median(abs(found.ends - exact)[same].max(axis=1)))
