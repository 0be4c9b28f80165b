"""How hard a mass that rests on a wall is pressed on it."""

from . import force_flow
from .drive import pushed
from .wall import press as spring_press


def press(frame, wall, cosine, sine, order):
    """How hard a mass that rests on the wall is driven along x relative to it, x'' - x_b'', and its derivatives.

    Times the wall's sign it is positive while the mass is pressed on.
    """
    if frame.law is None:
        found = spring_press(wall, frame.force, frame.frequency, frame.damping, cosine, sine, order)
        return pushed(frame.terms, frame.frequency, cosine, sine, found)
    return force_flow.as_derivatives(force_flow.press_terms(frame, wall, cosine, sine, order))
