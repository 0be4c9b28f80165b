"""Lanes that start within a soft wall."""

from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import taylor
from ..scene.codes import Contact


def within(frame, now, given, order=1):
    """(contact, y, y') of lanes that start within a soft wall, contact 0 of others; given: the contact of the start."""
    touch = lax.full_like(now.x, 0.0)
    given = given + touch
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        if soft is not None:
            where, pace = taylor.placed(taylor.way(frame, now, touch + wall.sign, 1), 0.0 * touch, 1)
            depth, closing = wall.sign * (now.x - where), wall.sign * (now.v - pace)
            fresh = (given * wall.sign == Contact.WITHIN) & (depth <= 0) & (closing >= 0)
            touch = choose((given * wall.sign != Contact.LANDED) & (depth > 0), wall.sign * Contact.WITHIN, touch)
            touch = choose(fresh, wall.sign * Contact.ENTERED, touch)
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), 0.0 * touch, order)
    return touch, now.x - where, now.v - pace
