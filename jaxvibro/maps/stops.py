"""A journey with stops at times that are given: the stepping of `simulate` and `sample`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, two_sum
from ..flight import integrate
from ..flight.flight_state import CAPPED


class Stops(NamedTuple):
    """One after the other, along the first axis: how long each stretch is, with its low part, of lanes or one number
    for all; the drive's cosine and sine at its end, which the lanes are turned to there; end: on the clock by which
    impacts are told, None: each piece has its own, that starts at 0."""

    span: Float[jax.Array, "stops ..."]
    low: Float[jax.Array, "stops ..."]
    cosine: Float[jax.Array, "stops ..."]
    sine: Float[jax.Array, "stops ..."]
    end: Float[jax.Array, "stops ..."] | None


class Piece(NamedTuple):
    """What is flown at once, a drive period at most: where it begins, its length and how long before its stop it
    ends."""

    path: integrate.Path
    length: Float[jax.Array, "..."]
    left: Float[jax.Array, "..."]


def walk(frame, told, more, stops, cap, note, look):
    """((journey, more) at the last stop, what `look` says of both at each stop).

    more: what else is carried along; note: of (piece, journey after it, more) the new (journey, more), after each
    piece: at least one a stretch. cap: of a piece, unless note leaves the journey's counts as they are.
    """

    def stretch(carry, stop):
        lanes = jnp.zeros_like(carry[0].path.x)
        fly = _flying(frame, stop, cap, note)
        begun = (*carry, stop.span + lanes, stop.low + lanes, True)
        told, more = lax.while_loop(lambda now: now[4] | jnp.any(now[2] > 0), fly, begun)[:2]
        turned = told.path.motion._replace(cosine=stop.cosine + lanes, sine=stop.sine + lanes)
        told = told._replace(path=told.path._replace(motion=turned))
        return (told, more), look(told, more)

    return lax.scan(stretch, (told, more), stops)


def _flying(frame, stop, cap, note):
    """A turn: the next piece of a stretch."""

    def fly(now):
        told, more, left, low, _ = now
        path = told.path
        last, capped = left <= frame.period, path.to_go == CAPPED
        length = choose(left > 0, least(left, frame.period), 0.0)
        left, rest = two_sum(left, -length)
        to_go = choose(capped, CAPPED, length)
        to_go_low = choose(capped, 0.0, path.to_go_low + choose(last, low, 0.0))
        low = choose(last, 0.0, low + rest)
        piece = Piece(path._replace(to_go=to_go, to_go_low=to_go_low), length, left)
        end = length if stop.end is None else stop.end - left
        told = told._replace(path=piece.path, log=told.log._replace(end=end))
        told, more = note(piece, integrate.run(frame, told, cap), more)
        return told, more, choose(last, 0.0, left), low, False

    return fly
