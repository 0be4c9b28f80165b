"""Fly along a path with stops at given times, for `simulate` and `sample`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, minimum, two_sum
from ..flight import integrate
from ..flight.flight_state import CAPPED


class Stops(NamedTuple):
    """Stops in order along the first axis.

    `span` and `span_low` are the length of the flight to each stop and its low part, for each lane or for all. `cosine`
    and `sine` are those of the drive at the stop, to which the lanes are reset. `end` is the time of the stop on the
    clock of the log of impacts; None means that each piece has its own clock, which starts at 0.
    """

    span: Float[jax.Array, "stops ..."]
    span_low: Float[jax.Array, "stops ..."]
    cosine: Float[jax.Array, "stops ..."]
    sine: Float[jax.Array, "stops ..."]
    end: Float[jax.Array, "stops ..."] | None


class FlightPiece(NamedTuple):
    """Piece of flight, at most a drive period: its start, its length, and the time from its end to the stop."""

    path: integrate.Path
    length: Float[jax.Array, "..."]
    time_to_stop: Float[jax.Array, "..."]


def fly_to_stops(coeffs, loop, extra, stops, limits, after_piece, observe):
    """Return ((loop state, extra) at the last stop, values of `observe` at each stop).

    `extra` is carried along. `after_piece` maps (piece, loop state after it, extra) to the new (loop state, extra),
    after each piece, at least once for each stop. `limits` apply to a piece, unless `after_piece` keeps the counters of
    the loop state.
    """

    def fly_to_stop(carry, stop):
        zero = jnp.zeros_like(carry[0].path.x)
        fly_piece = _piece_stepper(coeffs, stop, limits, after_piece)
        initial = (*carry, stop.span + zero, stop.span_low + zero, True)
        loop, extra = lax.while_loop(lambda carry: carry[4] | jnp.any(carry[2] > 0), fly_piece, initial)[:2]
        motion = loop.path.motion._replace(cosine=stop.cosine + zero, sine=stop.sine + zero)
        loop = loop._replace(path=loop.path._replace(motion=motion))
        return (loop, extra), observe(loop, extra)

    return lax.scan(fly_to_stop, (loop, extra), stops)


def _piece_stepper(coeffs, stop, limits, after_piece):
    """Return the function that flies the next piece to a stop."""

    def fly_piece(carry):
        loop, extra, time_to_stop, time_to_stop_low, _ = carry
        path = loop.path
        is_last, is_capped = time_to_stop <= coeffs.period, path.time_remaining == CAPPED
        length = choose(time_to_stop > 0, minimum(time_to_stop, coeffs.period), 0.0)
        time_to_stop, rounding_error = two_sum(time_to_stop, -length)
        time_remaining = choose(is_capped, CAPPED, length)
        time_remaining_low = choose(is_capped, 0.0, path.time_remaining_low + choose(is_last, time_to_stop_low, 0.0))
        time_to_stop_low = choose(is_last, 0.0, time_to_stop_low + rounding_error)
        piece = FlightPiece(
            path._replace(time_remaining=time_remaining, time_remaining_low=time_remaining_low), length, time_to_stop
        )
        log_end = length if stop.end is None else stop.end - time_to_stop
        loop = loop._replace(path=piece.path, log=loop.log._replace(end_time=log_end))
        loop, extra = after_piece(piece, integrate.run_loop(coeffs, loop, limits), extra)
        return loop, extra, choose(is_last, 0.0, time_to_stop), time_to_stop_low, False

    return fly_piece
