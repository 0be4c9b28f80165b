"""Check formulas and matrices of the paper, as printed, by comparison with computed numbers."""

import jax
import numpy as np

from ..flight.flow import flight_responses
from ..maps.monodromy import monodromy
from ..maps.reference_strobe import REPLAY_SLOTS
from ..maps.strobe import strobe
from ..orbits.find import find_orbit
from ..scene.scene import Motion, Wall, make_scene
from ..scene.state import State
from . import closed_forms, fixed_step
from .claim import additional_claim, number_claim, statement_claim
from .figure_panels import FigureResult
from .special_points import ROUNDING, explore_twice, special_point_value

AMPLITUDE = 6.0  # with several impacts per period
START_STATES = (State(0.9, -1.1), State(0.0, 3.0), State(-0.5, -2.0))
WALL_MOTION = (0.1, 0.5)  # amplitude and phase of the moving wall
TOLERANCE = 1e-9


def matrix_claims(scene):
    """Yield the claims on the matrix Q of an impact and on its determinant, for fixed walls and a moving wall."""
    scene_param_values = [AMPLITUDE, *(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution"))]
    moving_wall = Wall(float(scene.right.position), motion=Motion(*WALL_MOTION))
    moving_scene = make_scene(*scene_param_values, (float(scene.left.position), moving_wall))
    matrix_differences, determinant_errors, n_impacts = [], [], 0
    for tested_scene, wall_motion in ((scene.replace(amplitude=AMPLITUDE), (0.0, 0.0)), (moving_scene, WALL_MOTION)):
        for initial_state in START_STATES:
            strobe_jacobian = _strobe_jacobian(tested_scene, initial_state)
            flight_matrices, impact_matrices = _flight_impact_matrices(
                scene_param_values, tested_scene, initial_state, wall_motion
            )
            matrix_product = flight_matrices[0]
            for impact_matrix, flight_matrix in zip(impact_matrices, flight_matrices[1:], strict=True):
                matrix_product = flight_matrix @ impact_matrix @ matrix_product
            matrix_differences.append(abs(matrix_product - strobe_jacobian).max() / abs(strobe_jacobian).max())
            impact_det_product = np.linalg.det(strobe_jacobian) / np.prod(
                [np.linalg.det(flight_matrix) for flight_matrix in flight_matrices]
            )
            determinant_errors.append(
                abs(impact_det_product ** (1.0 / len(impact_matrices)) - scene_param_values[-1] ** 2)
            )
            n_impacts += len(impact_matrices)
    impacts_text = f"{n_impacts} impacts, on fixed walls and a moving one"
    claim_text = (
        f"Q as in (35), in M = P Q P ... P: {impacts_text} (largest relative difference to the derivative of"
        " the strobe)"
    )
    yield statement_claim("(35)", claim_text, (float(max(matrix_differences)), ROUNDING), high=TOLERANCE)
    claim_text = (
        f"det Q = R^2: {impacts_text} (from the determinants of the strobe's derivative and of P; largest difference)"
    )
    yield statement_claim("(35)", claim_text, (float(max(determinant_errors)), ROUNDING), high=TOLERANCE)


def _strobe_jacobian(scene, initial_state):
    """Return the derivative of the stroboscopic map with respect to x and v, shape (2, 2), in forward mode."""
    state_derivative = jax.jacfwd(lambda x, v: strobe(scene, State(x, v))[0], (0, 1))(initial_state.x, initial_state.v)
    return np.array([[float(entry) for entry in row] for row in (state_derivative.x, state_derivative.v)])


def _flight_impact_matrices(scene_param_values, scene, initial_state, wall_motion):
    """Return the matrices of a drive period: (P of each flight, Q of each impact)."""
    _, frequency, damping, _ = scene_param_values
    _, impacts = strobe(scene, initial_state, slots=REPLAY_SLOTS)
    is_impact = np.asarray(impacts.side) != 0
    times, speeds, sides = (
        np.asarray(impact_field_array)[is_impact] for impact_field_array in (impacts.time, impacts.speed, impacts.side)
    )
    flight_durations = np.diff(np.concatenate([[0.0], times, [2.0 * np.pi / frequency]]))
    flight_matrices = [_flight_matrix(damping, flight_duration) for flight_duration in flight_durations]
    return flight_matrices, [
        _impact_matrix(scene_param_values, *impact_fields, wall_motion)
        for impact_fields in zip(times, speeds, sides.astype(float), strict=True)
    ]


def _flight_matrix(damping, duration):
    """Return the matrix P of a flight (equation 24)."""
    damped_frequency = np.sqrt(1.0 - damping**2)
    damped_sine, scaled_cosine = (
        np.sin(damped_frequency * duration),
        damped_frequency * np.cos(damped_frequency * duration),
    )
    scaled_matrix = [
        [damping * damped_sine + scaled_cosine, damped_sine],
        [-damped_sine, scaled_cosine - damping * damped_sine],
    ]
    return np.exp(-damping * duration) / damped_frequency * np.array(scaled_matrix)


def _impact_matrix(scene_param_values, impact_time, impact_speed, wall_side, wall_motion):
    """Return the matrix Q of an impact (equation 35).

    The right wall is at 1 + B cos(omega t + phase), and the left wall is at -1.
    """
    (amplitude, frequency, damping, restitution), (wall_amplitude, wall_phase) = scene_param_values, wall_motion
    wall_amplitude, wall_angle = wall_amplitude * (wall_side > 0), frequency * impact_time + wall_phase
    wall_displacement, wall_velocity, wall_acceleration = wall_amplitude * np.array(
        [np.cos(wall_angle), -frequency * np.sin(wall_angle), -(frequency**2) * np.cos(wall_angle)]
    )
    net_force = amplitude * np.cos(frequency * impact_time) - (wall_side + wall_displacement)
    acceleration_before, acceleration_after = (
        net_force - 2.0 * damping * (wall_velocity + wall_side * contact_speed)
        for contact_speed in (impact_speed, -restitution * impact_speed)
    )
    lower_left_entry = (
        acceleration_after + restitution * acceleration_before - (1.0 + restitution) * wall_acceleration
    ) / (wall_side * impact_speed)
    return np.array([[-restitution, 0.0], [lower_left_entry, -restitution]])


TIME_STEP = 1e-5  # time step of a difference quotient
START_STATE = State(0.9, -1.1)  # approaches P111
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
        *matrix_claims(scene),
        *_multiplier_claims(scene),
    ]
    claims += fixed_step.accuracy_claims(scene)
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
