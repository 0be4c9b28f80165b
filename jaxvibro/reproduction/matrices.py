"""Compare the matrices of the paper for a flight and an impact, (24) and (35), with the derivative of the strobe."""

import jax
import numpy as np

from ..maps.one_period import REPLAY_SLOTS
from ..maps.strobe import strobe
from ..scene.scene import make_scene
from ..scene.state import State
from ..scene.wall import Motion, Wall
from .claim import statement_claim
from .special_points import ROUNDING

AMPLITUDE = 6.0  # with several impacts per period
START_STATES = (State(0.9, -1.1), State(0.0, 3.0), State(-0.5, -2.0))
WALL_MOTION = (0.1, 0.5)  # amplitude and phase of the moving wall
TOLERANCE = 1e-9


def matrix_claims(scene):
    """Yield the claims on Q as the factor of an impact and on its determinant, for fixed walls and a moving one."""
    params = [AMPLITUDE, *(float(getattr(scene, key)) for key in ("frequency", "damping", "restitution"))]
    moving_wall = Wall(float(scene.right.position), motion=Motion(*WALL_MOTION))
    moving_scene = make_scene(*params, (float(scene.left.position), moving_wall))
    differences, determinant_errors, n_impacts = [], [], 0
    for tested_scene, motion in ((scene.replace(amplitude=AMPLITUDE), (0.0, 0.0)), (moving_scene, WALL_MOTION)):
        for start in START_STATES:
            jacobian = _strobe_jacobian(tested_scene, start)
            flight_matrices, impact_matrices = _matrix_factors(params, tested_scene, start, motion)
            product = flight_matrices[0]
            for impact_matrix, flight_matrix in zip(impact_matrices, flight_matrices[1:], strict=True):
                product = flight_matrix @ impact_matrix @ product
            differences.append(abs(product - jacobian).max() / abs(jacobian).max())
            impact_determinant = np.linalg.det(jacobian) / np.prod(
                [np.linalg.det(flight_matrix) for flight_matrix in flight_matrices]
            )
            determinant_errors.append(abs(impact_determinant ** (1.0 / len(impact_matrices)) - params[-1] ** 2))
            n_impacts += len(impact_matrices)
    impacts_text = f"{n_impacts} impacts, on fixed walls and a moving one"
    text = (
        f"Q as in (35), in M = P Q P ... P: {impacts_text} (largest relative difference to the derivative of"
        " the strobe)"
    )
    yield statement_claim("(35)", text, (float(max(differences)), ROUNDING), high=TOLERANCE)
    text = (
        f"det Q = R^2: {impacts_text} (from the determinants of the strobe's derivative and of P; largest difference)"
    )
    yield statement_claim("(35)", text, (float(max(determinant_errors)), ROUNDING), high=TOLERANCE)


def _strobe_jacobian(scene, start):
    """Return the derivative of the strobe with respect to x and v in forward mode, of shape (2, 2)."""
    derivative = jax.jacfwd(lambda x, v: strobe(scene, State(x, v))[0], (0, 1))(start.x, start.v)
    return np.array([[float(entry) for entry in row] for row in (derivative.x, derivative.v)])


def _matrix_factors(params, scene, start, motion):
    """Return (P of each flight in a drive period, Q of each impact between them)."""
    _, frequency, damping, _ = params
    _, impacts = strobe(scene, start, slots=REPLAY_SLOTS)
    is_impact = np.asarray(impacts.side) != 0
    times, speeds, sides = (np.asarray(column)[is_impact] for column in (impacts.time, impacts.speed, impacts.side))
    durations = np.diff(np.concatenate([[0.0], times, [2.0 * np.pi / frequency]]))
    flight_matrices = [_flight_matrix(damping, duration) for duration in durations]
    return flight_matrices, [
        _impact_matrix(params, *impact, motion) for impact in zip(times, speeds, sides.astype(float), strict=True)
    ]


def _flight_matrix(damping, duration):
    """Return P of (24)."""
    damped_frequency = np.sqrt(1.0 - damping**2)
    sine, cosine = np.sin(damped_frequency * duration), damped_frequency * np.cos(damped_frequency * duration)
    matrix = [[damping * sine + cosine, sine], [-sine, cosine - damping * sine]]
    return np.exp(-damping * duration) / damped_frequency * np.array(matrix)


def _impact_matrix(params, time, speed, side, motion):
    """Return Q of (35); the right wall is at 1 + B cos(omega t + phase), the left one at -1."""
    (amplitude, frequency, damping, restitution), (wall_amplitude, phase) = params, motion
    wall_amplitude, angle = wall_amplitude * (side > 0), frequency * time + phase
    displacement, wall_velocity, wall_acceleration = wall_amplitude * np.array(
        [np.cos(angle), -frequency * np.sin(angle), -(frequency**2) * np.cos(angle)]
    )
    driving_force = amplitude * np.cos(frequency * time) - (side + displacement)
    acceleration_before, acceleration_after = (
        driving_force - 2.0 * damping * (wall_velocity + side * contact_speed)
        for contact_speed in (speed, -restitution * speed)
    )
    lower_left = (acceleration_after + restitution * acceleration_before - (1.0 + restitution) * wall_acceleration) / (
        side * speed
    )
    return np.array([[-restitution, 0.0], [lower_left, -restitution]])
