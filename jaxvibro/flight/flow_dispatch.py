"""Dispatch on the flow: linear spring and damper, or user-defined force.

The modules `linear_flow` and `force_flow` have the same functions:

- for a step: `prepare_lookahead`, `motion_derivatives`, `forces_and_remainder`, `contact_forces_ahead`,
  `remainder_bound`, `advance_motion`,
- at a point of a motion: `acceleration_and_jerk`, `jet`, `jet_at_point`, `state_before_delay`, `contact_force`,
  `propagate_motion`,
- for flights of any duration: `fly`, `fly_with_matrix`, `propagate_with_matrix`, `flight_map`,
- and `chatter_bounds`, `sampling_time_scale`, `reverse_time`.

The constant `LINEAR` is True if the matrix of a flight does not depend on its initial state.
"""

from . import force_flow, linear_flow


def flow_of(coeffs):
    """Return the flow that the coefficients select.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.

    Returns
    -------
    module
        `linear_flow` or `force_flow`.
    """
    return linear_flow if coeffs.user_force is None else force_flow
