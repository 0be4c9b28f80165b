"""Properties of motions that stick: their ends and derivatives, bounces, orbits and branches, against 50 digits."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.maps.reference_strobe import REPLAY_SLOTS
from jaxvibro.orbits.chatter_and_release import _follow_bounces_compiled
from tests.kinds import LANES
from tests.reference import rest_slopes, rests, slopes
from tests.reference.draws import Draw
from tests.reference.scene import Motion, Scene, Wall
from tests.reference.special import exact, place, restitution, span
from tests.scenes_of_references import scene_of
from tests.special_points import completion_value, zero_force_value
from tests.tiers import generator, of_numbers
from tests.truths import plain

from .motions import take

# harmonics of the walls, 0: it does not move; "any" draws its scenes elsewhere
STRUCTURES = {"-r": (None, 0), "-m": (None, 1), "2-": (2, None), "rr": (0, 0), "rm": (0, 1), "mm": (1, 1), "any": None}
OWN_KINDS = {name: SimpleNamespace(name=name, walls=walls) for name, walls in STRUCTURES.items()}
ROWS = 8  # impacts of a stretch that are compared
RECORDED = 64
DIGITS = 50
SAMPLES = 200  # of the contact force, a drive period


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
    """Return (`Draw`, `Story`) of as many starts as there are lanes, which stick or leave a wall without speed."""
    found = []
    while len(found) < LANES:
        draw = drawn(rng, structure)
        try:
            story = rest_slopes.story(*draw)
        except ArithmeticError:
            continue
        last = story.stretches[-1]
        is_decided = len(last.hits) <= REPLAY_SLOTS and story.slowest > 1e-3
        if story.held or ((last.since is not None or story.plastic) and is_decided):
            found.append((draw, story))
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
    run = end_of(scene_of([draw.scene for draw, _ in members]))
    points = jnp.array([slopes.numbers(draw) for draw, _ in members])
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
    run = end_of(scene_of([draw.scene for draw, _ in members]), 4)
    points = jnp.array([slopes.numbers(draw) for draw, _ in members])
    directions = jnp.array(rng.normal(size=points.shape))

    def along(point, direction):
        return jax.jacfwd(jax.jacfwd(lambda step: run(point + step * direction)[:2]))(0.0)

    computed = np.asarray(jax.jit(jax.vmap(along))(points, directions))
    for case, direction, second in zip(members, directions, computed, strict=True):
        true = rest_slopes.curvature(*case, direction)
        assert abs(second - true).max() < 1e-6 * (1.0 + abs(true).max()), case


def pressed(rng, given, side):
    """Return (a time from which on a wall presses, the contact force, about when it lets go), None if it never does."""
    times = np.linspace(0.0, 2.0 * float(span(given, 1)), 2 * SAMPLES + 1)
    push = rests.presses(given, side, times)
    ends = np.flatnonzero((push[SAMPLES:-1] > 0) & (push[SAMPLES + 1 :] <= 0)) + SAMPLES
    if not len(ends):
        return None
    last = int(rng.choice(ends))
    first = last - int(np.argmax(push[last::-1] <= 0))
    if last - first < 10 or push[first:last].min() > 0:
        return None
    begin = int(rng.integers(first + 3, last - 3))
    return times[begin], push[begin], times[last]


def bounces(draw, side, release, tau, speed):
    """Return the bounces after an impact with a speed, a time tau after the release near a time.

    The result is what the package computes, and by 50 digits the time of the release, the impacts before it, and when
    the mass sticks, None if it does not, since the release.
    """
    with workdps(DIGITS):
        given, tau = exact(draw.scene), mpf(tau)
        end = rests.release(given, side, mpf(release))
        hits, began, _ = rests.bounces(given, side, end + tau, restitution(given, side) * mpf(speed), end)
        numbers = (np.float64(each) for each in (side, given.omega * end, tau, speed))
        scene = take(scene_of([draw.scene]), 0)
        found = [np.asarray(each) for each in _follow_bounces_compiled(scene, *numbers)]
        rows = np.array([(hit.time - end, hit.speed) for hit in hits], float).reshape(-1, 2)
        return found, end, rows, None if began is None else float(began - end)


@of_numbers
def test_bounces(kind, number):
    """Bounces end in sticking when those of 50 digits do, and the simulator has the same state after the release."""
    rng, side, sticks = generator(kind, number), 1 if kind.walls[0] is None else -1, 0
    for _ in range(12):
        draw = drawn(rng, kind.walls)
        given, bounce = exact(draw.scene), restitution(draw.scene, side)
        start = pressed(rng, given, side)
        if start is None:
            continue
        with workdps(DIGITS):
            now = mpf(start[0])
            tau = float(now - rests.release(given, side, mpf(start[2])))
        speed = rng.uniform(0.0, 1.0) ** 2 * 0.3 * min(1.0, 1.0 / draw.scene.omega, -tau) * start[1]
        before = speed / bounce if bounce else 1.0
        found, end, hits, began = bounces(draw, side, start[2], tau, before)
        rest, hold, margin, times, speeds, lifts = found
        if margin <= 0:
            continue
        assert (began is not None) == (rest > 0), draw
        assert hold > 0 and not lifts
        if began is None:
            continue
        sticks += 1
        count = len(hits[:20])
        np.testing.assert_allclose([times[:count], speeds[:count]], hits[:20].T, rtol=0, atol=1e-11)
        assert abs(float(rest) + began) < 1e-10, draw
        late = now + span(given, 1)
        if end + rests.SHORT <= late <= end + 3:
            with workdps(DIGITS):
                wall = place(given, side, now)
                x, v = rests.state_after(given, side, end, mpf(0), late)
            begin = jv.State(float(wall.x), float(wall.v + side * before), float(given.omega * now))
            state = jv.strobe(take(scene_of([draw.scene]), 0), begin)[0]
            assert max(abs(float(state.x) - float(x)), abs(float(state.v) - float(v))) < 1e-9, draw
    assert sticks


@pytest.mark.parametrize("early", [1e-6, 1e-3, 0.04])
def test_a_mass_pulled_off_its_wall_without_speed_sticks_again(early):
    draw = Draw(Scene(0.07, 0.9, 2.0, None, Wall(0.5, 0.0, Motion(0.2, 0.4, 2))), 0.0, 0.0, 0.0)
    given = exact(draw.scene)
    with workdps(DIGITS):
        begin, end = (rests.release(given, 1, mpf(near)) for near in (-1.2, 1.2))
        tau = float(begin - early - end)
        force = -float(rests.press_alone(given, 1, end + mpf(tau)))
    (rest, hold, _, times, speeds, lifts), _, hits, began = bounces(draw, 1, 1.2, tau, 1.0)
    assert lifts and float(hold) == pytest.approx(force, rel=1e-7)
    assert float(rest) == pytest.approx(-began, abs=1e-12)
    assert float(times[0] - tau) == pytest.approx(hits[0, 0] - tau, rel=1e-8)
    assert float(speeds[0]) == pytest.approx(hits[0, 1], rel=1e-8)


@pytest.mark.parametrize(("speed", "is_plain"), [(0.1, True), (0.412, False)])
def test_a_first_bounce_beyond_its_series_is_marked(speed, is_plain):
    """At much damping it does not land by its polynomial, though in truth it does, and the mass comes to rest."""
    wall = Wall(0.2869737, 0.17737789, Motion(0.13298062, 5.02168711, 2))
    draw = Draw(Scene(1.48387529, 0.34722585, 1.94542487, wall, None), 0.0, 0.0, 0.0)
    (rest, _, margin, *_), _, _, began = bounces(draw, -1, 31.6744, -0.64, speed)
    assert (margin > 0) == is_plain
    assert not is_plain or float(rest) == pytest.approx(-began, abs=1e-12)


def sticking_orbit(rng):
    """Return a random scene, with two walls or one, R per wall, perhaps a moving right wall, and its orbit that sticks.

    The scenes are tried until one settles on such an orbit of few periods.
    """
    while True:
        gamma = rng.uniform(0.02, 0.3) if rng.random() < 0.85 else rng.uniform(0.3, 1.4)
        kind, own = rng.integers(4), None if rng.random() < 0.5 else rng.uniform(0.3, 0.95)
        motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0, 6.28)) if kind == 2 else None
        walls = jv.Wall(-rng.uniform(0.3, 1.5), own), jv.Wall(rng.uniform(-0.1, 1.5), motion=motion)
        walls = {0: (-1.0, 1.0), 3: (None, walls[1])}.get(kind, walls)
        scene = jv.make_scene(rng.uniform(0.5, 6.0), rng.uniform(0.25, 1.0), gamma, rng.uniform(0.05, 0.85), walls)
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if orbit.rests and orbit.periods <= 4:
            return scene, orbit


@of_numbers
def test_orbits(kind, number):
    """The rows of an orbit that sticks, its impacts and releases, are those of 50 digits from each release on."""
    scene, orbit = sticking_orbit(generator(kind, number))
    problem, z = polish_orbit(orbit, "amplitude")
    sides = problem.sequence.sides * (1.0 + problem.sequence.releases)
    times, speeds = (z[k * len(sides) :][: np.count_nonzero(sides)] for k in (0, 1))
    given, length, compared = exact(plain(scene)), 2.0 * np.pi / float(scene.frequency) * orbit.periods, 0
    releases = np.flatnonzero(abs(sides) > 1)
    for begin in releases:
        with workdps(DIGITS):
            side = int(np.sign(sides[begin]))
            now = rests.release(given, side, mpf(times[begin]))
            hits, _, own = rests.from_release(given, side, now)
            assert abs(float(now - mpf(times[begin]))) < 1e-10
            for k, hit in enumerate(hits, begin + 1):
                row = k % len(times)
                if abs(sides[row]) > 1:
                    assert own == np.sign(sides[row])
                    break
                late = float((hit.time - mpf(times[row])) % mpf(length))
                assert hit.side == sides[row] and min(late, length - late) < 1e-10
                assert abs(float(hit.speed - mpf(speeds[row]))) < 1e-10
                compared += 1
    assert compared == len(times) - len(releases) >= len(releases) > 0
    assert not orbit.multipliers.any()


@of_numbers
def test_completion_of_chatter(kind, number):
    """A branch has its CH where the bounces of 50 digits just end in sticking."""
    scene, orbit = sticking_orbit(generator(kind, number))
    value = float(scene.amplitude)
    branch = jv.follow(orbit, "amplitude", (0.6 * value, 1.6 * value), stop="CH")
    for point in branch.points("CH"):
        assert abs(point.value - completion_value(point)) < 1e-10


@of_numbers
def test_inelastic_branches(kind, number):
    """With R = 0 the stable orbits of a branch are the motion's, and CH and RL lie where the contact force is zero."""
    scene, orbit = sticking_orbit(generator(kind, number))
    scene = scene.replace(**{f"{side}.restitution": 0.0 for side in scene.walls})
    try:
        orbit = jv.find_orbit(scene, orbit.state)
    except jv.OrbitError:
        return
    value = float(scene.amplitude)
    branch = jv.follow(orbit, "amplitude", (0.4 * value, 1.8 * value))
    special = np.isin(branch.values, [each.value for each in branch.special])
    for k in np.flatnonzero(branch.stable & ~special)[::7]:
        one = branch.orbit(int(k))
        end, _ = jv.strobe(one.scene, one.state, one.periods)
        assert max(abs(float(end.x - one.state.x)), abs(float(end.v - one.state.v))) < 1e-9
        assert jv.find_orbit(one.scene, one.state).label == one.label
    for point in branch.special:
        expected = zero_force_value(point) if point.kind in ("CH", "RL") else None
        assert expected is None or abs(expected - point.value) < 1e-10
