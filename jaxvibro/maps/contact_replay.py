"""A stay within a soft wall made again, for derivatives (`replay`): it takes as long as it took, a constant, and its
end is moved by Taylor polynomials."""

from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, taylor
from ..flight.flows import flow_of
from ..flight.soft_contact import is_inside
from ..flight.taylor import Now
from ..scene.codes import Contact
from . import start_within
from .contact_duration import QUICK, duration, leave
from .path_end import leaves


def begun(frame, now, given, end, order):
    """(lanes that start within a soft wall where they leave it, or at the end; None); given: the contact."""
    touch, y, v = start_within.within(frame, now, given, order)
    return _passed(frame, now, touch, y, v, *_taken(frame, touch, y, v, now, end), order), None


def gone(frame, now, entry, end, order):
    """The lanes as they are."""
    return now


def entered(frame, now, side, late, end, order):
    """(lanes that enter the soft wall on a side a little later than now where they leave it, or at the end; None).

    side: 0 of lanes that enter none; lanes at a rigid wall stay as they are.
    """
    touch = choose(soft_contact.gives(frame, side), side * Contact.ENTERED, 0.0)
    _, pace = taylor.placed(taylor.way(frame, now, side, order), late, order)
    v = taylor.shifted(flow_of(frame).jet_at(frame, now, order)[1:], late, order) - pace
    cosine, sine = _turned(frame, now, late)[2:4]
    none = lax.full_like(v, 0.0)
    time, out = _taken(frame, touch, none, v, now, end)
    here = soft_contact.feeling(frame, touch)
    bias = soft_contact.biases(frame, touch, now.cosine, now.sine, order)
    kept = _passed(frame, now, touch, *flow_of(here).back(here, now, none, v, late, order, bias), time, out, order)
    quick = out & (time < QUICK * here.reach)
    given = choose(quick, side, 0.0), cosine, sine, choose(quick, side * v, 1.0)
    left_soon = _gone(frame, now, late, time, leave(frame, *given, choose(quick, time, 0.0), order), side, order)
    return Now(*(choose(quick, new, old) for new, old in zip(left_soon, kept, strict=True))), None


def _taken(frame, touch, y, v, now, end):
    """(how long lanes stay within a wall, at most to the path's end, a constant; whether they leave it by then)."""
    left = end.time - now.time
    time = duration(*lax.stop_gradient((frame, touch, y, v, now.cosine, now.sine, left)))
    time = lax.stop_gradient(choose(is_inside(touch), time, 0.0))
    out = leaves(frame, end, now, touch, time)
    return choose(is_inside(touch) & ~out, left, time), out


def _gone(frame, now, late, time, out, side, order):
    """Lanes that leave a wall after a stay that began a little late, and took about so much time: free by then."""
    end = _turned(frame, now, time)
    late = late + (out.time - time)
    where, pace = taylor.placed(taylor.way(frame, end, side, order), late, order)
    x, v = flow_of(frame).back(frame, end, where, pace + out.v, late, order)
    return end._replace(x=x, v=v)


def _turned(frame, now, time):
    """The drive a time later."""
    cosine, sine = flow.rotated(now.cosine, now.sine, frame.frequency * time)
    return now._replace(cosine=cosine, sine=sine, time=now.time + time)


def _passed(frame, now, touch, y, v, time, out, order):
    """Lanes within a wall brought to where they leave it after a time, or to the end."""
    inside = is_inside(touch)
    here = soft_contact.feeling(frame, touch)
    y, v = soft_contact.flown(here, touch, soft_contact.response(here, touch, time), (y, v), now.cosine, now.sine)
    end = _turned(frame, now, time)._replace(x=y, v=v)
    path = _within(frame, here, touch, end, order)
    steady = [path[0], choose(out, path[1], 1.0), *path[2 : order + 1]]
    late = choose(out, taylor.root(steady, order), 0.0)
    x, v = _absolute(frame, end, touch, path, late, order)
    free = flow_of(frame).back(frame, end, x, v, late, order)
    x, v = choose(out, free[0], x), choose(out, free[1], v)
    return Now(*(choose(inside, new, old) for new, old in zip((x, v, *end[2:]), now, strict=True)))


def _within(frame, here, touch, now, order):
    """y and its derivatives, one more than the order."""
    return flow_of(here).jet_at(here, now, order, soft_contact.biases(frame, touch, now.cosine, now.sine, order))


def _absolute(frame, now, touch, path, late, order):
    """(x, v) a time later of a mass that is within a wall until then; path: y and its derivatives."""
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), late, order)
    return where + taylor.shifted(path, late, order), pace + taylor.shifted(path[1:], late, order)


def shifted(frame, now, contact, free, late, order):
    """(x, v) a time later; contact, free: see `no_replay`."""
    touch = choose(is_inside(contact), contact, 0.0)
    here = soft_contact.feeling(frame, touch)
    where, pace = taylor.placed(taylor.way(frame, now, touch, order), 0.0 * late, order)
    path = _within(frame, here, touch, now._replace(x=now.x - where, v=now.v - pace), order)
    within = _absolute(frame, now, touch, path, late, order)
    return tuple(choose(is_inside(touch), new, old) for new, old in zip(within, free, strict=True))
