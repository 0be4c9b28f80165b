"""Properties of flights between soft walls, under user-defined forces and under drives of several terms."""

from dataclasses import replace

import jax
import numpy as np

import jaxvibro as jv
from tests import force_specials, graze_within, kinds, truths
from tests.kinds import KINDS, LANES, Kind
from tests.reference.search import Discard
from tests.tiers import of_batches, of_numbers

from .motions import (
    NEAR,
    SLOTS,
    assert_alike,
    assert_close,
    assert_same,
    decided,
    lane_of,
    move,
    rebuild,
    strobe,
)

GRID_POINTS = 200  # samples of a period, for the force of a wall
SHIFT = 0.375  # a constant force
NO_END = 2  # the status from which a motion has no end
STIFF = 1e8
NAMES = "amplitude", "frequency"


def _forced(n, name, numbers):
    """A predefined force between a moving wall and one at rest."""
    return kinds._forced(n, jv.Force(name, numbers, 1e-12), kinds._rigid(n, "left", 2), kinds._rigid(n, "right"))


def pendulum(n):
    return _forced(n, "pendulum", {"damping": n["damping"]})


def stribeck(n):
    numbers = {"belt": 2.0 * n["second"] - 1.0, "low": 0.3 * n["first"], "high": 0.3 + 0.3 * n["first"]}
    return _forced(n, "stribeck", numbers | {"slip": 0.5 + n["second"], "smooth": 0.4 + 0.4 * n["first"]})


def van_der_pol(n):
    return _forced(n, "van_der_pol", {"gain": n["second"]})


def constant_force(n):
    """A drive with a constant force, a third harmonic and a second term of the first one."""
    drive = ((10.0 * n["first"], 3, 6.0 * n["second"]), (8.0 * n["second"] - 4.0, 0, 0.0), (n["first"], 1, 0.5))
    return kinds._spring(n, kinds._rigid(n, "left"), kinds._rigid(n, "right"), drive)


def soft_terms(n):
    drive = ((2.0 * n["first"], 3, n["second"]), (n["second"], 0, 0.0))
    return kinds._spring(n, kinds._soft(n, "left", 1), kinds._rigid(n, "right"), drive)


OWN_KINDS = KINDS | {
    kind.name: kind
    for kind in (
        Kind("pendulum", pendulum, truths.series, 1e-12, exact=False),
        Kind("stribeck", stribeck, truths.series, 1e-12, exact=False),
        Kind("van_der_pol", van_der_pol, truths.series, 1e-12, exact=False),
        Kind("constant_force", constant_force, truths.closed_form, 2e-15),
        Kind("soft_terms", soft_terms, truths.closed_form),
    )
}


def remake(scene, **changes):
    """Return a scene with some arguments of `make_scene` changed."""
    given = {"amplitude": scene.amplitude, "frequency": scene.frequency, "damping": scene.damping, "restitution": 0.7}
    given |= {"walls": (scene.left, scene.right), "force": scene.force, "drive": scene.drive}
    return jv.make_scene(**(given | changes))


def as_force(scene):
    """Return a scene under a spring, and the same one with its spring and damper as a user-defined force.

    A soft wall adds its damping to that of a force, and replaces that of a spring.
    """

    def total(wall):
        return replace(wall, damping=wall.damping + scene.damping) if wall.soft else wall

    force = jv.Force("polynomial", {"c1": 1.0 + 0.0 * scene.damping, "damping": scene.damping}, 1e-12)
    return rebuild(scene, total), remake(scene, damping=None, force=force)


@of_numbers
def test_reference(kind, number):
    """The end and the impacts are those of the reference implementation."""
    scene, state = kind.draw(number)
    end, impacts = strobe(scene, state)
    compared = 0
    for lane in range(LANES):
        try:
            truth = kind.truth(*lane_of(scene, state, lane))
        except Discard:
            continue
        compared, bound = compared + 1, kind.tolerance * truth.allowed
        assert impacts.status[lane] < NO_END and impacts.count[lane] == len(truth.sides)
        assert [side for side in impacts.side[lane] if side] == list(truth.sides[:SLOTS])
        assert max(abs(float(truth.x - float(end.x[lane]))), abs(float(truth.v - float(end.v[lane])))) < bound
        speeds = zip(impacts.speed[lane], truth.speeds, strict=False)
        assert all(abs(float(true - float(speed))) < bound for speed, true in speeds)
        if truth.least_clearance is not None:
            least = impacts.least_clearance[lane]
            assert least == truth.least_clearance or abs(least - truth.least_clearance) < bound
    assert compared >= 1


@of_batches
def test_force_of_a_spring(kind, scene, state):
    """A spring as a user-defined force gives the exact flow of the spring: strobe, samples and derivative."""
    exact, forced = as_force(scene)
    coarse = replace(kind, tolerance=1e-12)
    (end, impacts), (other, others) = strobe(exact, state), strobe(forced, state)
    assert_alike(coarse, exact, state, (end, impacts), (other, others))
    keep, bound = decided(coarse, exact, state, end, impacts)
    times = 2.0 * np.pi / scene.frequency[:, None] * np.array([0.0, 0.3, 1.0])
    samples, expected = (jv.sample(each, state, times)[0] for each in (forced, exact))
    assert_close(keep, bound, (samples.x[:, 1], expected.x[:, 1]))
    product, derivative = (np.asarray(jv.monodromy(each, state, slots=SLOTS)) for each in (forced, exact))
    error, size = (abs(each).max((1, 2)) for each in (product - derivative, derivative))
    assert np.all(error[keep] <= 1e2 * (bound * (1.0 + size))[keep])
    sticks = (impacts.least_speed == 0.0) & (impacts.least_clearance > NEAR) & (impacts.status < NO_END)
    assert_same((other.contact[sticks], end.contact[sticks]))
    assert np.all(abs(other.x - end.x)[sticks] < 1e-8)


@of_batches
def test_terms_of_the_drive(kind, scene, state):
    """A term of the first harmonic is the drive itself, and a term without amplitude changes nothing."""
    end = strobe(scene, state)
    terms = (scene.amplitude, 1, 0.0 * scene.amplitude), (0.0 * scene.amplitude, 3, 0.2 + 0.0 * scene.amplitude)
    assert_alike(kind, scene, state, end, strobe(remake(scene, amplitude=0.0 * scene.amplitude, drive=terms), state))


@of_batches
def test_constant_force(kind, scene, state):
    """Under the spring a constant force shifts the walls and the motion, also of a mass that sticks."""
    end, impacts = strobe(scene, state)
    moved = rebuild(scene, lambda wall: move(wall, wall.position + SHIFT, lambda *motion: motion))
    pushed = remake(moved, drive=((SHIFT + 0.0 * scene.amplitude, 0, 0.0 * scene.amplitude),))
    image, others = strobe(pushed, replace(state, x=state.x + SHIFT))
    assert_alike(kind, scene, state, (end, impacts), (replace(image, x=image.x - SHIFT), others))
    sticks = (impacts.least_speed == 0.0) & (impacts.least_clearance > NEAR) & (impacts.status < NO_END)
    assert_same((image.contact[sticks], end.contact[sticks]))


@of_batches
def test_energy_to_walls(kind, scene, state):
    """Without drive and damping between walls at rest, `wall_loads` gives the energy that the mass loses."""
    scene = rebuild(scene, lambda wall: replace(wall, motion=None), (0, 1), 0.0, damping=0.0)
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    loads = jv.wall_loads(scene, state)
    lost = own_energy(scene, state) - own_energy(scene, end)
    size = 10.0 + state.x**4 + state.v**4
    work = loads["work_rate"].values.sum(-1) * 2.0 * np.pi / scene.frequency
    assert_close(keep, 1e-9 * size + bound * size, (work, lost))
    for column, (side, wall) in enumerate(scene.walls.items()):
        hits = impacts.side == (-1 if side == "left" else 1)
        fastest = np.where(hits, impacts.speed, 0.0).max(-1)
        assert_close(keep, bound, (loads["largest_speed"].values[:, column], fastest))
        if wall.soft and wall.law is None:
            assert_largest_force(scene, state, wall, side, loads["largest_force"].values[:, column], keep)


def own_energy(scene, state):
    """Return the energy of the mass and its own spring, without that stored in soft walls."""
    numbers = scene.force.numbers if scene.force else {}
    potential = 0.5 * state.x**2 + 0.25 * numbers.get("cubic", 0.0) * state.x**4
    return 0.5 * state.v**2 + (numbers["c0"] * state.x if "c0" in numbers else potential)


def assert_largest_force(scene, state, wall, side, largest, keep):
    """Check that no sample of the force of a soft wall exceeds the largest force."""
    times = np.linspace(0.0, 2.0 * np.pi, GRID_POINTS) / scene.frequency[:, None]
    states, _ = jv.sample(scene, state, times)
    sign = -1.0 if side == "left" else 1.0
    depth = sign * (np.asarray(states.x) - wall.position[:, None])
    force = wall.stiffness[:, None] * depth + 2.0 * wall.damping[:, None] * sign * np.asarray(states.v)
    force = np.where(depth > 0.0, force, 0.0).max(1)
    assert np.all((force <= largest * (1.0 + 1e-6) + 1e-6)[keep])


@of_batches
def test_stiff_limit(kind, scene, state):
    """Soft walls that give back as much as rigid ones tend to them like one over the root of the stiffness."""
    scene = rebuild(scene, lambda wall: replace(wall, restitution=0.1 + 0.9 * wall.restitution))
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    keep &= (bound < 1e-7) & (impacts.least_speed > 0.3)
    near, nearer = (strobe(jv.soften(scene, stiffness), state) for stiffness in (STIFF, 100.0 * STIFF))
    assert_same((near[1].side[keep], impacts.side[keep]), (nearer[1].side[keep], impacts.side[keep]))
    for name in ("x", "v"):
        first, second = (getattr(each, name) - getattr(end, name) for each in (near[0], nearer[0]))
        assert np.all((abs(first - 10.0 * second) <= 1e-2 * abs(first) + 1e-6 + 20.0 * bound)[keep])


@of_batches
def test_single_precision(kind, scene, state):
    """In single precision the motion is the same up to its rounding."""
    end, impacts = strobe(scene, state)
    keep, bound = decided(replace(kind, tolerance=1e-8), scene, state, end, impacts)
    keep &= (bound < 1e-2) & (impacts.least_speed > 0.1) & (impacts.least_clearance > 1e-2)
    small = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), (scene, state))
    coarse, others = strobe(*small)
    assert coarse.x.dtype == coarse.contact.dtype == others.time.dtype == np.float32
    assert_same((others.count[keep], impacts.count[keep]))
    assert_close(keep, bound, (coarse.x, end.x), (coarse.v, end.v))


@of_numbers
def test_branch_of_a_spring(kind, number):
    """Orbits, special points, their gradients and loci are the same for a spring as a user-defined force."""
    for seed in range(20 * number, 20 * number + 20):
        scene, state = kind.draw_single(seed)
        exact, forced = as_force(scene)
        try:
            orbit = jv.find_orbit(exact, state)
        except jv.OrbitError:
            continue
        if orbit.periods == 1 and 1 <= int(orbit.impacts.count) <= 2:
            break
    other = jv.find_orbit(forced, orbit.state, 1, settle=0)
    assert other.label == orbit.label and abs(orbit.state.x - other.state.x) < 1e-9
    assert abs(orbit.multipliers - other.multipliers).max() < 1e-8 * (1.0 + abs(orbit.multipliers).max())
    bounds = {name: (0.6 * float(getattr(scene, name)), 1.5 * float(getattr(scene, name))) for name in NAMES}
    branches = [jv.follow(each, "amplitude", bounds["amplitude"]) for each in (orbit, other)]
    special = [[point for point in branch.special if point.kind in ("SN", "PD", "GR")] for branch in branches]
    assert [point.kind for point in special[0]] == [point.kind for point in special[1]]
    for point, same in zip(*special, strict=True):
        assert abs(point.value - same.value) < 1e-9
    for pair in list(zip(*special, strict=True))[:1]:
        slope, other = (float(jv.sensitivity(point, ["frequency"])[0]) for point in pair)
        gradient, same = (float(jax.grad(jv.located(point))(point.scene).frequency) for point in pair)
        assert max(abs(each - slope) for each in (other, gradient, same)) < 1e-7 * (1.0 + abs(slope))
        first, second = (jv.locus(point, NAMES, bounds) for point in pair)
        assert [point.kind for point in first.special] == [point.kind for point in second.special]
        for point, same in zip(first.special, second.special, strict=True):
            assert np.allclose(list(point.values.values()), list(same.values.values()), rtol=0, atol=1e-7)


@of_numbers
def test_special_points(kind, number):
    """Special points of Duffing's oscillator and their gradients solve their equations in 30 digits."""
    errors = force_specials.gradient_errors(force_specials.special_point(np.random.default_rng([number])))
    assert max(errors.values()) < 1e-7 and errors["value"] < 1e-10


@of_numbers
def test_grazing_within(kind, number):
    """Where contacts split or join, a branch continues; the grazing there is that of 40 digits."""
    for seed in range(3 + 10 * number, 13 + 10 * number):
        scene, oscillator = graze_within.drawn(seed)
        points = graze_within.grazings_of(scene)
        if points:
            break
    assert points or number
    assert all(graze_within.error(point, oscillator) < 1e-9 for point in points)
