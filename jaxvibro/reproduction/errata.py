"""Formulas of the paper as our copy reads, beside what they should say. No figure: numbers alone."""

import numpy as np

from ..flight.flow import responses
from ..maps.monodromy import monodromy
from ..orbits.find import find_orbit
from ..scene.state import State
from . import closed, matrices, method
from .claim import number, own, statement
from .located import ROUNDING, twice, value
from .panels import Drawn

STEP = 1e-5  # in time, of a derivative by differences
START = State(0.9, -1.1)  # settles on P111
SAME = 1e-9
CAPTION = "Formulas, as our copy of the paper reads."


def drawn(file, progress):
    """The claims on formulas, in the scene of a file."""
    scene = file.scene.make()
    pair = twice(scene, file.explore)
    claims = [
        _ratio(),
        _grazing(scene, pair),
        _fold(scene, pair),
        _corner(scene),
        *matrices.claims(scene),
        *_orbit(scene),
    ]
    claims += method.claims(scene)
    return Drawn(None, CAPTION, tuple(claims))


def _ratio():
    """The damping, by how fast M X'' + C X' + K X = 0 decays for M = K = 1, C = 0.1."""
    decay = -float(np.roots([1.0, 0.1, 1.0]).real[0])
    reason = "Free oscillations decay like exp(-gamma t), so that gamma = C / (2 M w0)."
    return number("(3)", "gamma = C / (M w0): M = K = 1, C = 0.1", "0.10", (decay, 1e-15), reason)


def _grazing(scene, pair):
    """Where P100 grazes."""
    exact = float(closed.grazing(float(scene.frequency), float(scene.damping)))
    found, error = value(pair, "GR", "P100")
    text = f"P100 grazes at A = s sqrt(D), {exact:.12g} at omega {float(scene.frequency):g} (located less that)"
    return statement("(8)", text, (found - exact, error), low=-SAME, high=SAME)


def _fold(scene, pair):
    """The saddle-node of P111, located, beside the closed form as it reads."""
    found = value(pair, "SN", "P111")
    exact = float(
        closed.symmetric_fold(*(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution")))[0]
    )
    reason = f"A denominator is to be S sqrt(1 + C^2); our own derivation gives {exact:.12g}, and so says simulation."
    return number("(19)", f"A_c at omega {float(scene.frequency):g}, as (12) to (19) read", "1.334", found, reason)


def _corner(scene):
    """The lower right entry of the free motion's matrix: the slope at time 0 of that entry of the flow."""
    damping = float(scene.damping)
    (_, _, ahead), _ = responses(*(np.float64(each) for each in (scene.frequency, damping, STEP)))
    slope = (float(ahead) - 1.0) / STEP
    reason = "x'' = -x - 2 gamma x' + ...: the entry is -2 gamma, else energy would grow."
    text = f"the lower right entry of (22) is +2 gamma, gamma {damping:g}"
    return number("(22)", text, f"{2.0 * damping:.2f}", (slope, STEP), reason)


def _orbit(scene):
    """Whose eigenvalues the multipliers are, and the determinant of M, on the motion that lasts."""
    orbit = find_orbit(scene, START)
    length, damping = 2.0 * np.pi * orbit.periods / float(scene.frequency), float(scene.damping)
    larger, free = abs(orbit.multipliers[0]), np.exp(-damping * length)
    reason = f"They are those of M = Q P ... Q P; P alone has abs(eigenvalue) {free:.6g}."
    text = f"multipliers are eigenvalues of P, {orbit.label} (the larger less that of P)"
    yield statement("(37)", text, (float(larger - free), 1e-9), low=-1e-6, high=1e-6, reason=reason)
    impacts = int(np.sum(np.asarray(orbit.impacts.side) != 0))
    found = float(np.linalg.det(np.asarray(monodromy(scene, orbit.state, orbit.periods))))
    exact = float(scene.restitution) ** (2 * impacts) * np.exp(-2.0 * damping * length)
    text = f"det M = R^(2 x impacts) exp(-2 gamma n T), {orbit.label} (difference)"
    yield own("(37)", text, (abs(found - exact), ROUNDING), high=1e-12)
