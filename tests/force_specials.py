"""Special points under user-defined forces against their equations in 30 digits, and of a ball that bounces on a table
against closed forms."""

import jax
import mpmath
import numpy as np
from mpmath import mpf

import jaxvibro as jv

from .reference import own_force_points as reference

KINDS = ("SN", "SB", "PD", "GR")
RANGES = {"amplitude": (1.0, 5.0), "cubic": (0.1, 2.0), "damping": (0.02, 0.3), "frequency": (1.2, 3.2)}
BALL = {"g": (0.5, 3.0), "restitution": (0.2, 0.95), "frequency": (0.6, 4.0)}


def duffing(walls=(-1.0, 1.0), amplitude=2.0, cubic=0.5, damping=0.05, frequency=2.1, restitution=0.7):
    """Return a Duffing oscillator between walls."""
    force = jv.Force("duffing", {"cubic": cubic, "damping": damping})
    return jv.make_scene(amplitude, frequency, restitution=restitution, walls=walls, force=force)


def case_of(point):
    """Return the reference's form of a special point; each wall has a restitution of its own there."""
    scene = point.scene
    assert point.orbit.state.phase == 0.0
    numbers = {name: float(scene.parameter(name)) for name in scene.names if name != "restitution"}
    for side, wall in scene.walls.items():
        own = scene.restitution if wall.restitution is None else wall.restitution
        if wall.law is None:
            numbers[f"{side}.restitution"] = float(own)
    return reference.Case(point.kind, scene.force.function.__name__, numbers, point.name, point.spot.periods)


def case_and_start(point):
    """Return the `Case` of a special point and (x, v, value)."""
    case, state = case_of(point), point.orbit.state
    given = tuple(map(mpf, (float(state.x), float(state.v), point.value)))
    return (reference.touching(case, *given) if point.kind == "GR" else case), given


def residual(point):
    """Return how far a special point and its orbit are from their equations, by series in many digits."""
    with mpmath.workdps(reference.DIGITS):
        case, given = case_and_start(point)
        return max(abs(float(each)) for each in case.equations(given))


def special_point(rng):
    """Return a special point of a random Duffing oscillator with two impacts a period at most."""
    for _ in range(100):
        name, places = str(rng.choice(["amplitude", "force.cubic"])), (-rng.uniform(0.5, 1.3), rng.uniform(0.3, 1.3))
        alike, own = rng.random() < 0.3, rng.uniform(0.5, 0.9, 2)
        walls = jv.Wall(-places[1] if alike else places[0], own[int(alike)]), jv.Wall(places[1], own[1])
        scene = duffing(walls, **{each: rng.uniform(*ends) for each, ends in RANGES.items()})
        try:
            orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
        except jv.OrbitError:
            continue
        if orbit.periods > 1 or orbit.impacts.count > 2:
            continue
        value = float(scene.parameter(name))
        special = jv.follow(orbit, name, (0.3 * value, 2.0 * value)).special
        points = [
            point
            for point in special
            if point.kind in KINDS and len(point.spot.times) <= 2 and point.orbit.state.phase == 0.0
        ]
        if points:
            return points[int(rng.integers(len(points)))]
    raise AssertionError("no special point among 100 scenes")


def gradient_errors(point):
    """Return {name: relative error of the derivative by a parameter}, and the error of the value as "value"."""
    slopes = jax.grad(jv.located(point))(point.scene)
    with mpmath.workdps(reference.DIGITS):
        case, given = case_and_start(point)
        directions = directions_of(point, case)
        exact = case.gradient(given, directions)
        errors = {"value": abs(float(exact.pop("value")))}
    for name, direction in directions.items():
        computed = sum(sign * float(slopes.parameter(each)) for each, sign in direction)
        errors[name] = float(abs(computed - exact[name]) / (1 + abs(exact[name])))
    return errors


def directions_of(point, case):
    """Return {name: [(parameter, weight)]}: in a symmetric scene, and of contact laws, both walls change together."""
    directions = {}
    for name in case.numbers:
        side, _, own = name.partition(".")
        both = point.kind == "SB" or own.startswith("law.")
        if name == point.name or (both and side == "left"):
            continue
        directions[name] = [(name, 1)]
        if both and side == "right":
            directions[name].append((f"left.{own}", -1 if own == "position" else 1))
    return directions


def gravity(t, x, v, p):
    return -p["g"]


def bounced(rng, periods=1, side=-1, place=None):
    """Return the orbit of a ball that bounces once in some periods of its table, and {kind: the swing of the table}.

    It comes with the speed g T / 2 and leaves with as much, T being the time of a flight: so the table, which moves as
    a cos(psi), goes against it with s = (g T / 2) (1 - R) / (1 + R) at an impact, where -a omega sin(psi) = s. The map
    of the impacts' (time, speed after) has there the determinant R^2 and the trace 1 + R^2 - (1 + R)^2 a omega^2
    cos(psi) / g, as the time between impacts changes by (1 + R) / g times the speed: an SN where cos(psi) = 0, a PD
    where the trace is -1 - R^2. side: that of the table; on the right g is below 0. place: its middle.
    """
    g, bounce, omega = (rng.uniform(*ends) for ends in BALL.values())
    phase, place = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-1.0, 1.0) if place is None else place
    flight = 2.0 * np.pi * periods / omega
    least = 0.5 * g * flight * (1.0 - bounce) / (1.0 + bounce) / omega
    known = {"SN": least, "PD": np.hypot(least, 2.0 * g * (1.0 + bounce**2) / (omega * (1.0 + bounce)) ** 2)}
    swing = 0.5 * sum(known.values())
    psi = -np.arcsin(least / swing)
    late = (phase + (side > 0) * np.pi - psi) % (2.0 * np.pi) / omega  # since the impact, at phase 0
    height = swing * np.cos(psi) + 0.5 * g * late * (flight - late)
    state = jv.State(place - side * height, -side * g * (0.5 * flight - late))
    table = jv.Wall(place, bounce, motion=jv.Motion(swing, phase))
    walls = (table, None) if side < 0 else (None, table)
    force = jv.Force(gravity, {"g": -side * g})
    scene = jv.make_scene(0.0, omega, restitution=0.5, walls=walls, force=force)
    return jv.find_orbit(scene, state, periods, settle=0), known
