"""Properties of attractors, exponents, sweeps, basins and manifolds that hold for every kind of scene."""

from contextlib import suppress
from functools import lru_cache

import numpy as np
from scipy import stats

import jaxvibro as jv
from tests.kinds import wall_ends
from tests.plane_curves import distance, points_of
from tests.reference import soft_lanes
from tests.tiers import generator, of_batches, of_numbers

from .motions import assert_close, assert_same, decided

STARTS, FOUND = 24, 4  # random starts; attractors of a scene that are compared
SLOTS = 32
LANES, PERIODS = 16, 96  # copies of each motion, and their length, in the reference of exponents
ANGLES = np.linspace(0.0, 2.0 * np.pi, 4001)
SETTLED = 1000  # periods after which a start is on its attractor


@lru_cache(maxsize=64)
def attractors_of(kind, number):
    """Return a scene and its attractors; the unresolved starts are the last of them, if there are any."""
    scene, _ = kind.draw_single(number)
    return scene, jv.find_attractors(scene, STARTS, number)


def plane(state):
    """Return x and v of states, (..., 2)."""
    return np.stack([np.asarray(state.x), np.asarray(state.v)], -1)


def bounds_of(count):
    """Return the bounds of Clopper and Pearson at 95 %, one-sided for none and for all."""
    level = 0.025 if 0 < count < STARTS else 0.05
    low = stats.beta.ppf(level, count, STARTS - count + 1) if count else 0.0
    return low, stats.beta.isf(level, count + 1, STARTS - count) if count < STARTS else 1.0


@of_numbers
def test_orbits(kind, number):
    """The points of a periodic attractor map onto each other, with its impacts and multipliers; shares sum to 1."""
    scene, attractors = attractors_of(kind, number)
    assert abs(sum(attractor.share for attractor in attractors) - 1.0) < 1e-12
    for attractor in attractors:
        assert attractor.mirror_of is None  # no kind is symmetric
        np.testing.assert_allclose(attractor.share_bounds, bounds_of(round(STARTS * attractor.share)), atol=1e-12)
        if attractor.kind != "periodic":
            assert attractor.orbit is None and attractor.periods == 0
            continue
        n, state, speeds, hits = attractor.periods, attractor.state, [np.inf], {-1: 0, 1: 0}
        for k in range(n):
            matrix = np.asarray(jv.monodromy(scene, state, slots=SLOTS))
            state, impacts = jv.strobe(scene, state, slots=SLOTS)
            bound = 1e-9 * (1.0 + abs(attractor.points).max()) * (1.0 + abs(matrix).max())
            assert abs(plane(state) - attractor.points[(k + 1) % n]).max() < bound
            word = "".join("L" if side < 0 else "R" for side in np.asarray(impacts.side) if side)
            assert attractor.rests or word == attractor.itinerary[k]
            speeds += np.asarray(impacts.speed)[np.asarray(impacts.side) != 0].tolist()
            hits = {side: hits[side] + int((np.asarray(impacts.side) == side).sum()) for side in hits}
        label = [str(count) for count in (n, hits[-1], hits[1])]
        assert attractor.rests or attractor.label == "P" + ("-" if max(map(len, label)) > 1 else "").join(label)
        assert attractor.rests or abs(attractor.least_speed / min(speeds) - 1.0) < 1e-6 or min(speeds) == np.inf
        multipliers = np.linalg.eigvals(np.asarray(jv.monodromy(scene, attractor.state, n, SLOTS)))
        assert abs(np.exp(n * attractor.exponent) - abs(multipliers).max()) < 1e-6 and attractor.exponent < 0.0
        if attractor.orbit is not None:
            assert attractor.orbit.stable and attractor.orbit.periods == n
            assert abs(plane(attractor.orbit.state) - attractor.points).max(-1).min() < 1e-7


@of_numbers
def test_free_response(kind, number):
    """The free response is an attractor if and only if it keeps off the walls, by its closed form."""
    scene, _ = kind.draw_single(number)
    w, rng = scene.frequency, generator(kind, number)
    terms = [(scene.amplitude, 1, 0.0), *((term.amplitude, term.harmonic, term.phase) for term in scene.drive or ())]
    turns = [
        amplitude * np.exp(1j * (m * ANGLES + phase)) / (1.0 - (m * w) ** 2 + 2j * scene.damping * m * w)
        for amplitude, m, phase in terms
    ]
    x, v = sum(turns).real, -w * sum(m * turn.imag for (_, m, _), turn in zip(terms, turns, strict=True))
    size = abs(x).max() + 0.1
    aside = {
        side: size * rng.choice([1.0, -1.0, 1.0]) * 10.0 ** rng.uniform(-4.0, -0.5) for side in scene.walls
    }  # how far each wall is beyond the response; negative: it is hit
    left, right = wall_ends(scene, ANGLES)
    reach = {"left": np.max(left - x), "right": np.max(x - right)}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        if side in scene.walls:
            place = getattr(scene, side).position + sign * (reach[side] + aside[side])
            scene = scene.replace(**{f"{side}.position": float(place)})
    left, right = wall_ends(scene, ANGLES)
    if np.min(right - left) < 0.1 * size:
        return  # the walls would meet
    attractors = [one for one in jv.find_attractors(scene, 4, number) if one.label == "P100" and not one.rests]
    assert len(attractors) == (min(aside.values()) > 0.0)
    for attractor in attractors:
        assert abs(plane(attractor.state) - [x[0], v[0]]).max() < 1e-9 * (1.0 + size)
        slowest = scene.damping - np.sqrt(max(0.0, scene.damping**2 - 1.0))
        assert abs(attractor.exponent + slowest * 2.0 * np.pi / w) < 1e-6


def known_motions(kind, number):
    """Return a scene and FOUND of its attractors that are no unresolved starts; the last one is repeated."""
    scene, attractors = attractors_of(kind, number)
    known = [attractor for attractor in attractors if attractor.kind != "unresolved"][:FOUND]
    return scene, (known + known[-1:] * FOUND)[:FOUND]


def spectrum_of(scene, motions):
    """Return the exponents of motions that start on attractors, one a value."""
    state = jv.State(*(np.array([getattr(one.state, key) for one in motions]) for key in ("x", "v")), 0.0)
    state = jv.State(state.x, state.v, 0.0, np.array([one.state.contact for one in motions]))
    return jv.spectrum(scene, "amplitude", np.full(FOUND, scene.amplitude), state, 0, 0.05, 2**14)


@of_numbers
def test_exponents(kind, number):
    """The exponents are those of multipliers, their sum is what damping, R and soft walls leave."""
    scene, motions = known_motions(kind, number)
    if not motions:
        return
    data = spectrum_of(scene, motions)
    period = 2.0 * np.pi / scene.frequency
    for lane, attractor in enumerate(motions):
        exponents, n = data["exponent"].values[lane], attractor.periods
        error = np.maximum(data["error"].values[lane], 1e-9)
        assert data["periods"].values[lane] == n and exponents[0] >= exponents[1]
        if attractor.rests:
            assert np.isneginf(exponents[1])
            continue
        total, scale = -2.0 * damping_of(scene) * period, 1.0
        for side, wall in scene.walls.items():
            index = list(data["wall"].values).index(side)
            hits, within = (float(data[key].values[lane, index]) for key in ("impacts_on", "within"))
            total += -2.0 * (wall.damping - scene.damping) * within if is_linear_soft(wall) else 0.0
            total += 2.0 * hits * np.log(wall.restitution) if not wall.soft else 0.0
        if n:
            matrix = np.asarray(jv.monodromy(scene, attractor.state, n, SLOTS))
            scale += abs(matrix).max() ** 2 / abs(np.linalg.det(matrix))
            assert abs(exponents[0] - attractor.exponent) < 1e-6
            assert abs(exponents.sum() - np.log(abs(np.linalg.det(matrix))) / n) < max(1e-9, 1e-12 * scale)
        else:
            assert abs(exponents[0] - attractor.exponent) < 5.0 * error[0] + 0.05
        if all(wall.law is None for wall in scene.walls.values()):
            assert abs(exponents.sum() - total) < max(1e-7 * (1 if kind.exact else 100), 1e-12 * scale)


def damping_of(scene):
    """Return the damping of the flight."""
    return scene.damping if scene.force is None else scene.force.numbers["damping"]


def is_linear_soft(wall):
    return wall.soft and wall.law is None


@of_numbers
def test_exponents_by_tangents(kind, number):
    """The exponents are those of tangents that NumPy carries along, with the same impacts and times in soft walls."""
    scene, motions = known_motions(kind, number)
    motions = [attractor for attractor in motions if not attractor.rests]
    if not motions:
        return
    motions = (motions * FOUND)[:FOUND]
    walls = []
    for side, wall in scene.walls.items():
        swing = wall.motion or jv.Motion(0.0)
        rigid = None if wall.soft else wall.restitution
        soft = (wall.stiffness, wall.damping) if wall.soft else (0.0, 0.0)
        moves = swing.amplitude, swing.harmonic, swing.phase
        walls.append(soft_lanes.Wall(-1 if side == "left" else 1, wall.position, rigid, *soft, *moves))
    x, v = (np.repeat([getattr(one.state, key) for one in motions], LANES) for key in ("x", "v"))
    v += 1e-7 * generator(kind, number).normal(size=v.size)
    lanes = soft_lanes.Lanes(scene.amplitude, scene.frequency, scene.damping, walls, x, v)
    growth, hits, within = soft_lanes.exponents(lanes, PERIODS, 0)
    growth = growth.reshape(FOUND, LANES, 2)
    data = spectrum_of(scene, motions)
    errors = np.hypot(growth.std(1, ddof=1) / LANES**0.5, data["error"].values) + 1.0 / PERIODS
    pulls = (data["exponent"].values - growth.mean(1)) / errors
    assert abs(pulls).max() < 5.0
    for index, side in enumerate(data["wall"].values):
        expected = (each[0 if side == "left" else 1].reshape(FOUND, LANES).mean(-1) for each in (hits, within))
        for key, mean in zip(("impacts_on", "within"), expected, strict=True):
            assert (
                abs(data[key].values[:, index] - mean).max()
                < 2.0 / PERIODS + 0.05 * (data["periods"].values == 0).max()
            )


@of_batches
def test_sweep(kind, scene, state):
    """Each lane of a sweep is a motion of its own: it starts a value where the value before has left it."""
    values = np.array([1.0, 0.9, 1.1])[:, None] * scene.amplitude
    data = jv.sweep(scene, "amplitude", values, state, 0, 2)
    assert jv.sweep(scene, "amplitude", values, state, 0, 2, chunk=2).identical(data)
    x, v = (np.moveaxis(data[key].values, 0, 1).reshape(len(values[0]), -1) for key in ("x", "v"))
    start = state
    for k in range(x.shape[1]):
        here = scene.replace(amplitude=values[k // 2])
        end, impacts = jv.strobe(here, start, 1, 8, True)
        keep, bound = decided(kind, here, start, end, impacts)
        assert_close(keep, bound, (x[:, k], end.x), (v[:, k], end.v))
        start = jv.State(x[:, k], v[:, k], state.phase, np.asarray(end.contact))
    later = jv.sweep(scene, "amplitude", values[:1], state, 1, 1)
    assert_same((later["x"].values[0, :, 0], x[:, 1]), (later["v"].values[0, :, 0], v[:, 1]))


@of_numbers
def test_basins(kind, number):
    """A label of a basin is where a run of its start alone ends; the fractions are counts of labels."""
    scene, attractors = attractors_of(kind, number)
    phase = generator(kind, number).choice([0.0, 1.0, 4.0])
    left, right = wall_ends(scene, phase)
    low, high = (end if np.isfinite(end) else other for end, other in ((left, right - 2.0), (right, left + 2.0)))
    x, v = np.linspace(low - 0.2, high + 0.2, 8), np.linspace(-2.0, 2.0, 6)
    data = jv.basins(scene, x, v, phase, attractors)
    label = data["label"].values
    beyond = np.zeros(8, bool)
    for wall, outside in ((scene.left, x < left), (scene.right, x > right)):
        beyond |= outside & (wall is not None and not wall.soft)
    assert_same((label == -2, np.broadcast_to(beyond, label.shape)))
    inside = label >= -1
    shares = np.bincount(label[label >= 0], minlength=len(attractors)) / inside.sum()
    assert abs(data["fraction"].values - shares).max() < 1e-15
    check_labels(scene, data, phase)


def check_labels(scene, data, phase):
    """Check the labels of a basin by runs of its starts alone; return how far these end from their attractors."""
    label = data["label"].values
    x, v = np.meshgrid(data["x"].values, data["v"].values)
    x = np.where(label == -2, x[label >= -1].mean(), x)
    end, _ = jv.strobe(scene, jv.State(x.ravel(), v.ravel(), phase), SETTLED, 0)
    points = np.stack([data["point_x"].values, data["point_v"].values], -1)
    apart = np.nan_to_num(abs(plane(end)[:, None, None] - points).max(-1), nan=np.inf).min(-1)[label.ravel() >= 0]
    label = label[label >= 0]
    assert_same((apart.argmin(1), label))
    periodic = data["kind"].values[label] == "periodic"
    assert apart.min(1)[periodic].max(initial=0.0) < 1e-6 * (1.0 + np.nanmax(abs(points)))
    return apart.min(1)


def saddle_of(kind, number):
    """Return a saddle of one period: of the first of 32 scenes in which Newton's method comes to one."""
    for place in range(32 * number, 32 * number + 32):
        scene, start = kind.draw_single(place)
        for v in (start.v, -2.0 * start.v, 3.0 * start.v):
            with suppress(jv.OrbitError):
                orbit = jv.find_orbit(scene, jv.State(start.x, v), settle=0)
                first, second = abs(orbit.multipliers)
                if 1.2 < first < 30.0 and 1e-3 < second < 0.9:
                    return orbit
    raise AssertionError("no saddle")


@of_numbers
def test_manifolds(kind, number):
    """The map leads a stable manifold, and half of an unstable one, into itself, and the stable one to its orbit."""
    orbit = saddle_of(kind, number)
    scene = orbit.scene
    for name in ("stable", "unstable"):
        curve = jv.manifold(orbit, name, 3.0, 0.0, 0.005, 0.02)
        near = (curve["arc"].values < (3.0 if name == "stable" else 1.0)) & (abs(curve["v"].values) < 4.0)
        local = curve["image"].values == 0  # the part that is a series
        parts = np.flatnonzero(near & local & (curve["arc"].values > 1e-3)), np.flatnonzero(near & ~local)
        some = np.concatenate([part[:: max(1, -(-len(part) // 12))][:12] for part in parts])
        assert len(some) > 12
        given = points_of(curve)[some]
        state, images = jv.State(*given.T, 0.0), curve["image"].values[some]
        stretch = abs(np.asarray(jv.monodromy(scene, state, slots=SLOTS))).max((1, 2))
        end, _ = jv.strobe(scene, state, 1, 0)
        apart = distance(curve, plane(end))
        assert np.all(apart - 1e-13 * stretch < np.where(local[some], 1e-7, 1e-6))
        if name == "stable":
            begin = np.hypot(*(given - plane(orbit.state)).T)
            for _ in range(images.max() + 4):
                state, _ = jv.strobe(scene, jv.State(state.x, state.v, 0.0, state.contact), 1, 0)
            assert np.median(np.hypot(*(plane(state) - plane(orbit.state)).T) / begin) < 0.5
