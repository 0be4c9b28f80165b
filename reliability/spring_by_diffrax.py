"""x'' + x = 0 by diffrax with Event, as its documentation shows it, and the events that cases need."""

from typing import NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
import optimistix

TOLERANCE = 1e-9  # of steps, relative and absolute
CONTROL = diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE)
SWING = 1.001  # of the wall that comes over a mass at rest
SECTION = 1.4  # the time of a section


class Flight(NamedTuple):
    """How diffrax ended: the time, the state, which events occurred and were located."""

    time: float
    state: np.ndarray
    events: tuple[bool, ...]


def fly(stop, start, state, *events, direction=True, control=CONTROL, solver=None, step=None):
    """From a time and a state to a time or to the first event: a `Flight`.

    direction: True for events that rise, None for both; solver: Tsit5 where it is None; step: the first.
    """
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver or diffrax.Tsit5(),
        start,
        stop,
        step,
        jnp.asarray(state),
        stepsize_controller=control,
        event=diffrax.Event(events, optimistix.Newton(1e-12, 1e-12), direction),
        throw=False,
    )
    located = bool(found.result == diffrax.RESULTS.event_occurred)
    return Flight(float(found.ts[-1]), np.asarray(found.ys[-1]), tuple(located and bool(e) for e in found.event_mask))


def field(t, y, args):
    """The right-hand side of x'' + x = 0."""
    return jnp.stack([y[1], -y[0]])


def beyond_one(t, y, args, **_):
    """How far the mass is beyond a wall at 1."""
    return y[0] - 1.0


def beyond_swinging(t, y, args, **_):
    """How far it is beyond the wall that swings."""
    return y[0] - 1.0 - SWING * jnp.cos(2.0 * t)


def below_zero(t, y, args, **_):
    """How far it is beyond a left wall at 0."""
    return -y[0]


def later(t, y, args, **_):
    """How far the time is beyond the section's."""
    return t - SECTION
