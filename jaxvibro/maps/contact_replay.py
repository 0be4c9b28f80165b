"""A stay within a soft wall made again, for derivatives (`replay`): it takes as long as it took, a constant, and its
end is moved by Taylor polynomials."""

from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, taylor
from ..flight.soft_contact import is_inside
from ..flight.taylor import Now
from ..scene.codes import Contact
from . import pushed_replay
from .contact_duration import QUICK, duration, leave


def begun(frame, now, given, whole, order):
    """Lanes that start within a soft wall brought to where they leave it, or to the end; given: the contact."""
    touch, y, v = initial(frame, now, given, order)
    left = whole - now.time
    return _passed(frame, now, touch, y, v, _taken(frame, touch, y, v, now, left), left, order)


def initial(frame, now, given, order=1):
    """(contact, y, y') of lanes that start within a soft wall, contact 0 of others; given: the contact of the start."""
    touch = lax.full_like(now.x, 0.0)
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        if soft is not None:
            where, pace = taylor.placed(taylor.way(frame, now, touch + wall.sign, 1), 0.0 * touch, 1)
            depth, closing = wall.sign * (now.x - where), wall.sign * (now.v - pace)
            fresh = (given * wall.sign == Contact.WITHIN) & (depth <= 0) & (closing >= 0)
            touch = choose((given * wall.sign != Contact.LANDED) & (depth > 0), wall.sign * Contact.WITHIN, touch)
            touch = choose(fresh, wall.sign * Contact.ENTERED, touch)
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), 0.0 * touch, order)
    return touch, now.x - where, now.v - pace


def entered(frame, now, side, late, whole, order):
    """Lanes that enter the soft wall on a side a little later than now brought to where they leave it, or to the end.

    side: 0 of lanes that enter none; lanes at a rigid wall stay as they are.
    """
    touch = choose(soft_contact.gives(frame, side), side * Contact.ENTERED, 0.0)
    inside, left = is_inside(touch), whole - now.time
    _, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    v = taylor.shifted(taylor.jet(frame, now, order)[1:], late, order) - pace
    cosine, sine = _turned(frame, now, late)[2:4]
    none = lax.full_like(v, 0.0)
    time = _taken(frame, touch, none, v, now, left)
    here = soft_contact.feeling(frame, touch)
    bias = soft_contact.biases(frame, touch, now.cosine, now.sine, order)
    kept = _passed(frame, now, touch, *taylor.back(here, now, none, v, late, order, bias), time, left, order)
    quick = inside & (time < left) & (time < QUICK * here.reach)
    given = choose(quick, side, 0.0), cosine, sine, choose(quick, side * v, 1.0)
    gone = _gone(frame, now, late, time, leave(frame, *given, choose(quick, time, 0.0), order), side, order)
    return Now(*(choose(quick, new, old) for new, old in zip(gone, kept, strict=True)))


def _taken(frame, touch, y, v, now, left):
    """How long lanes stay within a wall, at most so much; a constant."""
    time = duration(*lax.stop_gradient((frame, touch, y, v, now.cosine, now.sine, left)))
    return lax.stop_gradient(choose(is_inside(touch), time, 0.0))


def _gone(frame, now, late, time, out, side, order):
    """Lanes that leave a wall after a stay that began a little late, and took about so much time: free by then."""
    end = _turned(frame, now, time)
    late = late + (out.time - time)
    where, pace = taylor.placed(taylor.way(frame, end, side, order), late, order)
    x, v = taylor.back(frame, end, where, pace + out.v, late, order)
    return end._replace(x=x, v=v)


def _turned(frame, now, time):
    """The drive a time later."""
    cosine, sine = flow.rotated(now.cosine, now.sine, frame.frequency * time)
    return now._replace(cosine=cosine, sine=sine, time=now.time + time)


def _passed(frame, now, touch, y, v, time, left, order):
    """Lanes within a wall brought to where they leave it after a time, or to the end."""
    inside = is_inside(touch)
    here = soft_contact.feeling(frame, touch)
    y, v = soft_contact.flown(here, touch, soft_contact.response(here, touch, time), (y, v), now.cosine, now.sine)
    end = _turned(frame, now, time)._replace(x=y, v=v)
    leaves = inside & (time < left)
    path = _within(frame, here, touch, end, order)
    steady = [path[0], choose(leaves, path[1], 1.0), *path[2 : order + 1]]
    late = choose(leaves, taylor.root(steady, order), 0.0)
    x, v = _absolute(frame, end, touch, path, late, order)
    gone = taylor.back(frame, end, x, v, late, order)
    x, v = choose(leaves, gone[0], x), choose(leaves, gone[1], v)
    return Now(*(choose(inside, new, old) for new, old in zip((x, v, *end[2:]), now, strict=True)))


def _within(frame, here, touch, now, order):
    """y and its derivatives, one more than the order."""
    return taylor.jet(here, now, order, soft_contact.biases(frame, touch, now.cosine, now.sine, order))


def _absolute(frame, now, touch, path, late, order):
    """(x, v) a time later of a mass that is within a wall until then; path: y and its derivatives."""
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), late, order)
    return where + taylor.shifted(path, late, order), pace + taylor.shifted(path[1:], late, order)


def shifted(frame, now, touch, late, order):
    """(x, v) a time later; touch: the contact of lanes that are within a soft wall, else 0."""
    free = taylor.jet(frame, now, order)
    free = taylor.shifted(free, late, order), taylor.shifted(free[1:], late, order)
    if not frame.soft:
        return free
    if frame.pushes:
        within = pushed_replay.shifted(frame, now, touch, late, order)
        return tuple(choose(is_inside(touch), new, old) for new, old in zip(within, free, strict=True))
    here = soft_contact.feeling(frame, touch)
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), 0.0 * late, order)
    path = _within(frame, here, touch, now._replace(x=now.x - where, v=now.v - pace), order)
    within = _absolute(frame, now, touch, path, late, order)
    return tuple(choose(is_inside(touch), new, old) for new, old in zip(within, free, strict=True))
