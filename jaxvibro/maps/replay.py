"""The end of a strobe and its impacts as smooth functions of state and scene: the impacts are known, and made again.

A flight takes as long as it took, a constant, and ends at the time of an impact as it was. The impact itself comes
later than that by a time that is 0 and has derivatives: it is found, and its effect brought back to the old time, by
Taylor polynomials as long as the order of the derivatives asked for. So flights stay linear in the state, and no
iteration is differentiated but Newton's on these polynomials: k steps are right to the order 2^k - 1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Real

from ..compiled.compiler_hints import choose, stage
from ..flight import flow, taylor
from ..flight.flows import flow_of
from ..flight.soft_contact import bounce
from ..flight.taylor import Now
from ..flight.wall import course_on, less, picked
from ..scene.codes import Contact
from .path_end import PathEnd
from .stay_replays import replay_of


class KnownImpacts(NamedTuple):
    """What happened: times and sides (-1, 0, +1) of the impacts, shape (slots, lanes), inf and 0 where there is none;
    count: how many, below 0 where a replay is not possible; freed: when the mass was last released from a wall, -1 if
    never; rests: the contact of a mass that rests on a wall at the end, or is within a soft one, else 0; before: of
    each impact, when the mass had last been released, None: all are after `freed`."""

    times: Float[jax.Array, "..."]
    sides: Float[jax.Array, "..."]
    count: Real[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    freed: Float[jax.Array, "*lanes"]
    rests: Float[jax.Array, "*lanes"]
    before: Float[jax.Array, "..."] | None = None


def replay(frame, state, known, periods, order):
    """((x, v) at the end, times, speeds of the impacts: shape (slots, lanes)), with derivatives right to an order."""
    start, end, _, times, speeds = _replayed(frame, state, known, periods * frame.period, order)
    last = _held(frame, start._replace(x=end.x, v=end.v), _resting(known.rests))
    return (last.x, last.v), times, speeds


def replay_for(frame, state, known, span, order):
    """(x, v) after any time, likewise; a derivative by the time is that of the motion."""
    _, end, late, _, _ = _replayed(frame, state, known, span, order)
    cosine, sine = flow.rotated(end.cosine, end.sine, frame.frequency * late)
    last = _held(frame, end._replace(cosine=cosine, sine=sine), _resting(known.rests))
    return last.x, last.v


def _replayed(frame, state, known, span, order):
    """(where it starts, where it is after the time, how much later than a constant that is, times, speeds)."""
    zero = lax.full_like(known.freed, 0.0)
    cosine, sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    start = _held(frame, Now(state.x + zero, state.v + zero, cosine, sine, zero), _resting(state.contact) + zero)
    whole = lax.stop_gradient(span) + zero
    stays = replay_of(frame)
    aim = PathEnd(whole, known.rests)
    start, entry = stays.begun(frame, start, state.contact, aim, order)
    if frame.walls:
        end, times, speeds = _journey(frame, start, entry, known, aim, order)
    else:
        end, times, speeds = _fly(frame, start, whole), known.times, jnp.zeros_like(known.times)
    late = span - whole
    free = flow_of(frame).jet_at(frame, end, order)
    free = taylor.shifted(free, late, order), taylor.shifted(free[1:], late, order)
    x, v = stays.shifted(frame, end, known.rests, free, late, order)
    return start, end._replace(x=x, v=v), late, times, speeds


def _journey(frame, start, entry, known, end, order):
    """(where the lanes are at the `PathEnd`, times, speeds of the impacts); start, entry: as the stays have them."""
    stays, whole = replay_of(frame), end.time
    most = lax.min(jnp.max(known.count).astype(jnp.int32), jnp.int32(len(known.times)))

    def turn(carry):
        """To the next impact, or to the release before it, or, after all impacts, to the end."""
        k, passed, now, entry, *rows = carry
        now = stays.gone(frame, now, entry, end, order)
        time, side = (lax.dynamic_index_in_dim(each, k, keepdims=False) for each in (known.times, known.sides))
        last = k == most
        time, side = choose(last, whole, time), choose(last, 0.0, side)
        freed = known.freed
        if known.before is not None:
            freed = choose(last, freed, lax.dynamic_index_in_dim(known.before, k, keepdims=False))
        due = freed > passed
        waits = jnp.any(due)
        hit = (side != 0) & ~waits
        aim = choose(~waits & (hit | last), time, now.time)
        now = _fly(frame, now, aim - now.time)
        now = lax.cond(waits, lambda now: _left(frame, now, due, freed, order), lambda now: now, now)
        late, speed, x, v = stage(_kick, frame, now, side, order=order)
        rows = [_put(*each, k, hit) for each in zip(rows, (time + late, speed), strict=True)]
        now = now._replace(x=choose(hit, x, now.x), v=choose(hit, v, now.v))
        now, entry = stays.entered(frame, now, choose(hit, side, 0.0), late, end, order)
        return k + (~waits).astype(jnp.int32), choose(due, freed, passed), now, entry, *rows

    never = lax.full_like(known.freed, -1.0)
    carry = (jnp.int32(0), never, start, entry, known.times, jnp.zeros_like(known.times))
    _, _, now, _, *rows = lax.while_loop(lambda carry: carry[0] <= most, turn, carry)
    return now, *rows


def _put(rows, new, k, where):
    """The rows with some lanes of one replaced."""
    old = lax.dynamic_index_in_dim(rows, k, keepdims=False)
    return lax.dynamic_update_index_in_dim(rows, choose(where, new, old), k, 0)


def _resting(contact):
    return choose(lax.abs(contact) == Contact.STUCK, jnp.sign(contact), 0.0)


def _fly(frame, now, time):
    """A free flight later."""
    place = flow_of(frame).fly(frame, now.x, now.v, now.cosine, now.sine, time)
    return Now(*place, now.time + time)


def _held(frame, now, side):
    """Where the wall on a side is, side 0: where it was."""
    if not frame.walls:
        return now
    where, speed = course_on(frame, side, now.cosine, now.sine, 1)
    held = side != 0
    return now._replace(x=choose(held, where, now.x), v=choose(held, 0.0 if speed is None else speed, now.v))


def _left(frame, now, due, freed, order):
    """Lanes that are due brought to where they leave a wall, where the press on it passes zero: no earlier state
    matters, and none is flown on from.

    Of two walls it is the one with the lesser press.
    """
    time = choose(due, freed, now.time)
    phasor = flow.rotated(now.cosine, now.sine, frame.frequency * (time - now.time))
    now = Now(now.x, now.v, *(choose(due, *each) for each in zip(phasor, now[2:4], strict=True)), time)
    pushes = [flow_of(frame).press(frame, wall, now.cosine, now.sine, order) for wall in frame.walls]
    side = lax.full_like(now.x, float(frame.walls[0].sign))
    if len(pushes) == 2:
        side = choose(lax.abs(pushes[1][0]) < lax.abs(pushes[0][0]), 1.0, side)
    late = taylor.root(picked(side, frame.walls, pushes), order)
    way = taylor.way(frame, now, side, order)
    x, v = flow_of(frame).back(frame, now, *taylor.placed(way, late, order), late, order)
    return now._replace(x=choose(due, x, now.x), v=choose(due, v, now.v))


def _kick(frame, now, side, order):
    """(late, speed against the wall, x, v) of an impact about now, brought back to now."""
    path, way = flow_of(frame).jet_at(frame, now, order), taylor.way(frame, now, side, order)
    late = taylor.root([less(a, b) for a, b in zip(path[: order + 1], way, strict=False)], order)
    (where, speed), v = taylor.placed(way, late, order), taylor.shifted(path[1:], late, order)
    closing = v - speed
    after = v - (1.0 + bounce(frame, side)) * closing
    return late, side * closing, *flow_of(frame).back(frame, now, where, after, late, order)
