"""Soft walls with user-defined forces and contact laws: closed forms, gradients, series by hand, invalid laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import gamma

import jaxvibro as jv
from jaxvibro.contact.force_law_map import depth_since_entry
from jaxvibro.contact.kinds import flow_coefficients
from tests import force_specials

FORCE = jv.Force("polynomial", {"c1": 1.0, "damping": 0.05})
HERTZ = jv.Push("hertz", {"stiffness": 40.0})


def nothing(t, x, v, p):
    return 0.0 * x


def leaving(speed, dissipation):
    """Return the exit speed of a Hunt-Crossley wall: w dw / (1 + c w) = -k y^1.5 dy has the same integral there."""

    def integral(w):
        return w / dissipation - np.log1p(dissipation * w) / dissipation**2

    return -brentq(lambda w: integral(w) - integral(speed), -speed, -1e-9 * speed, xtol=1e-16, rtol=1e-15)


def test_one_contact_without_other_forces():
    """Hertz: nothing is lost, the contact takes 2 depth / speed sqrt(pi) gamma(7/5) / gamma(9/10), depth = (5 speed^2 /
    (4 stiffness))^(2/5), and is deepest after half of that. Hunt and Crossley: the loss."""
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
    end, hits = jax.device_get(jv.strobe(scene, start))
    assert (hits.count == 1).all() and (hits.status == 0).all()
    assert abs(hits.time[:, 0] - 0.1).max() < 1e-11 and (hits.side[:, 0] == way).all()
    deepest, out, lossy = (slice(4 * k, 4 * k + 4) for k in range(3))
    assert (end.contact[deepest] == -3).all()
    assert abs((-5.0 - end.x[deepest]) / depth - 1.0).max() < 1e-9 and abs(end.v[deepest] / speed).max() < 1e-9
    assert abs(end.v[out] / speed - 1.0).max() < 1e-13
    assert abs((-5.0 + speed * takes - end.x[out]) / (speed * takes)).max() < 1e-9
    expected = [leaving(*each) for each in zip(speed, dissipation, strict=True)]
    assert abs(-end.v[lossy] / expected - 1.0).max() < 1e-11


def test_the_slope_of_the_depth_at_an_entry():
    """There the root of the depth has no slope in time."""
    speed = 0.7
    wall = jv.Wall(0.5, law=jv.Push("hertz", {"stiffness": 50.0}))
    frame = flow_coefficients(
        jv.make_scene(
            1.0, 2.0, restitution=0.7, walls=(None, wall), force=jv.Force("duffing", {"cubic": 0.5, "damping": 0.05})
        )
    )
    given = jnp.ones(1, bool), jnp.ones(1), jnp.cos(jnp.array([0.3])), jnp.sin(jnp.array([0.3])), jnp.array([speed])

    def at(since):
        return jnp.stack(depth_since_entry(frame, *given, since))[:, 0]

    value, slope = jax.jvp(at, (jnp.zeros(1),), (jnp.ones(1),))
    pull = -0.5 - 0.5 * 0.5**3 - 0.1 * speed + np.cos(0.3)
    assert value == pytest.approx([0.0, speed], abs=1e-15) and slope == pytest.approx([speed, pull], abs=1e-12)


def test_gradients_of_solved_orbits():
    """In reverse mode, of a spring and of the same spring as a force: the loops of a contact run forward alone."""
    force = jv.Force("polynomial", {"c1": 1.0, "damping": 0.05})
    soft = [jv.Wall(1.0, stiffness=10.0, damping=damping) for damping in (0.15, 0.1)]  # it adds to that of a force
    scenes = (
        jv.make_scene(1.5, 1.3, 0.05, walls=(None, soft[0])),
        jv.make_scene(1.5, 1.3, walls=(None, soft[1]), force=force),
    )
    rows = []
    for scene in scenes:

        def solved(scene):
            orbits = jv.solve_orbits(scene, jv.State(1.534, 5.03), ("R",))
            row = jnp.stack([*orbits.times, *orbits.speeds, orbits.multipliers[0].real, orbits.multipliers[0].imag])
            return row, (row, orbits.status)

        gradient, (value, status) = jax.jit(jax.jacrev(solved, has_aux=True))(scene)
        assert status == 0
        names = "amplitude", "right.position", "right.stiffness", "right.damping"
        rows.append(np.stack([value, *(np.asarray(gradient.parameter(name)) for name in names)]))
    assert abs(rows[0]).max() > 1.0 and abs(np.subtract(*rows)).max() < 1e-12


def test_a_fold_between_hertz_walls_and_its_gradient():
    walls = tuple(jv.Wall(place, law=HERTZ) for place in (-0.9, 0.8))
    scene = force_specials.duffing(walls, 1.0, frequency=2.0)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (0.8, 4.0), stop="SN")
    errors = force_specials.gradient_errors(branch.points("SN")[0])
    assert errors.pop("value") < 1e-13 and max(errors.values()) < 1e-8 and "right.law.stiffness" in errors


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
        (jv.Wall(1.0, law=jv.Push(lambda d, r, p: (jax.debug.print(""), d)[1])), FORCE, "right.law: must not print"),
        (jv.Wall(1.0, law=jv.Push(lambda d, r, p: p["none"])), FORCE, "right.law: cannot be traced by JAX"),
    ],
)
def test_invalid_laws_are_refused(wall, force, rule):
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
    walls = jv.Wall(-0.6, law=HERTZ), jv.Wall(0.7, None, 60.0, 0.8)
    scene = jv.make_scene(1.7, 1.9, walls=walls, force=FORCE)
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
