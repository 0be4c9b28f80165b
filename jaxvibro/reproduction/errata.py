"""Compare formulas of the paper, as printed, with the correct ones, by numbers alone."""

import numpy as np

from ..flight.flow import flight_responses
from ..maps.monodromy import monodromy
from ..orbits.find import find_orbit
from ..scene.state import State
from . import closed_forms, integration_method, matrices
from .claim import number_claim, own_claim, statement_claim
from .panels import FigureResult
from .special_points import ROUNDING, explore_twice, special_value

TIME_STEP = 1e-5  # time step of a difference quotient
START_STATE = State(0.9, -1.1)  # approaches P111
TOLERANCE = 1e-9
CAPTION = "Formulas, as printed in our copy of the paper."


def reproduce_formulas(file, progress):
    """Return the claims on formulas, in the scene of a file."""
    scene = file.scene.make()
    diagrams = explore_twice(scene, file.explore)
    claims = [
        _damping_claim(),
        _grazing_claim(scene, diagrams),
        _fold_claim(scene, diagrams),
        _flow_entry_claim(scene),
        *matrices.matrix_claims(scene),
        *_multiplier_claims(scene),
    ]
    claims += integration_method.method_claims(scene)
    return FigureResult(None, CAPTION, tuple(claims))


def _damping_claim():
    """Return the claim on the damping, from the decay of M X'' + C X' + K X = 0 for M = K = 1, C = 0.1."""
    decay = -float(np.roots([1.0, 0.1, 1.0]).real[0])
    reason = "Free oscillations decay like exp(-gamma t), so that gamma = C / (2 M w0)."
    return number_claim("(3)", "gamma = C / (M w0): M = K = 1, C = 0.1", "0.10", (decay, 1e-15), reason)


def _grazing_claim(scene, diagrams):
    """Return the claim on the grazing of P100."""
    exact_amplitude = float(closed_forms.grazing_amplitude(float(scene.frequency), float(scene.damping)))
    located_amplitude, error = special_value(diagrams, "GR", "P100")
    text = (
        f"P100 grazes at A = s sqrt(D), {exact_amplitude:.12g} at omega {float(scene.frequency):g}"
        " (located value minus this)"
    )
    return statement_claim("(8)", text, (located_amplitude - exact_amplitude, error), low=-TOLERANCE, high=TOLERANCE)


def _fold_claim(scene, diagrams):
    """Return the claim that the saddle-node of P111 lies at the closed form as printed."""
    located_fold = special_value(diagrams, "SN", "P111")
    exact_amplitude = float(
        closed_forms.symmetric_fold(*(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution")))[0]
    )
    reason = f"A denominator must be S sqrt(1 + C^2); our derivation gives {exact_amplitude:.12g}, as does simulation."
    return number_claim(
        "(19)", f"A_c at omega {float(scene.frequency):g}, as (12) to (19) are printed", "1.334", located_fold, reason
    )


def _flow_entry_claim(scene):
    """Return the claim on the lower right entry of the matrix of the free motion, a slope of the flow at time 0."""
    damping = float(scene.damping)
    (_, _, entry), _ = flight_responses(*(np.float64(value) for value in (scene.frequency, damping, TIME_STEP)))
    slope = (float(entry) - 1.0) / TIME_STEP
    reason = "x'' = -x - 2 gamma x' + ...: the entry is -2 gamma, else energy would grow."
    text = f"the lower right entry of (22) is +2 gamma, gamma {damping:g}"
    return number_claim("(22)", text, f"{2.0 * damping:.2f}", (slope, TIME_STEP), reason)


def _multiplier_claims(scene):
    """Yield the claims on the multipliers and on the determinant of M, on an attractor."""
    orbit = find_orbit(scene, START_STATE)
    duration, damping = 2.0 * np.pi * orbit.periods / float(scene.frequency), float(scene.damping)
    larger_multiplier, flight_multiplier = abs(orbit.multipliers[0]), np.exp(-damping * duration)
    reason = f"They are those of M = Q P ... Q P; P alone has abs(eigenvalue) {flight_multiplier:.6g}."
    text = f"multipliers are eigenvalues of P, {orbit.label} (modulus of the larger minus that of P)"
    yield statement_claim(
        "(37)", text, (float(larger_multiplier - flight_multiplier), 1e-9), low=-1e-6, high=1e-6, reason=reason
    )
    n_impacts = int(np.sum(np.asarray(orbit.impacts.side) != 0))
    determinant = float(np.linalg.det(np.asarray(monodromy(scene, orbit.state, orbit.periods))))
    exact_determinant = float(scene.restitution) ** (2 * n_impacts) * np.exp(-2.0 * damping * duration)
    text = f"det M = R^(2 x impacts) exp(-2 gamma n T), {orbit.label} (difference)"
    yield own_claim("(37)", text, (abs(determinant - exact_determinant), ROUNDING), high=1e-12)
