"""Integrate x'' + x = 0 by diffrax with Event, as its documentation shows it, with the events of the cases."""

from typing import NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
import optimistix

TOLERANCE = 1e-9  # relative and absolute tolerance of steps
CONTROL = diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE)
SWING = 1.001  # motion amplitude of the wall that passes over a mass at rest
SECTION = 1.4  # time of a section


class Flight(NamedTuple):
    """End of an integration by diffrax: time, state, events that occurred and were located."""

    time: float
    state: np.ndarray
    events: tuple[bool, ...]


def fly(stop, start, state, *events, direction=True, control=CONTROL, solver=None, step=None):
    """Integrate from a time and a state to a time or to the first event; returns a `Flight`.

    `direction`: True for rising events, None for both; `solver`: None for Tsit5; `step`: the first step.
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
    """Compute the right-hand side of x'' + x = 0."""
    return jnp.stack([y[1], -y[0]])


def beyond_one(t, y, args, **_):
    """Return the penetration of a wall at 1."""
    return y[0] - 1.0


def beyond_swinging(t, y, args, **_):
    """Return the penetration of the moving wall."""
    return y[0] - 1.0 - SWING * jnp.cos(2.0 * t)


def below_zero(t, y, args, **_):
    """Return the penetration of a left wall at 0."""
    return -y[0]


def later(t, y, args, **_):
    """Return the time since the section."""
    return t - SECTION
