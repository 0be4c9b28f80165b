"""Properties of motions that stick: their ends and derivatives, bounces, orbits and branches, against 50 digits."""

from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.maps.reference_strobe import REPLAY_SLOTS
from jaxvibro.orbits import chatter_and_release
from tests.kinds import LANES
from tests.reference import rest_slopes, rests, slopes
from tests.reference.draws import Draw
from tests.reference.scene import Motion, Scene, Wall
from tests.reference.special import exact, place, span
from tests.scenes_of_references import scene_of
from tests.sticking_orbits import errors, halved, met, resting
from tests.tiers import generator, of_numbers
from tests.truths import plain

# harmonics of the walls, 0: it does not move; "any" draws its scenes elsewhere
STRUCTURES = {"-r": (None, 0), "-m": (None, 1), "2-": (2, None), "rr": (0, 0), "rm": (0, 1), "mm": (1, 1), "any": None}
OWN_KINDS = {name: SimpleNamespace(name=name, walls=walls) for name, walls in STRUCTURES.items()}
ROWS = 8  # impacts of a stretch that are compared
RECORDED = 64
DIGITS = 50
LOOKS = 200  # at the contact force, a drive period


class Case(NamedTuple):
    """A start in a scene, and what happens."""

    draw: Draw
    story: rest_slopes.Story


def drawn(rng, structure):
    """Return a random `Draw` with walls of a structure."""
    gamma = rng.uniform(0.0, 0.4) if rng.random() < 0.7 else rng.uniform(0.4, 1.6)
    omega, amplitude = rng.uniform(0.15, 1.5), rng.uniform(0.3, 4.0)
    low, gap = rng.uniform(-1.2, 0.6), rng.uniform(0.3, 2.0)
    walls = []
    for position, harmonic in zip((low, low + gap), structure, strict=True):
        own = 0.0 if rng.random() < 0.25 else rng.uniform(0.1, 0.95)
        motion = Motion(rng.uniform(0.02, 0.3) * min(gap, 1.0), rng.uniform(0, 6.28), harmonic) if harmonic else None
        walls.append(None if harmonic is None else Wall(position, own, motion))
    space = low + 0.35 * gap, low + 0.65 * gap
    phase = rng.uniform(-3.0, 3.0)
    return Draw(Scene(gamma, omega, amplitude, *walls), rng.uniform(*space), rng.uniform(-2.0, 2.0), phase)


def cases(rng, structure):
    """Return so many `Case`s as there are lanes that stick, or leave a wall without speed, in the period."""
    found = []
    while len(found) < LANES:
        draw = drawn(rng, structure)
        try:
            story = rest_slopes.story(*draw)
        except rest_slopes.UnfairError:
            continue
        last = story.stretches[-1]
        if not story.held:
            if last.since is None and not story.plastic:
                continue
            if len(last.hits) > REPLAY_SLOTS or story.slowest < 1e-3:
                continue
        found.append(Case(draw, story))
    return found


def end_of(scene, slots=RECORDED):
    """Return the function from a draw's numbers, as `slopes.names`, to (x, v, *times, *speeds)."""
    form = jax.tree.structure(scene)

    def end(numbers):
        x, v, phase, gamma, omega, amplitude, *walls = numbers  # the walls' own stand in the scene's order already
        scene = form.unflatten([amplitude, omega, gamma, jnp.asarray(0.5), *walls])
        last, impacts = jv.strobe(scene, jv.State(x, v, phase), 1, slots)
        return jnp.concatenate([jnp.stack([last.x, last.v]), impacts.time, impacts.speed])

    return end


def rank(matrix):
    """Return the rank of a matrix to rounding."""
    assert np.isfinite(matrix).all()
    return np.linalg.matrix_rank(matrix, tol=1e-9 * max(1.0, abs(matrix).max()))


@of_numbers
def test_derivatives(kind, number):
    """Ends, derivatives of ends and impacts by every number, and the rank by the state are those of differences."""
    members = cases(generator(kind, number), kind.walls)
    run = end_of(scene_of([case.draw.scene for case in members]))
    points = jnp.array([slopes.numbers(case.draw) for case in members])
    both = jax.jit(jax.vmap(lambda numbers: (run(numbers), jax.jacfwd(run)(numbers))))
    for case, value, slope in zip(members, *map(np.asarray, both(points)), strict=True):
        true = rest_slopes.jacobian(*case)
        assert abs(value[:2] - rest_slopes.base_end(*case)).max() < 1e-9
        assert np.all(abs(slope[:2] - true).max(0) < 1e-9 * np.maximum(abs(true).max(0), 1.0)), case
        assert rank(slope[:2, :2]) == rank(true[:, :2]), case
        near = value[2 : 2 + RECORDED]
        near = near[np.isfinite(near)]
        for time, rows in rest_slopes.impacts(*case, near, ROWS).items():
            k = int(np.argmin(abs(near - time)))
            far = abs(slope[[2 + k, 2 + RECORDED + k]] - rows).max(1)
            assert np.all(far < 1e-9 * np.maximum(abs(rows).max(1), 1.0)), case


@of_numbers
def test_second_derivatives(kind, number):
    """Second derivatives of the end along a direction are those of differences."""
    rng = generator(kind, number)
    members = cases(rng, kind.walls)
    run = end_of(scene_of([case.draw.scene for case in members]), 4)
    points = jnp.array([slopes.numbers(case.draw) for case in members])
    directions = jnp.array(rng.normal(size=points.shape))

    def along(point, direction):
        return jax.jacfwd(jax.jacfwd(lambda step: run(point + step * direction)[:2]))(0.0)

    computed = np.asarray(jax.jit(jax.vmap(along))(points, directions))
    for case, direction, second in zip(members, directions, computed, strict=True):
        true = rest_slopes.curvature(*case, direction)
        assert abs(second - true).max() < 1e-6 * (1.0 + abs(true).max()), case


def scene_with_a_wall(rng, structure):
    """Return (scene, side, R) of a random scene with one wall."""
    side, bounce = -1 if structure[1] is None else 1, 0.0 if rng.random() < 0.1 else rng.uniform(0.02, 0.95)
    harmonic = structure[side > 0]
    motion = jv.Motion(rng.uniform(0.05, 0.4), rng.uniform(0, 6.28), harmonic) if harmonic else None
    wall = jv.Wall(rng.uniform(-1.0, 1.0), bounce, motion=motion)
    damping = rng.uniform(0.0, 0.4) if rng.random() < 0.8 else rng.uniform(0.9, 1.6)
    walls = (None, wall) if side > 0 else (wall, None)
    return jv.make_scene(rng.uniform(0.5, 4.0), rng.uniform(0.3, 2.5), damping, 0.5, walls), side, bounce


def pressed(rng, given, side):
    """Return (a time from which on a wall presses, the contact force, about when it lets go), None if it never does."""
    with workdps(20):
        times = np.linspace(0.0, 2.0 * float(span(given, 1)), 2 * LOOKS + 1)
        push = np.array([float(rests.press_alone(given, side, mpf(time))) for time in times])
    ends = np.flatnonzero((push[LOOKS:-1] > 0) & (push[LOOKS + 1 :] <= 0)) + LOOKS
    if not len(ends):
        return None
    last = int(rng.choice(ends))
    first = last - int(np.argmax(push[last::-1] <= 0))
    if last - first < 10 or push[first:last].min() > 0:
        return None
    begin = int(rng.integers(first + 3, last - 3))
    return times[begin], push[begin], times[last]


@of_numbers
def test_bounces(kind, number):
    """Bounces end in sticking when those of 50 digits do, and the simulator has the same state after the release."""
    rng, sticks = generator(kind, number), 0
    for _ in range(12):
        scene, side, bounce = scene_with_a_wall(rng, kind.walls)
        given = exact(plain(scene))
        start = pressed(rng, given, side)
        if start is None:
            continue
        phase = float(scene.frequency) * start[0]
        with workdps(DIGITS):
            now = mpf(phase) / given.omega  # the phase is the double
            end = rests.release(given, side, mpf(start[2]))
            tau = float(now - end)
            speed = rng.uniform(0.0, 1.0) ** 2 * 0.3 * min(1.0, 1.0 / float(scene.frequency), -tau) * start[1]
            before = speed / bounce if bounce else 1.0
            restitution = (given.right if side > 0 else given.left).restitution
            _, began = rests.until_rest(given, side, now, restitution * mpf(before), end)
            numbers = (np.float64(each) for each in (side, float(given.omega * end), tau, before))
        rest, _, margin, *_ = (
            float(np.asarray(each).ravel()[0]) for each in chatter_and_release._follow_bounces_compiled(scene, *numbers)
        )
        if margin <= 0:
            continue
        assert (began is not None) == (rest > 0), scene
        if began is None:
            continue
        sticks += 1
        assert abs(rest - float(end - began)) < 1e-10, scene
        late = now + span(given, 1)
        if end + rests.SHORT <= late <= end + 3:
            with workdps(DIGITS):
                wall = place(given, side, now)
                x, v = rests.state_after(given, side, end, mpf(0), late)
                begin = jv.State(float(wall.x), float(wall.v + side * before), float(given.omega * now))
            state = jv.strobe(scene, begin)[0]
            assert max(abs(float(state.x) - float(x)), abs(float(state.v) - float(v))) < 1e-9, scene
    assert sticks


@of_numbers
def test_orbits(kind, number):
    """The impacts and releases of an orbit that sticks are those of 50 digits, and its multipliers are zero."""
    scene, orbit = next(resting(generator(kind, number)))
    *worst, _, _ = errors(scene, orbit)
    assert max(worst) < 1e-10
    assert not orbit.multipliers.any()


@of_numbers
def test_completion_of_chatter(kind, number):
    """A branch has its CH where the bounces of 50 digits just end in sticking."""
    scene, orbit = next(resting(generator(kind, number)))
    value = float(scene.amplitude)
    branch = jv.follow(orbit, "amplitude", (0.6 * value, 1.6 * value))
    for point in branch.points("CH"):
        assert abs(point.value - halved(point)) < 1e-10


@of_numbers
def test_inelastic_branches(kind, number):
    """With R = 0 the stable orbits of a branch are the motion's, and CH and RL lie where the contact force is zero."""
    rng = generator(kind, number)
    scene, orbit = next(resting(rng))
    scene = scene.replace(**{f"{side}.restitution": 0.0 for side in scene.walls})
    try:
        orbit = jv.find_orbit(scene, orbit.state)
    except jv.OrbitError:
        return
    value = float(scene.amplitude)
    branch = jv.follow(orbit, "amplitude", (0.4 * value, 1.8 * value))
    special = np.isin(branch.values, [each.value for each in branch.special])
    for k in np.flatnonzero(branch.stable & ~special)[::7]:
        one = branch.orbit(k)
        end, _ = jv.strobe(one.scene, one.state, one.periods)
        assert max(abs(float(end.x - one.state.x)), abs(float(end.v - one.state.v))) < 1e-9
        assert jv.find_orbit(one.scene, one.state).label == one.label
    for point in branch.special:
        expected = met(point)[0] if point.kind in ("CH", "RL") else None
        assert expected is None or abs(expected - point.value) < 1e-10
