"""Random grazings of strongly damped scenes, and long simulations beside them."""

import numpy as np

import jaxvibro as jv
from jaxvibro.branches.scenario import grazing_return_of
from jaxvibro.problem.added_impact_orbits import added_impact_orbits
from jaxvibro.problem.orbit_point import orbit_from_point
from tests.special_points import grazing_reference

GRADUAL = "OVERLAPPING", "ADDING", "CHAOS"
NAMES = "amplitude", "frequency", "damping", "right.position", "right.motion.amplitude"
EARLY = 0.1  # time before a contact at which simulations begin
SETTLED, KEPT = 3000, 300  # returns of a long simulation


def _strongly_damped(rng, low, high):
    """Return a random scene with a damping between low and high, one wall or two, the right one perhaps moving."""
    gamma, omega, r = rng.uniform((low, 0.8, 0.2), (high, 5.0, 0.95))
    position, walls = rng.uniform(0.3, 1.5), rng.integers(4)
    motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0.0, 6.28), int(rng.integers(1, 3))) if walls == 1 else None
    left = {2: jv.Wall(-position, r), 3: jv.Wall(-1.3 * position, 0.5)}.get(int(walls))
    return jv.make_scene(0.1, omega, gamma, r, (left, jv.Wall(position, r, motion=motion)))


def draw_grazing(rng, damping, outcomes, is_free=False):
    """Return a first grazing along a random parameter, with one of the outcomes.

    is_free: of the motion without impacts, at one wall.
    """
    while True:
        scene = _strongly_damped(rng, *damping)
        point = _first_grazing(scene, "amplitude", (0.0, 40.0 * float(scene.frequency) ** 2))
        name = str(rng.choice([name for name in NAMES if name in scene.names]))
        if point is not None and name != "amplitude":
            point = _along(point, name)
        if point is None or (is_free and len(point.spot.times)):
            continue
        scenario = jv.scenario(point)
        if scenario.follows.name in outcomes and not (is_free and scenario.half):
            return point


def _first_grazing(scene, name, bounds):
    """Return the first grazing of the motion from rest, None without one."""
    try:
        branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), name, bounds, stop="GR")
    except (jv.OrbitError, jv.ArgumentError):
        return None
    return next(iter(branch.points("GR")), None)


def _along(point, name):
    """Return the same grazing along another parameter."""
    value, scene = float(point.scene.parameter(name)), point.scene.replace(amplitude=point.value * (1.0 - 1e-3))
    room = 0.05 * (abs(value) + 0.1)
    return _first_grazing(scene, name, (value, value + room)) or _first_grazing(scene, name, (value - room, value))


def followed_window(point, window):
    """Return the GR at which the branch of a window's orbit touches the wall, None where it does not come there."""
    room = sorted((point.value, window.found + 0.1 * (window.found - point.value)))
    step = 0.05 * np.sqrt(abs(window.found - point.value))
    branch = jv.follow(window.orbit, point.name, room, first_step=step, largest_step=2 * step)
    last = min(branch.points("GR"), key=lambda other: abs(other.value - window.found), default=None)
    is_near = last is not None and abs(last.value - window.found) <= 1e-3 * abs(window.found - point.value)
    return last if is_near else None


def state_before(point):
    """Return the State of the motion without impacts, EARLY before its grazing."""
    time = grazing_reference(point, False)[0] - EARLY
    start = jv.State(float(point.spot.x), float(point.spot.v))
    states, _ = jv.sample(point.scene, start, np.array([time % (2.0 * np.pi / float(point.scene.frequency))]))
    return jv.State(float(states.x[0]), float(states.v[0]), float(point.scene.frequency) * time)


def attractor_distance(point, depth):
    """Return how far a long simulation comes from the orbit without the contact, at a depth of the contact."""
    scene = point.scene.replace(**{point.name: point.value + depth / jv.scenario(point).rate})
    start = state_before(point)
    state, _ = jv.strobe(scene, start, SETTLED)
    distance = 0.0
    for _ in range(KEPT):
        state, _ = jv.strobe(scene, state, 1)
        distance = max(distance, np.hypot(float(state.x) - start.x, float(state.v) - start.v))
    return distance


def orbit_with_added_impact(point, returns, speed):
    """Return the orbit with one impact of a speed in so many returns, None where it is not reached or inadmissible."""
    orbits = added_impact_orbits(grazing_return_of(point), returns)
    z = orbits.grazing_z
    for share in np.linspace(0.1, 1.0, 10):
        solution = orbits.point_at_speed(z, share * speed)
        if not solution.converged:
            return None
        z = solution.z
    if not orbits.closest_approach(z)[0]:
        return None
    row = orbits.orbit_point_at(z, solution.residual)
    return orbit_from_point(point.scene.replace(**{point.name: row.value}), row)
