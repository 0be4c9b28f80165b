"""Orbits of random scenes for the properties, and their simulation in batches of one shape."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.scene.state import Status
from tests.kinds import LANES

from .motions import SLOTS, strobe, take

TRIES = 12  # scenes that are tried for a draw
MOST_PERIODS = 4
MOST_IMPACTS = 6
STEEP = 1e5  # norm of a monodromy matrix: beyond it a simulation leaves the orbit within a period


@cache
def settled_orbit(kind, number):
    """Return an orbit with impacts on which a random scene settles; without impacts for few draws."""
    fallback = None
    for seed in range(TRIES * number, TRIES * (number + 1)):
        scene, state = kind.draw_single(seed)
        try:
            orbit = jv.find_orbit(scene, state)
        except jv.OrbitError:
            continue
        if orbit.periods > MOST_PERIODS or orbit.impacts.count > MOST_IMPACTS:
            continue
        if orbit.impacts.count:
            return orbit
        fallback = fallback or orbit
    assert fallback is not None, "no scene of the draw settles on an orbit"
    return fallback


def stack(kind, orbits):
    """Return at most LANES orbits as a batch of scenes and states of the shape that all properties share."""
    orbits = [*orbits, *[orbits[0]] * (LANES - len(orbits))]
    form = kind.draw(0)[0]
    scenes = [orbit.scene for orbit in orbits]
    scene = jax.tree.map(lambda leaf, *rest: np.array(rest, float) if np.ndim(leaf) else leaf, form, *scenes)
    states = [
        jv.State(*(float(part) for part in (one.x, one.v, one.phase, one.contact)))
        for one in (orbit.state for orbit in orbits)
    ]
    return scene, jax.tree.map(lambda *parts: np.array(parts), *states)


class Simulation:
    """Orbits simulated over their periods by the stroboscopic map.

    ends: the State after the periods of each orbit. words: the walls hit in each period. speeds: of the impacts.
    clearance: the least one. matrices: monodromy, (orbits, 2, 2). derivatives: the same by automatic differentiation,
    if asked for. complete: whether the simulation records all impacts.
    """

    def __init__(self, kind, orbits, differentiate=False):
        orbits, count = list(orbits), len(orbits)
        assert 0 < count <= LANES
        scene, state = stack(kind, orbits)
        self.start = state
        self.ends, self.words, self.speeds = [None] * count, [[] for _ in orbits], [[] for _ in orbits]
        self.clearance, self.complete = np.full(count, np.inf), np.ones(count, bool)
        self.matrices, self.derivatives = (np.tile(np.eye(2), (LANES, 1, 1)) for _ in range(2))
        periods = np.array([orbit.periods for orbit in orbits])
        for period in range(max(periods)):
            active = np.append(periods > period, np.zeros(LANES - count, bool))[:, None, None]
            end, impacts = strobe(scene, state)
            step = np.asarray(jv.monodromy(scene, state, slots=SLOTS))
            self.matrices = np.where(active, step @ self.matrices, self.matrices)
            if differentiate:
                self.derivatives = np.where(active, _jacobian(scene, state) @ self.derivatives, self.derivatives)
            for lane in np.flatnonzero(periods > period):
                hits = impacts.side[lane] != 0
                self.words[lane].append("".join("LR"[int(side > 0)] for side in impacts.side[lane][hits]))
                self.speeds[lane] += impacts.speed[lane][hits].tolist()
                self.clearance[lane] = min(self.clearance[lane], impacts.least_clearance[lane])
                self.complete[lane] &= (impacts.count[lane] <= SLOTS) and impacts.status[lane] < Status.CAP
                self.ends[lane] = take(end, lane)
            state = replace(end, phase=self.start.phase)
        self.matrices, self.derivatives = self.matrices[:count], self.derivatives[:count]

    def miss(self, lane):
        """Return how far the end is from the start."""
        end = self.ends[lane]
        return max(abs(end.x - self.start.x[lane]), abs(end.v - self.start.v[lane]))

    def growth(self, lane):
        """Return how far an error at the start may grow."""
        return 1.0 + np.linalg.norm(self.matrices[lane])


@jax.jit
def _jacobian(scene, state):
    """Return the derivatives of the strobe by x and v, (LANES, 2, 2), by automatic differentiation."""

    def end(x, v):
        last = jv.strobe(scene, replace(state, x=x, v=v), 1, 0)[0]
        return jnp.stack([last.x, last.v], -1)

    ones, zeros = jnp.ones(LANES), jnp.zeros(LANES)
    columns = [jax.jvp(end, (state.x, state.v), tangent)[1] for tangent in ((ones, zeros), (zeros, ones))]
    return jnp.stack(columns, -1)


def size_of(orbit):
    """Return the scale of an orbit, for errors."""
    state = orbit.state
    return 5.0 + abs(float(orbit.scene.amplitude)) + abs(float(state.x)) + abs(float(state.v))


def sorted_roots(values):
    """Return multipliers in the order in which orbits have them."""
    return np.array(sorted(map(complex, values), key=lambda root: (-abs(root), -root.imag)))


def assert_roots_agree(values, matrix, bound):
    """Check that multipliers are the eigenvalues of a matrix: sum and product agree, to a bound of its entries."""
    values, norm = np.asarray(values), np.linalg.norm(matrix)
    assert abs(values.sum() - np.trace(matrix)) <= bound
    assert abs(values.prod() - np.linalg.det(matrix)) <= bound * (1.0 + norm)


def assert_is_orbit(orbit, simulation, lane, tolerance):
    """Check an orbit against its simulation: return, itinerary, label, multipliers, clearance and slowest impact.

    Returns False for an orbit so unstable that the simulation leaves it, or with more impacts than it records.
    """
    growth, size = simulation.growth(lane), size_of(orbit)
    if not growth < STEEP or not simulation.complete[lane]:
        return False
    bound = 1e4 * tolerance * size * growth
    assert simulation.miss(lane) <= bound, (simulation.miss(lane), bound)
    slow = min(simulation.speeds[lane], default=np.inf)
    if orbit.rests:
        assert not np.any(orbit.multipliers) and orbit.stable
        return True
    slack = bound / min(1.0, slow)
    assert tuple(simulation.words[lane]) == tuple(orbit.itinerary)
    walls = "".join(orbit.itinerary)
    numbers = orbit.periods, walls.count("L"), walls.count("R")
    assert orbit.label in (f"P{'-'.join(map(str, numbers))}", f"P{''.join(map(str, numbers))}")
    np.testing.assert_allclose(simulation.speeds[lane], orbit.impacts.speed, rtol=0, atol=slack)
    assert len(orbit.impacts.speed) == orbit.impacts.count and (slow == np.inf or abs(orbit.least_speed - slow) < slack)
    assert orbit.least_clearance == np.inf or abs(orbit.least_clearance - simulation.clearance[lane]) < slack
    assert_roots_agree(orbit.multipliers, simulation.matrices[lane], 10.0 * slack * growth)
    largest = abs(orbit.multipliers[0])
    assert orbit.stable == (largest < 1.0) or abs(largest - 1.0) < 1e-8
    return True
