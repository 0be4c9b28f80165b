"""The matrix of a stay within a soft wall of a spring and a damper, for `monodromy`."""

import jax.numpy as jnp

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.soft_contact import feeling, flown, is_inside, response
from ..flight.wall import chosen, course
from .contact_duration import carried, duration, from_wall_to_wall, product, share
from .onward import Onward, spent
from .path_end import leaves


def through(frame, lanes, outside, end, now):
    """The `Onward` after the stay of lanes that are within a wall, or at the `PathEnd`.

    lanes: (contact, y, y'); outside: whether they have come from there just now.
    """
    touch, y, v = lanes
    inside, left = is_inside(touch), end.time - now.time
    time = choose(inside, duration(frame, touch, y, v, now.cosine, now.sine, left), 0.0)
    out = leaves(frame, end, now, touch, time)
    time = choose(inside & ~out, left, time)
    here = feeling(frame, touch)
    angle = frame.frequency * time
    after = flow.turn(now.cosine, now.sine, jnp.cos(angle) - 1.0, jnp.sin(angle))
    answer = response(here, touch, time)
    _, opening = flown(here, touch, answer, (y, v), now.cosine, now.sine)
    shares = []
    for phasor, speed in (((now.cosine, now.sine), v), (after, opening)):
        paces = [course(wall, frame.frequency, *phasor, 1)[1] for wall in frame.walls]
        pace = chosen(touch, frame.walls, [0.0 * v if each is None else each + 0.0 * v for each in paces])
        shares.append(share(pace, speed))
    first, last = choose(outside, shares[0], 0.0), choose(out, shares[1], 0.0)
    free = from_wall_to_wall(here, touch, time, answer, (out & outside, v, now.cosine, now.sine))
    new = product(carried(frame, touch, time, free, first, last)[0], now.matrix)
    new = tuple(choose(inside, one, old) for one, old in zip(new, now.matrix, strict=True))
    return Onward(now.time + time, now.place, *after, new, spent(frame, touch, time, now.within))
