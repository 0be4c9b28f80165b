"""What moves the mass between walls: asked for here alone.

Each kind is a file with the same functions, `linear_flow` and `force_flow`. A step: `look` ahead, the derivatives
`to_event`, the `presses` on the walls, the `remainder` of both, `advance`. Near a time: `accelerations`, `jet`,
`jet_at`, `back`, `press`, `moved`. Over any time: `fly`, `matrix`, `passed`, `repeated`; `LINEAR`: whether the matrix
is the same wherever a flight begins. And `hops`, `shortest`, `reversed_in_time`.
"""

from . import force_flow, linear_flow


def flow_of(coeffs):
    """The flow of a coeffs: a file with the functions above."""
    return linear_flow if coeffs.force_law is None else force_flow
