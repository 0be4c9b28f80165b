"""What moves the mass between walls: asked for here alone.

Each kind is a file with the same functions, `spring_flow` and `force_flow`. A step: `look` ahead, the derivatives
`to_event`, the `presses` on the walls, the `remainder` of both, `advance`. Near a time: `accelerations`, `jet`,
`jet_at`, `back`, `press`, `moved`. Over any time: `fly`, `matrix`, `passed`, `repeated`; `LINEAR`: whether the matrix
is the same wherever a flight begins. And `hops`, `shortest`, `reversed_in_time`.
"""

from . import force_flow, spring_flow


def flow_of(frame):
    """The flow of a frame: a file with the functions above."""
    return spring_flow if frame.law is None else force_flow
