"""Check formulas of the paper, as printed, by comparison with computed numbers."""

import numpy as np

from ..flight.flow import flight_responses
from ..maps.monodromy import monodromy
from ..orbits.find import find_orbit
from ..scene.state import State
from . import closed_forms, integrator_accuracy, matrix_checks
from .claim import additional_claim, number_claim, statement_claim
from .figure_panels import FigureResult
from .special_points import ROUNDING, explore_twice, special_point_value

TIME_STEP = 1e-5  # time step of a difference quotient
START_STATE = State(0.9, -1.1)  # approaches P111
TOLERANCE = 1e-9
CAPTION = "Formulas, as printed in our copy of the paper."


def reproduce_formulas(scene_file, show_progress):
    """Check the formulas of the paper for the scene of a scene file; return the claims as a `FigureResult`."""
    scene = scene_file.scene.make()
    diagrams = explore_twice(scene, scene_file.explore)
    claims = [
        _damping_claim(),
        _grazing_claim(scene, diagrams),
        _fold_claim(scene, diagrams),
        _flow_matrix_claim(scene),
        *matrix_checks.matrix_claims(scene),
        *_multiplier_claims(scene),
    ]
    claims += integrator_accuracy.accuracy_claims(scene)
    return FigureResult(None, CAPTION, tuple(claims))


def _damping_claim():
    """Return the claim on the definition of gamma, from the decay rate of M X'' + C X' + K X = 0."""
    decay_rate = -float(np.roots([1.0, 0.1, 1.0]).real[0])
    reason = "Free oscillations decay like exp(-gamma t), so that gamma = C / (2 M w0)."
    return number_claim("(3)", "gamma = C / (M w0): M = K = 1, C = 0.1", "0.10", (decay_rate, 1e-15), reason)


def _grazing_claim(scene, diagrams):
    """Return the claim that P100 grazes at the amplitude of the closed form."""
    exact_amplitude = float(closed_forms.grazing_amplitude(float(scene.frequency), float(scene.damping)))
    located_amplitude, located_error = special_point_value(diagrams, "GR", "P100")
    claim_text = (
        f"P100 grazes at A = s sqrt(D), {exact_amplitude:.12g} at omega {float(scene.frequency):g}"
        " (located value minus this)"
    )
    return statement_claim(
        "(8)", claim_text, (located_amplitude - exact_amplitude, located_error), low=-TOLERANCE, high=TOLERANCE
    )


def _fold_claim(scene, diagrams):
    """Return the claim that the saddle-node of P111 lies at the amplitude of the formulas as printed."""
    located_fold = special_point_value(diagrams, "SN", "P111")
    exact_amplitude = float(
        closed_forms.symmetric_fold(*(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution")))[0]
    )
    reason = f"A denominator must be S sqrt(1 + C^2); our derivation gives {exact_amplitude:.12g}, as does simulation."
    return number_claim(
        "(19)", f"A_c at omega {float(scene.frequency):g}, as (12) to (19) are printed", "1.334", located_fold, reason
    )


def _flow_matrix_claim(scene):
    """Return the claim on the lower right entry of the matrix (22) of the free motion.

    The entry is computed as a difference quotient of the flow at time 0.
    """
    damping = float(scene.damping)
    (_, _, lower_right_entry), _ = flight_responses(
        *(np.float64(value) for value in (scene.frequency, damping, TIME_STEP))
    )
    entry_slope = (float(lower_right_entry) - 1.0) / TIME_STEP
    reason = "x'' = -x - 2 gamma x' + ...: the entry is -2 gamma, else energy would grow."
    claim_text = f"the lower right entry of (22) is +2 gamma, gamma {damping:g}"
    return number_claim("(22)", claim_text, f"{2.0 * damping:.2f}", (entry_slope, TIME_STEP), reason)


def _multiplier_claims(scene):
    """Yield the claims on the multipliers of an attractor and on the determinant of its monodromy matrix M."""
    orbit = find_orbit(scene, START_STATE)
    orbit_duration, damping = 2.0 * np.pi * orbit.periods / float(scene.frequency), float(scene.damping)
    larger_modulus, flight_modulus = abs(orbit.multipliers[0]), np.exp(-damping * orbit_duration)
    reason = f"They are those of M = Q P ... Q P; P alone has abs(eigenvalue) {flight_modulus:.6g}."
    claim_text = f"multipliers are eigenvalues of P, {orbit.label} (modulus of the larger minus that of P)"
    yield statement_claim(
        "(37)", claim_text, (float(larger_modulus - flight_modulus), 1e-9), low=-1e-6, high=1e-6, reason=reason
    )
    n_impacts = int(np.sum(np.asarray(orbit.impacts.side) != 0))
    determinant = float(np.linalg.det(np.asarray(monodromy(scene, orbit.state, orbit.periods))))
    formula_determinant = float(scene.restitution) ** (2 * n_impacts) * np.exp(-2.0 * damping * orbit_duration)
    claim_text = f"det M = R^(2 x impacts) exp(-2 gamma n T), {orbit.label} (difference)"
    yield additional_claim("(37)", claim_text, (abs(determinant - formula_determinant), ROUNDING), high=1e-12)
