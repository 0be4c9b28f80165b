"""Soft walls of a spring and a damper: within one a lane flies by the steps of its free flight, or by a long one.

The interface is that of `no_stay`, see `stays`.
"""

from functools import partial

from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.codes import Contact
from . import event, soft_long_step
from .soft_contact import biases, felt
from .within_wall import counted


def begin(frame, path):
    """(frame as the lanes feel it, path, the lanes' contact where it matters to the flow, the derivatives' bias)."""
    frame = frame._replace(**stage(felt, frame, path.contact)._asdict())
    path = soft_long_step.plunged(frame, path)
    bias = stage(biases, frame, path.contact, path.cosine, path.sine, order=event.TERMS - 2)
    return frame, path, path.contact, bias


def going(path):
    """The path of the lanes that a step is for: all."""
    return path


def facing(frame, contact, side, way, on, swing):
    """As `no_stay.facing`: from within, y falls to 0."""
    inside = (contact == Contact.WITHIN) | (contact == Contact.ENTERED)
    way = counted(inside, side, way)
    on |= contact == Contact.ENTERED
    swing, side = choose(inside, 0.0, swing + 0.0 * side), choose(inside, -side, side)
    return way, on, swing, side, event.weights(frame.reach)


def bias(frame, path):
    """The bias of the acceleration and of its change, see `flow.extend`."""
    return biases(frame, path.contact, path.cosine, path.sine, 1)


def reach(frame):
    """The longest step, within walls too."""
    found = frame.reach
    for each in frame.contacts:
        found = found if each is None else lax.min(found, each.reach)
    return found


def unbegun(none):
    """What the lanes' waits within a wall begin with; none: 0 of each lane."""
    return none


def paused(frame, path, wait, due, idle):
    """As `no_stay.paused`: by `soft_long_step.leap`, where one is due."""
    return lax.cond(due, partial(soft_long_step.leap, frame), lambda *same: same, path, wait)
