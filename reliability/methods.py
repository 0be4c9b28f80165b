"""Define the methods, each as its users would write it: the first wall that a flight hits until a time, and when.

Every method takes `Flights` and a setting and returns `Met`. SciPy, diffrax and heyoka stop at an event; the paper's
method steps until the mass is beyond a wall.
"""

import functools
import math
from typing import NamedTuple

import diffrax
import heyoka
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

import jaxvibro as jv

RESTITUTION = 0.7
STEPS = 16_384  # largest number of steps of one flight by diffrax
HALVINGS = 20  # bisections of the paper's last step, to 1e-6 of it


class Met(NamedTuple):
    """First contacts, (lanes,) each: side of the wall, 0 for none, and time, inf for never.

    x and v are those at the contact, or at `until`; this package, which maps whole periods, omits them.
    """

    side: np.ndarray
    time: np.ndarray
    x: np.ndarray | None = None
    v: np.ndarray | None = None


def none_met(flights):
    """Return a `Met` without contacts, to be filled in."""
    count = len(flights.until)
    return Met(np.zeros(count, int), np.full(count, np.inf), flights.lanes.x.copy(), flights.lanes.v.copy())


def scene_of(flights, dtype=None):
    """Return this package's scene of flights."""
    walls = {}
    for wall in flights.walls:
        motion = jv.Motion(wall.swing, wall.phase, wall.harmonic) if wall.harmonic else None
        walls[wall.side] = jv.Wall(wall.position, motion=motion)
    lanes = flights.lanes
    pair = walls.get(-1), walls.get(1)
    return jv.make_scene(lanes.amplitude, lanes.omega, lanes.gamma, RESTITUTION, pair, dtype=dtype)


def ours(flights, dtype=None):
    """Find the contacts with this package, which maps the whole period."""
    given = jv.State(*(jnp.asarray(each, dtype) for each in flights.lanes[4:] + flights.lanes[3:4]))
    _, impacts = jv.strobe(scene_of(flights, dtype), given, slots=1)
    time, side = (np.asarray(each)[:, 0] for each in (impacts.time, impacts.side))
    seen = time <= flights.until
    return Met(np.where(seen, side, 0), np.where(seen, time, np.inf))


def by_scipy(flights, tolerance):
    """Find the contacts by DOP853 with a terminal event per wall, one flight at a time."""
    found = none_met(flights)
    for lane, (gamma, omega, amplitude, phase, x, v) in enumerate(zip(*flights.lanes, strict=True)):

        def field(t, y, gamma=gamma, omega=omega, amplitude=amplitude, phase=phase):
            return y[1], amplitude * math.cos(phase + omega * t) - y[0] - 2.0 * gamma * y[1]

        events = [_event(wall, lane, omega, phase) for wall in flights.walls]
        given = {"events": events, "rtol": tolerance, "atol": tolerance}
        piece = solve_ivp(field, (0.0, flights.until[lane]), (x, v), "DOP853", **given)
        found.x[lane], found.v[lane] = piece.y[:, -1]
        for wall, times in zip(flights.walls, piece.t_events, strict=True):
            if piece.status == 1 and len(times):
                found.side[lane], found.time[lane] = wall.side, times[0]
    return found


def _event(wall, lane, omega, phase):
    place, swing, turn, side, harmonic = (
        wall.position[lane],
        wall.swing[lane],
        wall.phase[lane],
        wall.side,
        wall.harmonic,
    )

    def event(t, y):
        return side * (y[0] - place - swing * math.cos(harmonic * (phase + omega * t) + turn))

    event.terminal, event.direction = True, 1.0
    return event


def by_diffrax(flights, tolerance):
    """Find the contacts by Tsit5 with an Event per wall and a root finder, all flights at once."""
    walls = tuple((wall.position, wall.swing, wall.phase) for wall in flights.walls)
    still = tuple((wall.side, wall.harmonic) for wall in flights.walls)
    return Met(*map(np.array, _diffrax(tuple(flights.lanes), walls, flights.until, tolerance, still)))


@functools.partial(jax.jit, static_argnames="still")
def _diffrax(lanes, walls, until, tolerance, still):
    def one(lane, walls, until):
        gamma, omega, amplitude, phase, x, v = lane

        def field(t, y, args):
            return jnp.stack([y[1], amplitude * jnp.cos(phase + omega * t) - y[0] - 2.0 * gamma * y[1]])

        def event(side, harmonic, place, swing, turn):
            def reach(t, y, args, **_):
                return side * (y[0] - place - swing * jnp.cos(harmonic * (phase + omega * t) + turn))

            return reach

        events = tuple(event(*one, *numbers) for one, numbers in zip(still, walls, strict=True))
        piece = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            0.0,
            until,
            None,
            jnp.stack([x, v]),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=diffrax.Event(events, optimistix.Newton(1e-14, 1e-14), direction=True),
            adjoint=diffrax.ForwardMode(),
            max_steps=STEPS,
            throw=False,
        )
        side = sum(jnp.where(mask, way, 0) for mask, (way, _) in zip(piece.event_mask, still, strict=True))
        return side, jnp.where(side != 0, piece.ts[-1], jnp.inf), *piece.ys[-1]

    return jax.vmap(one)(lanes, walls, until)


@functools.cache
def _heyoka(still, tolerance):
    x, v = heyoka.make_vars("x", "v")
    gamma, omega, amplitude, phase = (heyoka.par[k] for k in range(4))
    angle = phase + omega * heyoka.time
    events = []
    for k, (side, harmonic) in enumerate(still):
        place, swing, turn = (heyoka.par[4 + 3 * k + j] for j in range(3))
        where = place + swing * heyoka.cos(harmonic * angle + turn) if harmonic else place
        events.append(heyoka.t_event(side * (x - where), direction=heyoka.event_direction.positive))
    equations = [(x, v), (v, amplitude * heyoka.cos(angle) - x - 2.0 * gamma * v)]
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=events)


def by_heyoka(flights, tolerance):
    """Find the contacts by heyoka's Taylor integrator with a terminal event per wall, one flight at a time."""
    still = tuple((wall.side, wall.harmonic) for wall in flights.walls)
    integrator = _heyoka(still, tolerance)
    found = none_met(flights)
    numbers = [part for wall in flights.walls for part in wall[2:]]
    parameters = np.stack([*flights.lanes[:4], *numbers], -1)
    for lane, until in enumerate(flights.until):
        integrator.time, integrator.pars[:] = 0.0, parameters[lane, : len(integrator.pars)]
        integrator.state[:] = flights.lanes.x[lane], flights.lanes.v[lane]
        integrator.reset_cooldowns()
        event = -1 - int(integrator.propagate_until(until)[0])  # index of the event that stopped it
        if 0 <= event < len(still):
            found.side[lane], found.time[lane] = still[event][0], integrator.time
        found.x[lane], found.v[lane] = integrator.state
    return found


def by_paper(flights, steps):
    """Find the contacts by the paper's Runge-Kutta method with `steps` steps per period.

    It steps until the mass is beyond a wall, then halves the step.
    """
    length = 2.0 * np.pi / flights.lanes.omega / steps
    found, time, going = none_met(flights), np.zeros(len(length)), np.flatnonzero(flights.until > 0)
    while going.size:
        lanes, step = flights.some(going), np.minimum(length[going], flights.until[going] - time[going])
        x, v, begun = found.x[going], found.v[going], time[going]
        side = _beyond(lanes, _step(lanes.lanes, x, v, begun, step)[0], begun + step)
        met = side != 0
        if met.any():
            step = np.where(met, _bracketed(lanes, x, v, begun, step), step)
        found.x[going], found.v[going] = _step(lanes.lanes, x, v, begun, step)
        time[going] += step
        found.side[going[met]], found.time[going[met]] = side[met], time[going[met]]
        going = going[~met & (time[going] < flights.until[going] * (1 - 1e-12))]
    return found


def _beyond(flights, x, t):
    """Return the side of the wall beyond which a position lies at a time, 0 for none."""
    found = np.zeros(len(x), int)
    for wall in flights.walls:
        angle = wall.harmonic * (flights.lanes.phase + flights.lanes.omega * t) + wall.phase
        place = wall.position + (wall.swing * np.cos(angle) if wall.harmonic else 0.0)
        found = np.where(wall.side * (x - place) > 0, wall.side, found)
    return found


def _bracketed(flights, x, v, t, step):
    """Return the fraction of a step after which the mass is beyond, by bisection."""
    low, high = np.zeros_like(step), step
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        past = _beyond(flights, _step(flights.lanes, x, v, t, middle)[0], t + middle) != 0
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    return high


def _step(lanes, x, v, t, h):
    """Take a Runge-Kutta step of order 4."""

    def pull(x, v, t):
        return lanes.amplitude * np.cos(lanes.phase + lanes.omega * t) - x - 2.0 * lanes.gamma * v

    a1 = pull(x, v, t)
    v2 = v + 0.5 * h * a1
    a2 = pull(x + 0.5 * h * v, v2, t + 0.5 * h)
    v3 = v + 0.5 * h * a2
    a3 = pull(x + 0.5 * h * v2, v3, t + 0.5 * h)
    v4 = v + h * a3
    a4 = pull(x + h * v3, v4, t + h)
    return x + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


class Method(NamedTuple):
    """Method: name, function of Flights that returns `Met`, and number of flights."""

    name: str
    met: functools.partial
    lanes: int


OURS = "jaxvibro"
RIVALS = (
    Method("heyoka, tol 1e-9", functools.partial(by_heyoka, tolerance=1e-9), 20_000),
    Method("heyoka, tol 1e-15", functools.partial(by_heyoka, tolerance=1e-15), 20_000),
    Method("diffrax Tsit5, tol 1e-6", functools.partial(by_diffrax, tolerance=1e-6), 4000),
    Method("diffrax Tsit5, tol 1e-10", functools.partial(by_diffrax, tolerance=1e-10), 4000),
    Method("SciPy DOP853, tol 1e-6", functools.partial(by_scipy, tolerance=1e-6), 2000),
    Method("SciPy DOP853, tol 1e-12", functools.partial(by_scipy, tolerance=1e-12), 2000),
    Method("paper's RK4, 100 steps a period", functools.partial(by_paper, steps=100), 4000),
    Method("paper's RK4, 800 steps a period", functools.partial(by_paper, steps=800), 4000),
)
