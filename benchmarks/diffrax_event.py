"""diffrax's Tsit5 with Event and a root finder, restarted after each rebound inside one loop; vmapped and jitted."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, Strobes


def field(t, y, amplitude):
    """Right-hand side of equation 3."""
    return jnp.stack([y[1], amplitude * jnp.cos(OMEGA * t) - y[0] - 2 * GAMMA * y[1]])


def left(t, y, args, **_):
    """Rise through 0 where the mass goes through the wall at -1."""
    return -1.0 - y[0]


def right(t, y, args, **_):
    """Rise through 0 where the mass goes through the wall at 1."""
    return y[0] - 1.0


def fly(time, y, amplitude, tolerance):
    """Fly to the next wall or the period's end: time, state, and the side met (0 for none)."""
    flight = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Tsit5(),
        time,
        PERIOD,
        None,
        y,
        amplitude,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        event=diffrax.Event((left, right), optimistix.Newton(1e-14, 1e-14), direction=True),
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
    met_left, met_right = flight.event_mask
    side = jnp.where(met_right, 1, jnp.where(met_left, -1, 0)).astype(jnp.int8)
    return flight.ts[-1], flight.ys[-1], side


def strobe_one(state, tolerance):
    """Map one state through a period."""

    def going(carry):
        time, _, count, _, _ = carry
        return (time < PERIOD) & (count < CAP)

    def turn(carry):
        time, y, count, sides, times = carry
        time, y, side = fly(time, y, state[2], tolerance)
        hit = side != 0
        y = jnp.where(hit, jnp.stack([side.astype(y.dtype), -RESTITUTION * y[1]]), y)
        sides = sides.at[count].set(side)
        times = times.at[count].set(jnp.where(hit, time, jnp.inf))
        return jnp.where(hit, time, PERIOD), y, count + hit, sides, times

    start = (jnp.zeros(()), state[:2], 0, jnp.zeros(CAP, jnp.int8), jnp.full(CAP, jnp.inf))
    _, y, _, sides, times = jax.lax.while_loop(going, turn, start)
    return Strobes(y, sides, times)


strobe_batch = jax.jit(jax.vmap(strobe_one, in_axes=(0, None)))


def strobe(states, tolerance=1e-9):
    """Map (n, 3) states x, x', A through one period with rtol = atol = tolerance; returns Strobes."""
    return jax.tree.map(np.asarray, strobe_batch(states, tolerance))
