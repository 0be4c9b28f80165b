"""The paper's matrices of a flight and of an impact, (24) and (35), beside the derivative of the strobe."""

import jax
import numpy as np

from ..maps.one_period import SLOTS
from ..maps.strobe import strobe
from ..scene.scene import make_scene
from ..scene.state import State
from ..scene.wall import Motion, Wall
from .claim import statement
from .located import ROUNDING

AMPLITUDE = 6.0  # at which a period has several impacts
STARTS = (State(0.9, -1.1), State(0.0, 3.0), State(-0.5, -2.0))
MOTION = (0.1, 0.5)  # amplitude and phase of the wall that moves
SAME = 1e-9


def claims(scene):
    """Q as the factor of an impact, and its determinant, between walls that rest and one that moves."""
    numbers = [AMPLITUDE, *(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution"))]
    right = Wall(float(scene.right.position), motion=Motion(*MOTION))
    moving = make_scene(*numbers, (float(scene.left.position), right))
    gaps, roots, count = [], [], 0
    for one, motion in ((scene.replace(amplitude=AMPLITUDE), (0.0, 0.0)), (moving, MOTION)):
        for start in STARTS:
            exact = _derivative(one, start)
            frees, hits = _factors(numbers, one, start, motion)
            product = frees[0]
            for hit, free in zip(hits, frees[1:], strict=True):
                product = free @ hit @ product
            gaps.append(abs(product - exact).max() / abs(exact).max())
            inside = np.linalg.det(exact) / np.prod([np.linalg.det(free) for free in frees])
            roots.append(abs(inside ** (1.0 / len(hits)) - numbers[-1] ** 2))
            count += len(hits)
    told = f"{count} impacts, on walls that rest and one that moves"
    text = f"Q as in (35), in M = P Q P ... P: {told} (largest relative difference to the derivative of the strobe)"
    yield statement("(35)", text, (float(max(gaps)), ROUNDING), high=SAME)
    text = f"det Q = R^2: {told} (from the determinants of the strobe's derivative and of P; largest difference)"
    yield statement("(35)", text, (float(max(roots)), ROUNDING), high=SAME)


def _derivative(scene, start):
    """The derivative of the strobe by x and v, by forward mode, (2, 2)."""
    found = jax.jacfwd(lambda x, v: strobe(scene, State(x, v))[0], (0, 1))(start.x, start.v)
    return np.array([[float(each) for each in part] for part in (found.x, found.v)])


def _factors(numbers, scene, start, motion):
    """(the P of each flight of a drive period, the Q of each impact between)."""
    _, w, damping, _ = numbers
    _, impacts = strobe(scene, start, slots=SLOTS)
    hit = np.asarray(impacts.side) != 0
    times, speeds, sides = (np.asarray(part)[hit] for part in (impacts.time, impacts.speed, impacts.side))
    spans = np.diff(np.concatenate([[0.0], times, [2.0 * np.pi / w]]))
    frees = [_free(damping, span) for span in spans]
    return frees, [_hit(numbers, *one, motion) for one in zip(times, speeds, sides.astype(float), strict=True)]


def _free(damping, span):
    """P of (24)."""
    root = np.sqrt(1.0 - damping**2)
    sine, cosine = np.sin(root * span), root * np.cos(root * span)
    whole = [[damping * sine + cosine, sine], [-sine, cosine - damping * sine]]
    return np.exp(-damping * span) / root * np.array(whole)


def _hit(numbers, time, speed, side, motion):
    """Q of (35); the right wall stands at 1 + B cos(omega t + phase), the left one at -1."""
    (force, w, damping, bounce), (swing, phase) = numbers, motion
    swing, angle = swing * (side > 0), w * time + phase
    place, pace, pull = swing * np.array([np.cos(angle), -w * np.sin(angle), -(w**2) * np.cos(angle)])
    drive = force * np.cos(w * time) - (side + place)
    before, after = (drive - 2.0 * damping * (pace + side * each) for each in (speed, -bounce * speed))
    lower = (after + bounce * before - (1.0 + bounce) * pull) / (side * speed)
    return np.array([[-bounce, 0.0], [lower, -bounce]])
