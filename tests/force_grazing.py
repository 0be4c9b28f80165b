"""Impacts of a pendulum just before it turns back, by their depth: which are seen, ours and others'."""

import functools
import math
from typing import NamedTuple

import diffrax
import heyoka
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import optimistix
from mpmath import mp, mpf
from scipy.integrate import solve_ivp

import jaxvibro as jv

FREQUENCY = 1.0  # of a drive of no size: its period ends before the pendulum is at its wall once more
PERIOD = 2 * math.pi / FREQUENCY
DECADES = range(-13, -2)


class Flights(NamedTuple):
    """(lanes,) each: the wall; where a flight begins, and how fast; how deep behind the wall the turning point would
    be, or before it; whether the wall is hit."""

    wall: np.ndarray
    x: np.ndarray
    v: np.ndarray
    depth: np.ndarray
    hits: np.ndarray

    def some(self, lanes):
        return Flights(*(each[lanes] for each in self))


def drawn(count, seed):
    """Flights towards a wall on the right, as many of each decade; half of them turn back just before it."""
    rng = np.random.default_rng(seed)
    depth = 10.0 ** (DECADES[0] + len(DECADES) * (np.arange(count) + rng.random(count)) / count)
    speed, hits = rng.uniform(0.3, 1.8, count), rng.random(count) < 0.5
    with mpmath.workdps(30):
        tops = np.array([float(2 * mp.asin(mpf(each) / 2)) for each in speed])
        start = -rng.uniform(0.2, 0.9, count) * tops
        fast = np.array(
            [float(mp.sqrt(mpf(a) ** 2 - 4 * mp.sin(mpf(b) / 2) ** 2)) for a, b in zip(speed, start, strict=True)]
        )
    return Flights(tops + np.where(hits, -depth, depth), start, fast, depth, hits)


def ours(flights):
    """Which flights meet the wall."""
    force = jv.Force("pendulum", {"damping": 0.0})
    scene = jv.make_scene(0.0, FREQUENCY, restitution=0.7, walls=(None, flights.wall), force=force)
    return np.asarray(jv.strobe(scene, jv.State(flights.x, flights.v), slots=2)[1].count) > 0


def by_scipy(flights, tolerance=1e-12):
    """The same by DOP853 with an event."""

    def field(t, y, wall):
        return y[1], -math.sin(y[0])

    def event(t, y, wall):
        return y[0] - wall

    event.terminal, event.direction = True, 1.0
    met = []
    for wall, x, v, *_ in zip(*flights, strict=True):
        given = {"events": event, "args": (wall,), "rtol": tolerance, "atol": tolerance}
        met.append(solve_ivp(field, (0.0, PERIOD), (x, v), "DOP853", **given).status == 1)
    return np.array(met)


def by_heyoka(flights, tolerance=1e-16):
    """The same by heyoka's Taylor integrator with a terminal event."""
    x, v = heyoka.make_vars("x", "v")
    met = []
    event = heyoka.t_event(x - heyoka.par[0], direction=heyoka.event_direction.positive)
    equations = [(x, v), (v, -heyoka.sin(x))]
    integrator = heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=[event])
    for wall, place, speed, *_ in zip(*flights, strict=True):
        integrator.time, integrator.pars[0], integrator.state[:] = 0.0, wall, (place, speed)
        integrator.reset_cooldowns()
        met.append(integrator.propagate_until(PERIOD)[0] != heyoka.taylor_outcome.time_limit)
    return np.array(met)


def by_diffrax(flights, solver="Tsit5", tolerance=1e-12):
    """The same by diffrax with Event."""

    def met(wall, x, v):
        piece = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: jnp.stack([y[1], -jnp.sin(y[0])])),
            getattr(diffrax, solver)(),
            0.0,
            PERIOD,
            None,
            jnp.stack([x, v]),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=diffrax.Event(lambda t, y, args, **_: y[0] - wall, optimistix.Newton(1e-14, 1e-14), direction=True),
            adjoint=diffrax.ForwardMode(),
            max_steps=100_000,
            throw=False,
        )
        return piece.event_mask

    return np.asarray(jax.jit(jax.vmap(met))(flights.wall, flights.x, flights.v))


RIVALS = {
    "diffrax Tsit5, 1e-12": by_diffrax,
    "diffrax Dopri8, 1e-12": functools.partial(by_diffrax, solver="Dopri8"),
    "SciPy DOP853, 1e-12": by_scipy,
    "heyoka, 1e-16": by_heyoka,
}


def grazing(count, seed=0, beside=200):
    """Print which impacts are missed and which are invented, decade by decade: ours of all flights, the others' of so
    many a decade (missed/invented of hits/turns)."""
    flights = drawn(count, seed)
    decade = np.floor(np.log10(flights.depth)).astype(int)
    few = np.concatenate([np.flatnonzero(decade == each)[:beside] for each in DECADES])
    answers = {"jaxvibro": (np.arange(count), ours(flights))}
    answers |= {name: (few, rival(flights.some(few))) for name, rival in RIVALS.items()}
    force = jv.Force("pendulum", {"damping": 0.0})
    print(f"the stated depth is at most {2 * force.tolerance * max(flights.wall):.1e}")
    print("depth from", *answers, sep=" | ")
    for low in DECADES:
        cells = []
        for lanes, met in answers.values():
            hits, here = flights.hits[lanes], decade[lanes] == low
            missed, invented = (here & hits & ~met).sum(), (here & ~hits & met).sum()
            cells.append(f"{missed}/{invented} of {(here & hits).sum()}/{(here & ~hits).sum()}")
        print(f"1e{low}", *cells, sep=" | ", flush=True)
