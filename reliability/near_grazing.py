"""Measure contacts by depth, hops by speed, and derivatives by the distance to a grazing."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

import jaxvibro as jv
from benchmarks.work import GAMMA, OMEGA, PERIOD, RESTITUTION

from . import cases, exact_flow, methods, periods
from .curves import Curves, by_decade
from .exact_flow import LONG, Lanes
from .periods import Scenes

A, START = 3.0, (-0.3, 0.4)  # of the grazing flight, which turns once at the right and hits no other wall
STEP = 1e-6  # step of finite differences
DEPTHS = 10.0 ** np.arange(-13.0, -1.5, 0.5)


def every(batch):
    """Yield (name, flights, Met) of this package and the others, each with its number of flights."""
    yield methods.OURS, batch, methods.ours(batch)
    for rival in methods.RIVALS:
        some = batch.some(slice(rival.lanes))
        yield rival.name, some, rival.met(some)


def missed_by_depth(size):
    """Return the `Curves` of the fraction of missed contacts, by their depth."""
    lines = {}
    batch, _ = cases.WHOLE.batch(size.states(20_000), 0)
    for name, some, met in every(batch):
        hits = (some.measure > 0) & (some.side != 0)
        lines[name] = by_decade(some.measure[hits], (met.side == 0)[hits], -15, -2, np.mean)
    return Curves(
        "Contacts in flights of up to 5 time units, random scenes",
        "depth of the contact (lengths)",
        "fraction missed",
        lines,
        log=False,
    )


def error_by_speed(size):
    """Return the `Curves` of the error of the time of the next impact of a hop, by its speed."""
    case, lines = next(each for each in cases.CASES if each.name == "slow impacts"), {}
    batch, _ = case.batch(size.states(20_000), 0)
    for name, some, met in every(batch):
        error = abs(np.where(met.side != 0, met.time, np.nan) / some.time - 1.0)
        if np.isfinite(error).any():
            lines[name] = by_decade(some.measure, error, -8, -1, np.nanmedian)
    return Curves(
        "Bounces from a wall and back to it",
        "speed of departure from the wall",
        "median relative error of the flight time",
        lines,
        least=1e-17,
        failed="error 1: the start is found again. heyoka detects none of these bounces",
    )


def grazing():
    """Return (time, position) of the turning point of the flight from START, in 80-bit floats."""
    lanes, grid = lanes_of(*START), np.linspace(0.0, PERIOD, 4001)
    many = Lanes(*(np.repeat(each, len(grid)) for each in lanes))
    t = grid[[np.argmax(exact_flow.fly(many, grid)[0])]].astype(LONG)
    for _ in range(4):
        x, v = exact_flow.fly(lanes, t)
        t = t - v / exact_flow.acceleration(lanes, x, v, t)
    return t, exact_flow.fly(lanes, t)[0]


def lanes_of(x, v, amplitude=A, phase=0.0):
    """Return one lane of the scene."""
    return Lanes(*(np.atleast_1d(np.asarray(each, float)) for each in (GAMMA, OMEGA, amplitude, phase, x, v)))


def derivative_of_flight(t):
    """Return the derivative of x, v after a time by the initial ones: the columns are flights without a drive."""
    return np.stack(
        [np.concatenate(exact_flow.fly(lanes_of(*unit, amplitude=0.0), t)) for unit in ((1, 0), (0, 1))], -1
    )


def true_derivative(wall):
    """Return the derivative of the map with one contact: flight, saltation (paper, equation 35), flight."""
    lanes, (turn, _) = lanes_of(*START), grazing()
    where, period = LONG(wall), LONG(PERIOD)
    depth = exact_flow.fly(lanes, turn)[0] - where
    bend = abs(exact_flow.acceleration(lanes, *exact_flow.fly(lanes, turn), turn))
    t = turn - np.sqrt(2.0 * depth / bend)
    for _ in range(8):
        x, v = exact_flow.fly(lanes, t)
        t = t - (x - where) / v
    _, v = exact_flow.fly(lanes, t)
    r = LONG(RESTITUTION)
    before, after = (exact_flow.acceleration(lanes, where, speed, t) for speed in (v, -r * v))
    saltation = np.array([[-r, 0.0], [((after + r * before) / v)[0], -r]], LONG)
    return derivative_of_flight(period - t) @ saltation @ derivative_of_flight(t)


def ours_by_autodiff(wall):
    scene = jv.make_scene(A, OMEGA, GAMMA, RESTITUTION, (None, wall))
    return _jacobian(scene, jnp.array(START))


@jax.jit
def _jacobian(scene, start):
    def end(start):
        state, _ = jv.strobe(scene, jv.State(start[0], start[1]), slots=0)
        return jnp.stack([state.x, state.v])

    return jax.jacfwd(end)(start)


def ours_by_product(wall):
    return jv.monodromy(jv.make_scene(A, OMEGA, GAMMA, RESTITUTION, (None, wall)), jv.State(*START))


@functools.partial(jax.jit, static_argnames="tolerance")
def by_diffrax(wall, tolerance):
    """Compute forward derivatives through diffrax's event and root finder, from one impact to the end of the period."""

    def piece(start, begin, event):
        return diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: jnp.stack([y[1], A * jnp.cos(OMEGA * t) - y[0] - 2 * GAMMA * y[1]])),
            diffrax.Tsit5(),
            begin,
            PERIOD,
            None,
            start,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=event,
            adjoint=diffrax.ForwardMode(),
            max_steps=4096,
            throw=False,
        )

    def end(start):
        event = diffrax.Event(lambda t, y, args, **_: y[0] - wall, optimistix.Newton(1e-14, 1e-14), direction=True)
        first = piece(start, 0.0, event)
        y = first.ys[-1]
        y = jnp.where(first.event_mask, jnp.stack([y[0], -RESTITUTION * y[1]]), y)
        return piece(y, first.ts[-1], None).ys[-1]

    return jax.jacfwd(end)(jnp.array(START))


def by_differences(wall, method):
    """Compute central differences of a method's map."""
    ends = []
    for k in (0, 1):
        for sign in (1.0, -1.0):
            start = np.array(START)
            start[k] += sign * STEP
            numbers = (np.atleast_1d(each) for each in (A, OMEGA, GAMMA, RESTITUTION, -50.0, wall, *start))
            found = method(Scenes(*(np.asarray(each, float) for each in numbers)))
            ends.append(np.concatenate([found.x, found.v]))
    return np.stack([(ends[0] - ends[1]), (ends[2] - ends[3])], -1) / (2.0 * STEP)


def derivative_error(size):
    """Return the `Curves` of the relative error of the map's derivative at one contact, by the depth of the contact."""
    scipy = next(each.met for each in methods.RIVALS if each.name == "SciPy DOP853, tol 1e-12")
    ways = {
        methods.OURS: ours_by_autodiff,
        f"{methods.OURS}, product of flights and impacts": ours_by_product,
        "heyoka, tol 1e-15, differences": functools.partial(
            by_differences, method=functools.partial(periods.by_heyoka, tolerance=1e-15)
        ),
        "diffrax Tsit5, tol 1e-10, autodiff": functools.partial(by_diffrax, tolerance=1e-10),
        "SciPy DOP853, tol 1e-12, differences": functools.partial(
            by_differences, method=functools.partial(periods.by_flights, scipy)
        ),
    }
    (_, top), depths, lines = grazing(), size.few(list(DEPTHS)), {}
    for name, way in ways.items():
        errors = []
        for depth in depths:
            wall = float(top[0] - depth)
            true = true_derivative(wall)
            errors.append(float(np.max(abs(np.asarray(way(wall)) - true)) / np.max(abs(true))))
        lines[name] = np.array(depths), np.array(errors)
    return Curves(
        "Derivative of a period with one contact with respect to the initial state",
        "depth of the contact (lengths)",
        "error relative to the largest entry",
        lines,
        least=1e-17,
        failed=f"error 1: the contact is missed. Differences with steps of {STEP:g}",
    )


def on_the_other_side():
    """Return [(distance, error of this package)] where the flight just misses the wall."""
    (_, top), true, found = grazing(), derivative_of_flight(LONG(PERIOD)), []
    for gap in (1e-2, 1e-6, 1e-10, 1e-13, 2e-15, 0.0):
        error = np.max(abs(np.asarray(ours_by_autodiff(float(top[0] + gap))) - true)) / np.max(abs(true))
        found.append((gap, float(error)))
    return found
