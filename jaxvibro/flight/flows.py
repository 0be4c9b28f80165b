"""Dispatch on the flow: linear spring and damper, or user-defined force.

The modules `linear_flow` and `force_flow` have the same functions:

- for a step: `look_ahead`, `event_derivatives`, `lookahead_bounds`, `contact_forces_ahead`, `remainder_bound`,
  `advance_motion`,
- near a time: `acceleration_and_jerk`, `jet`, `jet_at_point`, `propagate_back`, `contact_force`, `propagate`,
- for flights of any duration: `fly`, `fly_with_matrix`, `propagate_matrix`, `flight_map`,
- and `chatter_bounds`, `shortest_step`, `reverse_time`.

The constant `LINEAR` is True if the matrix of a flight does not depend on its initial state.
"""

from . import force_flow, linear_flow


def flow_of(coeffs):
    """Return the flow of some coefficients.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.

    Returns
    -------
    module
        Module with the functions above.
    """
    return linear_flow if coeffs.force_law is None else force_flow
