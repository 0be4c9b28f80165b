"""diffrax between soft walls: an Event with a root finder ends each flight and each contact; vmapped and jitted."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from benchmarks.soft_work import held
from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, Strobes

SOLVERS = {"Tsit5": diffrax.Tsit5, "Kvaerno5": diffrax.Kvaerno5}
STEPS = 4096  # of one flight or contact: diffrax's own default
BLOCK = 32  # lanes wait for the slowest of them, so that on one core more at once are no faster


def field(t, y, given):
    """Right-hand side; given: A, stiffness, damping beyond a wall, and the side of the wall it is within, or 0."""
    amplitude, stiffness, damping, within = given
    free = amplitude * jnp.cos(OMEGA * t) - y[0]
    pressed = free - 2 * damping * y[1] - stiffness * (y[0] - within)
    return jnp.stack([y[1], jnp.where(within == 0, free - 2 * GAMMA * y[1], pressed)])


def passes(side):
    """The event that rises through 0 where the mass comes to the wall on a side, from within if it is there."""

    def event(t, y, args, **_):
        depth = side * y[0] - 1.0
        return jnp.where(args[-1] == side, -depth, depth)

    return event


def go(time, y, given, solver, tolerance):
    """On to the next wall or the period's end: time, state, the side passed (0 for none), whether that went well."""
    piece = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        SOLVERS[solver](),
        time,
        PERIOD,
        None,
        y,
        given,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        event=diffrax.Event((passes(-1), passes(1)), optimistix.Newton(1e-14, 1e-14), direction=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=STEPS,
        throw=False,
    )
    met_left, met_right = piece.event_mask
    side = jnp.where(met_right, 1.0, jnp.where(met_left, -1.0, 0.0))
    well = (piece.result == diffrax.RESULTS.successful) | (piece.result == diffrax.RESULTS.event_occurred)
    return piece.ts[-1], piece.ys[-1], side, well


def strobe_one(state, stiffness, damping, solver, tolerance):
    """Map one state through a period; its end is nan where the integrator gives up."""

    def going(carry):
        time, _, _, count, _, _, well = carry
        return (time < PERIOD) & (count < CAP) & well

    def turn(carry):
        time, y, within, count, sides, times, _ = carry
        time, y, side, well = go(time, y, (state[2], stiffness, damping, within), solver, tolerance)
        passed, enters = side != 0, (side != 0) & (within == 0)
        y = jnp.where(passed, jnp.stack([side, y[1]]), y)
        sides = sides.at[count].set(jnp.where(enters, side, 0.0).astype(jnp.int8))
        times = times.at[count].set(jnp.where(enters, time, jnp.inf))
        within = jnp.where(enters, side, 0.0)
        return jnp.where(passed, time, PERIOD), y, within, count + enters, sides, times, well

    start = (jnp.zeros(()), state[:2], jnp.zeros(()), 0, jnp.zeros(CAP, jnp.int8), jnp.full(CAP, jnp.inf), True)
    _, y, _, _, sides, times, well = jax.lax.while_loop(going, turn, start)
    return Strobes(jnp.where(well, y, jnp.nan), sides, times)


@functools.partial(jax.jit, static_argnames="solver")
def strobe_batch(states, stiffness, damping, solver, tolerance):
    """Map (n, 3) states at once."""
    return jax.vmap(lambda state: strobe_one(state, stiffness, damping, solver, tolerance))(states)


def strobe(states, stiffness, tolerance, solver):
    """Map (n, 3) states x, x', A through one period with rtol = atol = tolerance; returns Strobes."""
    parts = [
        strobe_batch(states[first : first + BLOCK], stiffness, held(stiffness), solver, tolerance)
        for first in range(0, len(states), BLOCK)
    ]
    return jax.tree.map(lambda *each: np.concatenate(each), *parts)
