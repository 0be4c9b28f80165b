"""Fly along a path with stops at given times, for `simulate` and `sample`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose, minimum, two_sum
from ..flight import integration_loop
from ..flight.flight_state import CAPPED


class FlightStops(NamedTuple):
    """Stops in order of time along the first axis.

    Attributes
    ----------
    flight_time, flight_time_low : array
        High and low part of the duration of the flight to each stop, for each lane or for all lanes.
    cosine, sine : array
        Cosine and sine of the drive phase at the stop. At the stop the drive phase of the path is set to these values.
    end : array or None
        Time of the stop in the log of impacts. If None, the log of each piece starts at 0.
    """

    flight_time: Float[jax.Array, "stops ..."]
    flight_time_low: Float[jax.Array, "stops ..."]
    cosine: Float[jax.Array, "stops ..."]
    sine: Float[jax.Array, "stops ..."]
    end: Float[jax.Array, "stops ..."] | None


class FlightPiece(NamedTuple):
    """Piece of a flight, at most one drive period long.

    Attributes
    ----------
    path : Path
        Path at the start of the piece.
    duration : array
        Duration of the piece.
    time_from_end_to_stop : array
        Time from the end of the piece to the stop.
    """

    path: integration_loop.Path
    duration: Float[jax.Array, "..."]
    time_from_end_to_stop: Float[jax.Array, "..."]


def fly_to_stops(coeffs, loop_state, extra_state, stops, loop_limits, finish_piece, observe_stop):
    """Fly to all stops and return ((loop state, extra) at the last stop, values of `observe_stop` at each stop).

    `extra_state` ("extra") is additional data. `finish_piece` is called after each piece, at least once for each stop,
    and maps (piece, loop state after the piece, extra) to (loop state, extra). `loop_limits` apply to each piece
    if `finish_piece` resets the counters of the loop state, otherwise to the whole flight.
    """

    def fly_to_stop(carry, stop):
        zero = jnp.zeros_like(carry[0].path.x)
        fly_piece = _make_piece_flight(coeffs, stop, loop_limits, finish_piece)
        initial_carry = (*carry, stop.flight_time + zero, stop.flight_time_low + zero, True)
        loop_state, extra_state = lax.while_loop(
            lambda carry: carry[4] | jnp.any(carry[2] > 0), fly_piece, initial_carry
        )[:2]
        motion = loop_state.path.motion._replace(cosine=stop.cosine + zero, sine=stop.sine + zero)
        loop_state = loop_state._replace(path=loop_state.path._replace(motion=motion))
        return (loop_state, extra_state), observe_stop(loop_state, extra_state)

    return lax.scan(fly_to_stop, (loop_state, extra_state), stops)


def _make_piece_flight(coeffs, stop, loop_limits, finish_piece):
    """Return the function that flies the next piece to a stop."""

    def fly_piece(carry):
        loop_state, extra_state, time_to_stop, time_to_stop_low, _ = carry
        path = loop_state.path
        is_last_piece, has_exceeded_limits = time_to_stop <= coeffs.period, path.time_remaining == CAPPED
        piece_duration = choose(time_to_stop > 0, minimum(time_to_stop, coeffs.period), 0.0)
        time_to_stop, rounding_error = two_sum(time_to_stop, -piece_duration)
        piece_time_remaining = choose(has_exceeded_limits, CAPPED, piece_duration)
        piece_remaining_low = choose(
            has_exceeded_limits, 0.0, path.time_remaining_low_part + choose(is_last_piece, time_to_stop_low, 0.0)
        )
        time_to_stop_low = choose(is_last_piece, 0.0, time_to_stop_low + rounding_error)
        flight_piece = FlightPiece(
            path._replace(time_remaining=piece_time_remaining, time_remaining_low_part=piece_remaining_low),
            piece_duration,
            time_to_stop,
        )
        log_end_time = piece_duration if stop.end is None else stop.end - time_to_stop
        loop_state = loop_state._replace(path=flight_piece.path, log=loop_state.log._replace(end_time=log_end_time))
        loop_state, extra_state = finish_piece(
            flight_piece, integration_loop.run_loop(coeffs, loop_state, loop_limits), extra_state
        )
        return loop_state, extra_state, choose(is_last_piece, 0.0, time_to_stop), time_to_stop_low, False

    return fly_piece
