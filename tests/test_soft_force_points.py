"""What stands on orbits, between soft walls beside forces of one's own: against the spring and damper that the same
force is, where stays are closed forms, and against Newton's method in many digits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.flight_coefficients import flow_coefficients
from jaxvibro.orbits import force_law_contact_map
from tests.reference import soft_force_points as reference
from tests.test_soft_force import spring

NAMES = "amplitude", "right.position", "right.stiffness", "right.damping"


def pair(numbers, damping, *walls):
    """The same scene under spring and damper, and under them as a force; a wall is a place, or (place, stiffness,
    damping, motion), whose damping comes on top."""
    scenes = []
    for force, more in ((None, damping), (jv.Force(spring, {"damping": damping}), 0.0)):
        soft = [one if not isinstance(one, tuple) else (*one[:2], one[2] + more, *one[3:]) for one in walls]
        made = tuple(jv.Wall(one[0], None, *one[1:]) if isinstance(one, tuple) else one for one in soft)
        own = {"damping": damping} if force is None else {"force": force}
        scenes.append(jv.make_scene(*numbers, restitution=0.7, walls=made, **own))
    return scenes


def slopes(found, scene):
    """Derivatives by NAMES and by the oscillator's damping, the walls' total being kept: of a gradient."""
    own = "damping" if scene.force is None else "force.damping"
    rows = [np.asarray(found[name] if isinstance(found, dict) else found.parameter(name)) for name in (*NAMES, own)]
    if scene.force is not None:
        rows[-1] = rows[-1] - rows[-2]
    return np.stack(rows)


def one():
    return pair((1.0, 2.0), 0.05, None, (0.5, 50.0, 0.5))


def apart(curves):
    """How far the points of two curves lie from each other, by their steps that is, and their special points."""
    first, second = curves
    assert len(first) == len(second) and [s.kind for s in first.special] == [s.kind for s in second.special]
    points = [
        [np.ravel(list(s.values.values()) if hasattr(s, "values") else s.value) for s in c.special] for c in curves
    ]
    return abs(first.values - second.values).max(), abs(np.subtract(*points)).max()


def test_the_entry_itself_is_within_the_wall():
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
        return jnp.stack(force_law_contact_map.depth_since_entry(frame, *given, since))[:, 0]

    value, slope = jax.jvp(at, (jnp.zeros(1),), (jnp.ones(1),))
    pull = -0.5 - 0.5 * 0.5**3 - 0.1 * speed + np.cos(0.3)
    assert value == pytest.approx([0.0, speed], abs=1e-15) and slope == pytest.approx([speed, pull], abs=1e-12)


def test_gradients_of_orbits_that_are_solved_for():
    """Backward: the loops of a stay go forward alone."""
    found = []
    for scene in pair((1.5, 1.3), 0.05, None, (1.0, 10.0, 0.1)):

        def told(scene):
            got = jv.solve_orbits(scene, jv.State(1.534, 5.03), ("R",))
            each = *got.times, *got.speeds, got.multipliers[0].real, got.multipliers[0].imag
            return jnp.stack(each), (jnp.stack(each), got.status)

        by, (value, status) = jax.jit(jax.jacrev(told, has_aux=True))(scene)
        assert status == 0
        found.append(np.concatenate([np.asarray(value)[None], slopes(by, scene)]))
    assert abs(found[0]).max() > 1.0 and abs(np.subtract(*found)).max() < 1e-12


@pytest.mark.parametrize(
    "numbers, walls, count",
    [
        ((4.0, 2.6), (-0.8, (0.9, 30.0, 0.4)), 3),
        ((2.5, 2.1), ((-0.8, 12.0, 0.2, jv.Motion(0.1, 0.4, 2)), (0.9, 30.0, 0.4)), 2),
    ],
)
def test_orbits_from_many_starts(numbers, walls, count):
    exact, found = (jv.find_orbits(scene, 2, 60) for scene in pair(numbers, 0.03, *walls))
    seen = 0
    for orbit in exact:
        near = [abs(other.state.x - orbit.state.x) + abs(other.state.v - orbit.state.v) for other in found]
        if min(near) < 1e-11:
            other = found[int(np.argmin(near))]
            size = 1.0 + abs(orbit.multipliers).max() ** 2
            assert other.label == orbit.label and abs(other.multipliers - orbit.multipliers).max() < 1e-11 * size
            seen += 1
    assert seen >= count - 1 and len(found) >= count - 1


def test_folds_and_grazings_their_loci_and_gradients():
    pairs = one()
    branches = [jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (0.8, 4.0)) for scene in pairs]
    assert apart(branches)[1] < 1e-11 and [s.kind for s in branches[0].special] == ["EP", "SN", "SN", "GR", "EP"]
    bounds = {"frequency": (1.4, 2.2), "right.stiffness": (30.0, 120.0)}
    for kind, special, near in (("SN", ["EP", "CP", "EP"], 1e-7), ("GR", ["EP", "EP"], 1e-12)):
        points = [branch.points(kind)[0] for branch in branches]
        loci = [jv.locus(point, tuple(bounds), bounds) for point in points]
        steps, ends = apart(loci)
        assert [s.kind for s in loci[0].special] == special and steps < near and ends < 1e-11
        tables = [jv.sensitivity(point) for point in points]
        rows = [dict(zip(table["number"].values, table.values, strict=True)) for table in tables]
        assert abs(np.subtract(*(slopes(*each) for each in zip(rows, pairs, strict=True)))).max() < 1e-12
        found = []
        for point in points:
            located = jv.located(point)
            other = point.scene.replace(**{"right.stiffness": 52.0, "amplitude": 1.01})
            by = slopes(jax.grad(located)(other), other)
            found.append(np.append(by, float(located(other))))
        assert abs(found[0]).max() > 0.5 and abs(np.subtract(*found)).max() < 1e-12
    diagrams = [jv.explore(scene, "frequency", (1.0, 2.4), max_period=2) for scene in pairs]
    assert [len(each.branches) for each in diagrams] == [2, 2]
    for both in zip(*(each.branches for each in diagrams), strict=True):
        assert apart(both)[1] < 1e-11


def test_symmetry_breaking_and_period_doubling():
    scenes = pair((2.0, 2.1), 0.05, (-1.0, 100.0, 0.5), (1.0, 100.0, 0.5))
    whole = [jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (1.0, 9.0)) for scene in scenes]
    tilted = [jv.switch(branch.points("SB")[0])[0] for branch in whole]
    doubled = [jv.switch(branch.points("PD")[0])[0] for branch in tilted]
    assert [s.kind for s in doubled[0].special] == ["EP", "GR", "PD", "EP"]
    for both in (whole, tilted, doubled):
        steps, ends = apart(both)
        assert steps < 1e-8 and ends < 1e-11
    assert abs(np.subtract(*(np.asarray(jv.peaks(branch)) for branch in tilted))).max() < 1e-9
    bounds = {"amplitude": (4.0, 9.0), "frequency": (1.9, 2.4)}
    for kind, branches in (("SB", whole), ("PD", tilted)):
        steps, ends = apart([jv.locus(branch.points(kind)[0], tuple(bounds), bounds) for branch in branches])
        assert steps < 1e-9 and ends < 1e-11


def test_second_derivatives_of_a_flight():
    found = []
    for scene in pair((2.0, 2.1), 0.05, (-1.0, 100.0, 0.5), (1.0, 100.0, 0.5)):

        def end(z, scene=scene):
            own = scene.replace(amplitude=z[2], **{"right.stiffness": z[3]})
            state, _ = jv.strobe(own, jv.State(z[0], z[1]))
            return jnp.stack([state.x, state.v])

        found.append(np.asarray(jax.jit(jax.hessian(end))(jnp.array([0.9, -1.1, 2.0, 100.0]))))
    assert abs(found[0]).max() > 0.5 and abs(np.subtract(*found)).max() < 1e-12


def test_a_fold_between_hertz_walls_in_many_digits():
    """Its orbit, frequency, multipliers and gradient."""
    law = jv.Push("hertz", {"stiffness": 40.0})
    force = jv.Force("duffing", {"cubic": 0.5, "damping": 0.05})
    walls = tuple(jv.Wall(place, law=law) for place in (-0.9, 0.8))
    scene = jv.make_scene(1.0, 2.0, restitution=0.5, walls=walls, force=force)
    (fold,) = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "frequency", (0.8, 4.0)).points("SN")
    own = jax.grad(jv.located(fold))(fold.scene)
    names = {"amplitude": "amplitude", "cubic": "force.cubic", "damping": "force.damping", "right": "right.position"}
    orbit = fold.orbit
    with mpmath.workdps(reference.DIGITS):
        given = {"amplitude": 1.0, "cubic": 0.5, "damping": 0.05, "stiffness": 40.0, "left": -0.9, "right": 0.8}
        given = {name: mpmath.mpf(value) for name, value in given.items()}
        exact = reference.solved("hertz", 1, given, (float(orbit.state.x), float(orbit.state.v), fold.value))
        for value, other, near in zip(
            (orbit.state.x, orbit.state.v, fold.value), exact, (1e-12, 1e-12, 1e-14), strict=True
        ):
            assert abs(float(value) - other) < near
        (a, _), (_, d) = reference.matrix("hertz", given, *exact)
        assert abs(orbit.multipliers[1] - float(a + d - 1)) < 1e-7
        true = reference.gradient("hertz", 1, given, exact, [*names, "stiffness"])
    for name, mine in names.items():
        assert abs(float(own.parameter(mine)) - true[name]) < 1e-8
    stiffness = sum(float(own.parameter(f"{side}.law.stiffness")) for side in ("left", "right"))
    assert abs(stiffness - true["stiffness"]) < 1e-10
