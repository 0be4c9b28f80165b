"""Functions of a `protocols.Flow` that follow from the other functions of the flow.

They hold for a nonlinear flow. A flow takes from here those that it does not compute in a faster way.
"""

from ..compiled.lane_arithmetic import value_and_gradient
from . import flow
from .taylor_polynomials import evaluate_taylor


def acceleration_and_jerk(coeffs, x, v, cosine, sine, frame_force=(None, None)):
    """Return acceleration and jerk of a mass that does not stick to a wall."""
    return tuple(coeffs.flow.jet(coeffs, x, v, cosine, sine, 3)[2:])


def jet_at_point(coeffs, expansion_point, order, frame_force=()):
    """Return x and its derivatives up to order + 1 at a `taylor_polynomials.ExpansionPoint`."""
    phasor = expansion_point.cosine, expansion_point.sine
    return coeffs.flow.jet(coeffs, expansion_point.x, expansion_point.v, *phasor, order + 1)


def state_before_delay(coeffs, expansion_point, x, v, delay, order, frame_force=()):
    """Return x and v at a `taylor_polynomials.ExpansionPoint` of a flight that reaches x, v after a short delay."""
    end_phasor = flow.rotate_phasor_by_angle(expansion_point.cosine, expansion_point.sine, coeffs.frequency * delay)
    derivs = coeffs.flow.jet(coeffs, x, v, *end_phasor, order + 1)
    return evaluate_taylor(derivs, -delay, order), evaluate_taylor(derivs[1:], -delay, order)


def fly_with_matrix(coeffs, x, v, cosine, sine, time):
    """Return ((x, v) after a time, matrix of the flight as in `flow_matrix.apply_matrix`)."""

    def final_state(x, v):
        return coeffs.flow.fly(coeffs, x, v, cosine, sine, time)[:2]

    state, (final_x_gradient, final_v_gradient) = value_and_gradient(final_state, (x, v))
    return state, (final_x_gradient[0], final_x_gradient[1], final_v_gradient[1], final_v_gradient[0])


def matrix_state(x, v):
    """Return (x, v), on which the matrix of a flight depends."""
    return x, v


def propagate_with_matrix(coeffs, state, cosine, sine, time):
    """Return (state, cosine, sine, matrix of the flow by rows) after a time; `state` is (x, v)."""
    state, (p00, p01, p11, p10) = coeffs.flow.fly_with_matrix(coeffs, *state, cosine, sine, time)
    return state, *flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * time), (p00, p01, p10, p11)


def flight_map(coeffs, duration):
    """Return the map of (x, v, cosine, sine) over a fixed duration."""
    return lambda *state: coeffs.flow.fly(coeffs, *state, duration)
