"""Map states with diffrax's Event and a root finder: flights and contacts in one loop, vmapped and jitted."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, Strobes, held

SOLVERS = {"Tsit5": diffrax.Tsit5, "Dopri8": diffrax.Dopri8, "Kvaerno5": diffrax.Kvaerno5}
STEPS = 4096  # largest number of steps of one flight or contact, diffrax's default


def field(t, y, given):
    """Compute the right-hand side.

    `given` contains A; for soft walls (stiffness, damping, side of the one in contact or 0), or None; a cubic term, or
    None.
    """
    amplitude, press, cubic = given
    force = amplitude * jnp.cos(OMEGA * t) - y[0]
    force = force if cubic is None else force - cubic * y[0] * y[0] * y[0]
    pull = force - 2 * GAMMA * y[1]
    if press is not None:
        stiffness, damping, within = press
        pull = jnp.where(within == 0, pull, force - 2 * damping * y[1] - stiffness * (y[0] - within))
    return jnp.stack([y[1], pull])


def passes(side):
    """Make the event function that rises through 0 at the wall on a side, from within if in contact."""

    def event(t, y, args, **_):
        depth, (_, press, _) = side * y[0] - 1.0, args
        return depth if press is None else jnp.where(press[-1] == side, -depth, depth)

    return event


def go(time, y, given, solver, tolerance):
    """Integrate to the next wall or the end of the period; returns time, state, side hit (0 for none) and success."""
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


def strobe_one(state, walls, cubic, solver, tolerance):
    """Map one state over a period; the end is nan if the integrator fails.

    `walls` are (stiffness, damping) of soft walls, None for rigid ones.
    """

    def going(carry):
        time, _, _, count, _, _, well = carry
        return (time < PERIOD) & (count < CAP) & well

    def turn(carry):
        time, y, within, count, sides, times, _ = carry
        press = None if walls is None else (*walls, within)
        time, y, side, well = go(time, y, (state[2], press, cubic), solver, tolerance)
        met, enters = side != 0, (side != 0) & (within == 0)
        sides = sides.at[count].set(jnp.where(enters, side, 0.0).astype(jnp.int8))
        times = times.at[count].set(jnp.where(enters, time, jnp.inf))
        if walls is None:
            y = jnp.where(met, jnp.stack([side, -RESTITUTION * y[1]]), y)
        else:
            y, within = jnp.where(met, jnp.stack([side, y[1]]), y), jnp.where(enters, side, 0.0)
        return jnp.where(met, time, PERIOD), y, within, count + enters, sides, times, well

    start = (jnp.zeros(()), state[:2], jnp.zeros(()), 0, jnp.zeros(CAP, jnp.int8), jnp.full(CAP, jnp.inf), True)
    _, y, _, _, sides, times, well = jax.lax.while_loop(going, turn, start)
    return Strobes(jnp.where(well, y, jnp.nan), sides, times)


@functools.partial(jax.jit, static_argnames="solver")
def strobe_batch(states, walls, cubic, solver, tolerance):
    """Map (n, 3) states in one call."""
    return jax.vmap(lambda state: strobe_one(state, walls, cubic, solver, tolerance))(states)


def strobe(states, tolerance=1e-9, stiffness=None, solver="Tsit5", block=None, cubic=None):
    """Map (n, 3) states x, x', A over one period with rtol = atol = tolerance; returns Strobes.

    `block` is the number of states in one call, None for all. Lanes wait for the slowest of them.
    """
    walls, block = None if stiffness is None else (stiffness, held(stiffness)), block or len(states)
    parts = [
        strobe_batch(states[first : first + block], walls, cubic, solver, tolerance)
        for first in range(0, len(states), block)
    ]
    return jax.tree.map(lambda *each: np.concatenate(each), *parts)
