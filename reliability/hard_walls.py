"""Measure sticking by restitution, and soft walls by stiffness: errors of the end of a period."""

import functools
import math

import numpy as np

from benchmarks import ours as soft_ours
from benchmarks import sides, truth
from benchmarks.work import draw, held

from . import exact_flow, failure_maps, methods
from .curves import Curves
from .exact_flow import LONG, Lanes
from .periods import Scenes

A, OMEGA, GAMMA, WALL, FAR = 0.8, 0.4, 0.05, 0.5, 50.0  # the contact force holds the mass unless A cos(theta) > WALL
RESTITUTIONS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75, 0.8])
ROOM = 400  # number of impacts after which a hop is below rounding
STIFFNESSES = 10.0 ** np.arange(1.0, 10.0)
STATES = 48


def released():
    """Return (x, v) at the end of the period after free flight from the release, in 80-bit floats."""
    angle = 2 * LONG(math.pi) - np.arccos(LONG(WALL) / LONG(A))
    left = (2 * LONG(math.pi) - angle) / LONG(OMEGA)
    lanes = Lanes(*(np.atleast_1d(np.asarray(each, LONG)) for each in (GAMMA, OMEGA, A, angle, WALL, 0.0)))
    return exact_flow.fly(lanes, left)


def error_of_rest(size):
    """Return the `Curves` of the error of the end of a period with complete chatter and release, by R."""
    bounces = np.array(size.few(list(RESTITUTIONS)))
    ones, (x, v) = np.ones(len(bounces)), released()
    given = Scenes(
        A * ones, OMEGA * ones, GAMMA * ones, bounces, WALL * ones, FAR * ones, WALL * ones + 0.2, 0.1 * ones
    )
    lines = {}
    for name, method in failure_maps.whole_methods(ROOM).items():
        end = method(given)
        lines[name] = bounces, np.maximum(abs(end.x - x), abs(end.v - v)).astype(float)
    return Curves(
        "A period with complete chatter, sticking and release",
        "restitution R",
        "error of x and v at the end",
        lines,
        least=1e-17,
        log_x=False,
        endless=f"shaded (heights without meaning): no end within {ROOM} impacts",
    )


def error_by_stiffness(size):
    """Return the `Curves` of the median error of the end of a period between soft walls, by their stiffness."""
    states, stiffnesses = draw(size.states(STATES)), np.array(size.few(list(STIFFNESSES)))
    chosen = ("heyoka, scalar", "diffrax Tsit5", "diffrax Kvaerno5", "SciPy RK45", "SciPy LSODA")
    lines = {}
    for k, stiffness in enumerate(stiffnesses):
        true = truth.find(states, stiffness)
        ways = {methods.OURS: soft_ours.prepare_batch(states, stiffness=stiffness, damping=held(stiffness))}
        for name in chosen:
            rival = sides.SOFT[name]
            for setting in (rival.settings[1], rival.settings[-1]):
                some = states[: max(4, len(states) // 4)]
                ways[f"{name} {setting:g}"] = functools.partial(rival.strobe, some, setting, stiffness=stiffness)
        for name, way in ways.items():
            answer = soft_ours.read(way()) if name == methods.OURS else way()[:2]
            verdict = truth.judge(np.asarray(answer[0]), None, true, far=math.inf)
            lines.setdefault(name, (stiffnesses, np.full(len(stiffnesses), np.nan)))[1][k] = verdict.median
    return Curves(
        "A period between soft walls with an effective restitution of 0.7",
        "stiffness k2 of the walls",
        "median error of x and v at the end",
        lines,
        least=1e-17,
    )
