"""Soft walls beside forces of one's own, with laws of their own: against closed forms, the spring, series by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import gamma

import jaxvibro as jv
from tests import soft_force_proof


def nothing(t, x, v, p):
    return 0.0 * x


def spring(t, x, v, p):
    return -x - 2.0 * p["damping"] * v


def told(*given, **more):
    return jax.tree.map(np.asarray, jv.strobe(*given, **more))


def leaving(speed, dissipation):
    """With what speed Hunt and Crossley's wall is left: w dw / (1 + c w) = -k y^1.5 dy has the same integral there."""

    def integral(w):
        return w / dissipation - np.log1p(dissipation * w) / dissipation**2

    return -brentq(lambda w: integral(w) - integral(speed), -speed, -1e-9 * speed, xtol=1e-16, rtol=1e-15)


def test_one_contact_without_other_forces():
    """Hertz: nothing is lost, the contact takes 2 depth / speed sqrt(pi) gamma(7/5) / gamma(9/10), depth = (5 speed^2 /
    (4 stiffness))^(2/5), and is deepest after half of that. Hunt and Crossley: what is lost."""
    stiffness, speed = np.array([1.0, 50.0, 1e4, 1e7]), np.array([1.0, 0.3, 2.0, 1e-3])
    depth = (1.25 * speed**2 / stiffness) ** 0.4
    takes = 2.0 * depth / speed * np.sqrt(np.pi) * gamma(1.4) / gamma(0.9)
    dissipation = np.array([0.5, 0.1, 0.3, 100.0])
    laws = (
        jv.Push("hertz", {"stiffness": np.tile(stiffness, 3)}),
        jv.Push("hunt_crossley", {"stiffness": np.tile(stiffness, 3), "dissipation": np.tile(dissipation, 3)}),
    )
    walls = tuple(jv.Wall(place, law=law) for place, law in zip((-5.0, 5.0), laws, strict=True))
    span = np.concatenate([0.1 + 0.5 * takes, 0.1 + 2.0 * takes, 0.1 + 4.0 * takes])
    scene = jv.make_scene(0.0, 2.0 * np.pi / span, restitution=0.5, walls=walls, force=jv.Force(nothing))
    way = np.repeat([-1.0, -1.0, 1.0], 4)
    start = jv.State(way * (5.0 - 0.1 * np.tile(speed, 3)), way * np.tile(speed, 3))
    end, hits = told(scene, start)
    assert (hits.count == 1).all() and (hits.status == 0).all()
    assert abs(hits.time[:, 0] - 0.1).max() < 1e-11 and (hits.side[:, 0] == way).all()
    deepest, out, lossy = (slice(4 * k, 4 * k + 4) for k in range(3))
    assert (end.contact[deepest] == -3).all()
    assert abs((-5.0 - end.x[deepest]) / depth - 1.0).max() < 1e-9 and abs(end.v[deepest] / speed).max() < 1e-9
    assert abs(end.v[out] / speed - 1.0).max() < 1e-13
    assert abs((-5.0 + speed * takes - end.x[out]) / (speed * takes)).max() < 1e-9
    expected = [leaving(*each) for each in zip(speed, dissipation, strict=True)]
    assert abs(-end.v[lossy] / expected - 1.0).max() < 1e-11


def as_spring(count, moving, seed=0):
    """(scenes under spring and damper, the same as forces of one's own, states): soft walls at any place, of which the
    right one moves where the left one stands still, or both."""
    rng = np.random.default_rng(seed)
    left = rng.uniform(-2.0, 0.5, count)
    right = left + rng.uniform(0.3, 3.0, count)
    stiffness = 10.0 ** rng.uniform(0.0, 4.0, (2, count))
    own, damping = rng.uniform(0.0, 1.0, (2, count)) * np.sqrt(stiffness), rng.uniform(0.0, 1.0, count)
    swing = 0.15 * rng.uniform(0.0, 1.0, count) * (right - left)
    motions = (jv.Motion(swing, rng.uniform(0, 6, count), 2) if moving else None), jv.Motion(swing, 0.4)
    numbers = rng.uniform(0.0, 5.0, count), rng.uniform(0.4, 6.0, count)

    def walls(more):
        given = zip((left, right), stiffness, own, motions, strict=True)
        return tuple(jv.Wall(place, stiffness=k, damping=c + more, motion=move) for place, k, c, move in given)

    exact = jv.make_scene(*numbers, damping, 0.5, walls(damping))
    found = jv.make_scene(*numbers, restitution=0.5, walls=walls(0.0), force=jv.Force(spring, {"damping": damping}))
    return exact, found, jv.State(rng.uniform(left, right), rng.normal(size=count), rng.uniform(0, 6, count))


def test_a_spring_as_a_force_between_soft_walls():
    exact, found, state = as_spring(120, False)
    (end, hits), (other, others) = (told(scene, state, slots=32) for scene in (exact, found))
    assert (hits.count == others.count).all() and hits.count.sum() > 100 and (end.contact == other.contact).all()
    size = np.maximum(abs(end.x), abs(end.v)) + 5.0
    sure = hits.status == 0
    assert sure.mean() > 0.9
    assert (np.maximum(abs(end.x - other.x), abs(end.v - other.v)) / size)[sure].max() < 1e-11
    hit = hits.side != 0
    assert (abs(hits.time[hit] - others.time[hit]) * hits.speed[hit]).max() < 1e-11


def mixed(moving=True):
    """A scene of two laws: a Hertz wall that moves, and a linear one."""
    motion = jv.Motion(0.1, 0.3, 2) if moving else None
    walls = jv.Wall(-0.6, law=jv.Push("hertz", {"stiffness": 40.0}), motion=motion), jv.Wall(0.7, None, 60.0, 0.8)
    force = jv.Force("duffing", {"cubic": 0.6, "damping": 0.05})
    return jv.make_scene(1.7, 1.9, restitution=0.5, walls=walls, force=force)


STARTS = jv.State(np.array([0.1, -0.3, 0.5, -0.7, 0.9, 0.2]), np.array([1.0, -2.0, 0.4, 0.3, -0.8, -3.0]))


def differences(scene, step=2e-4):
    """d(x, v at the end) / d(x, v, amplitude, left.law.stiffness) by differences of eighth order."""
    weights = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
    columns = []
    for name, size in (("x", 1.0), ("v", 1.0), ("amplitude", 1.0), ("left.law.stiffness", 40.0)):
        total = 0.0
        for k, weight in enumerate(weights, 1):
            ends = []
            for sign in (1.0, -1.0):
                move = sign * k * step * size
                state = jv.State(STARTS.x + move * (name == "x"), STARTS.v + move * (name == "v"))
                own = scene if name in "xv" else scene.replace(**{name: scene.parameter(name) + move})
                end, _ = told(own, state)
                ends.append(np.stack([end.x, end.v], -1))
            total = total + weight * (ends[0] - ends[1]) / (step * size)
        columns.append(total)
    return np.stack(columns, -1)


def test_derivatives_of_laws():
    scene = mixed()
    expected = differences(scene)

    def end(x, v, amplitude, stiffness):
        own = scene.replace(amplitude=amplitude, **{"left.law.stiffness": stiffness})
        found, _ = jv.strobe(own, jv.State(x, v))
        return jnp.stack([found.x, found.v])

    row = jax.jit(jax.vmap(lambda *given: jnp.stack(jax.jacfwd(end, (0, 1, 2, 3))(*given), -1), (0, 0, None, None)))
    found = np.asarray(row(STARTS.x, STARTS.v, 1.7, 40.0))
    size = 1.0 + abs(expected).max(axis=(1, 2))
    assert (abs(found - expected).max(axis=(1, 2)) / size).max() < 1e-8
    matrix = np.asarray(jv.monodromy(scene, STARTS))
    assert (abs(matrix - found[:, :, :2]).max(axis=(1, 2)) / size).max() < 1e-11


def test_orbits_of_a_spring_between_soft_walls():
    walls = [(None, jv.Wall(1.0, stiffness=10.0, damping=damping)) for damping in (0.15, 0.1)]
    exact = jv.make_scene(1.5, 1.3, 0.05, 0.7, walls[0])
    found = jv.make_scene(1.5, 1.3, restitution=0.7, walls=walls[1], force=jv.Force(spring, {"damping": 0.05}))
    state, _ = jv.strobe(exact, jv.State(1.5, 1.0), periods=300)
    orbit, other = (jv.find_orbit(scene, state) for scene in (exact, found))
    assert orbit.label == other.label == "P101"
    assert abs(orbit.state.x - other.state.x) < 1e-12 and abs(orbit.state.v - other.state.v) < 1e-12
    assert abs(orbit.multipliers - other.multipliers).max() < 1e-11


@pytest.mark.parametrize("law", ["hertz", "hunt_crossley"])
def test_laws_against_series_by_hand(law):
    ((seen, wrong, worst),) = soft_force_proof.compared(law, 25, (1e-12,), 30)
    assert seen >= 20 and wrong == 0 and worst < 1.0


FORCE = jv.Force("polynomial", {"c1": 1.0, "damping": 0.05})
HERTZ = jv.Push("hertz", {"stiffness": 40.0})


@pytest.mark.parametrize(
    ("wall", "force", "rule"),
    [
        (jv.Wall(1.0, stiffness=9.0), FORCE, "right.damping: must be given for a soft wall"),
        (jv.Wall(1.0, law=HERTZ), None, "right.law: needs a scene with a force"),
        (jv.Wall(1.0, law="hertz"), FORCE, "right.law: must be a Push or None"),
        (jv.Wall(1.0, 0.5, law=HERTZ), FORCE, "right.restitution: must not be given for a wall with a contact law"),
        (jv.Wall(1.0, law=jv.Push("herz", {"stiffness": 1.0})), FORCE, "right.law.function: must be a function"),
        (jv.Wall(1.0, law=jv.Push("hertz", {})), FORCE, "right.law.numbers: must be stiffness"),
        (jv.Wall(1.0, law=jv.Push("hertz", {"stiffness": -1.0})), FORCE, "right.law.stiffness: must be greater than 0"),
        (jv.Wall(1.0, law=jv.Push(lambda d, r, p: 1.0 + d)), FORCE, "right.law: must be 0 where depth and rate are 0"),
        (jv.Wall(1.0, law=jv.Push(lambda d, r, p: p["none"])), FORCE, "right.law: cannot be traced by JAX"),
    ],
)
def test_what_is_no_law_is_refused(wall, force, rule):
    with pytest.raises(jv.SceneError, match=rule):
        jv.make_scene(1.0, 2.0, None if force else 0.1, 0.5, (None, wall), force=force)


@pytest.mark.parametrize("power", [1.25, "exponent"])
def test_a_law_that_is_no_series_is_refused(power):
    def law(depth, rate, p):
        return depth ** (p["exponent"] if power == "exponent" else power)

    wall = jv.Wall(1.0, law=jv.Push(law, {"exponent": 1.5}))
    scene = jv.make_scene(1.0, 2.0, restitution=0.5, walls=(None, wall), force=FORCE)
    with pytest.raises(jv.SceneError, match=r"right.law: must be a power series in the root of the depth"):
        jv.strobe(scene, jv.State(0.0, 0.0))


def test_parameters_and_files(tmp_path):
    scene = mixed(False)
    assert {"left.law.stiffness", "right.stiffness", "right.damping"} < set(scene.names)
    assert not {"hardness", "left.stiffness", "damping"} & set(scene.names)
    assert scene.replace(**{"left.law.stiffness": 7.0}).parameter("left.law.stiffness") == 7.0
    jv.save_scene(scene, tmp_path / "scene.toml")
    again = jv.load_scene(tmp_path / "scene.toml")
    assert again.numbers == scene.numbers and again.left.law.function is scene.left.law.function
    wall = jv.Wall(1.0, law=jv.Push(lambda depth, rate, p: depth))
    with pytest.raises(jv.ArgumentError, match=r"law.function: must be predefined"):
        scene = jv.make_scene(1.0, 2.0, restitution=0.5, walls=(None, wall), force=FORCE)
        jv.save_scene(scene, tmp_path / "other.toml")
