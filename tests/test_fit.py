"""Fits of impacts, samples and special points: noise, flaws, bounds, what a record does not determine, files, input."""

import functools
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy import optimize

import jaxvibro as jv
from jaxvibro.design.impact_chains import ImpactChain, is_acceptable_chain
from jaxvibro.design.impact_prediction import Impact, next_impacts

SCENES = Path(__file__).parents[1] / "scenes"
SIGMA, OMEGA = 1e-3, 1.3
CHAOTIC = jv.make_scene(1.0, OMEGA, 0.05, 0.8, (jv.Wall(-1.0, 0.8), jv.Wall(1.0, 0.7)))
START = jv.State(0.3, 0.2)
FREE = {"damping": 0.01, "left.restitution": 0.1, "right.restitution": 0.1, "right.position": 0.1, "frequency": 0.05}
OFF = {"damping": 1.04, "left.restitution": 0.97, "right.restitution": 1.02, "right.position": 0.96, "frequency": 1.03}
OK, UNIDENTIFIABLE = jv.FitStatus.OK, jv.FitStatus.UNIDENTIFIABLE


@functools.cache
def impacts():
    """(times, sides) of the first fifty impacts."""
    _, found = jv.strobe(CHAOTIC, START, periods=28, slots=60)
    return tuple(np.asarray(part)[:50] for part in (found.time, found.side))


@functools.cache
def samples(per_period, periods, scene=CHAOTIC):
    """(times, x, v) at some times of each of some drive periods."""
    times = np.arange(per_period * periods + 1) * 2.0 * np.pi / float(scene.frequency) / per_period
    state, status = jv.sample(scene, START, times)
    assert int(status) == 0
    return times, np.asarray(state.x), np.asarray(state.v)


def start(names=tuple(FREE), scene=CHAOTIC):
    """The scene with its numbers some per cent off."""
    return scene.replace(**{name: scene.numbers[name] * OFF.get(name, 1.02) for name in names})


def impact_record(seed=0, without=(), more=(), late=0.0, **options):
    """A noisy record: impacts taken out, or put in as (time, side)."""
    times, sides = impacts()
    times = times + SIGMA * np.random.default_rng(seed).normal(size=len(times)) - late
    times = np.append(np.delete(times, without), [time for time, _ in more])
    sides = np.append(np.delete(sides, without), [side for _, side in more])
    order = np.argsort(times)
    return jv.ImpactRecord(times[order], sides[order], SIGMA, **options)


def sample_record(per_period, periods, velocities=False, scene=CHAOTIC, late=0.0, sigma=SIGMA, **options):
    times, *channels = samples(per_period, periods, scene)
    rng = np.random.default_rng(0)
    x, v = (channel + SIGMA * rng.normal(size=len(times)) for channel in channels)
    return jv.SampleRecord(times - late, x, sigma, v if velocities else None, **options)


def errors(found, scene=CHAOTIC):
    """The errors of a fit, in sigma."""
    return np.array([(value - scene.numbers[name]) / found.sigma[name] for name, value in found.values.items()])


@pytest.mark.parametrize("what", ["impacts", "samples"])
def test_a_fit_is_the_least_square_of_another_minimiser(what):
    """Of a short noisy record: scipy's, of the distance of simulated times or samples, ends at the same numbers."""
    free = {"left.restitution": 0.1, "right.position": 0.1}
    if what == "impacts":
        data = jv.ImpactRecord(impact_record().times[:12], impacts()[1][:12], SIGMA, flawed=False)
    else:
        data = sample_record(12, 3)
    off = {"left.restitution": 0.79, "right.position": 1.01}
    found = jv.fit(CHAOTIC.replace(**off), data, free)
    assert found.status == OK and found.dof == len(data.times) - 4

    def residuals(unknowns):
        scene = CHAOTIC.replace(**dict(zip(free, unknowns[:2], strict=True)))
        state = jv.State(*unknowns[2:])
        if what == "impacts":
            return (np.asarray(jv.strobe(scene, state, periods=28, slots=60)[1].time)[:12] - data.times) / SIGMA
        return (np.asarray(jv.sample(scene, state, data.times)[0].x) - data.x) / SIGMA

    expected = optimize.least_squares(residuals, [0.8, 1.0, 0.3, 0.2], xtol=1e-14, ftol=1e-14, gtol=1e-12)
    assert list(found.values.values()) == pytest.approx(expected.x[:2], abs=1e-6)
    assert found.chi2 == pytest.approx(2 * expected.cost, rel=1e-6)
    assert abs(found.residuals) == pytest.approx(abs(residuals(expected.x)), abs=1e-2)
    assert found.covariance.values == pytest.approx(np.linalg.inv(expected.jac.T @ expected.jac)[:2, :2], rel=1e-3)


def test_errors_are_as_large_as_their_sigma():
    squares = []
    for seed in range(6):
        found = jv.fit(start(), impact_record(seed), FREE)
        assert found.status == OK and found.missed == () and found.spurious == ()
        away = np.array([found.values[name] - CHAOTIC.numbers[name] for name in FREE])
        squares.append(away @ np.linalg.solve(found.covariance.values, away))
    assert 10 < np.sum(squares) < 60  # chi2 of 30: 0.1 % on either side
    assert "right.position" in found.table()


def test_missed_and_spurious_impacts_are_found():
    times, sides = impacts()
    found = jv.fit(start(), impact_record(1, without=(8, 30, 31)), FREE)
    assert found.status == OK
    assert [side for _, side in found.missed] == list(sides[[8, 30, 31]])
    assert [time for time, _ in found.missed] == pytest.approx(times[[8, 30, 31]], abs=10 * SIGMA)
    between = (float(times[20]) + 0.6 * float(times[21] - times[20]), int(sides[21]))
    found = jv.fit(start(), impact_record(2, more=(between,)), FREE)
    assert found.status == OK and found.spurious == (21,) and found.missed == ()
    assert abs(errors(found)).max() < 4.0


def test_a_mass_that_sinks_into_a_soft_wall_has_no_next_impact():
    sunk = jv.make_scene(0.0, 1.1, 0.05, 0.8, (jv.Wall(0.5, stiffness=30.0, damping=20.0), jv.Wall(2.0, 0.7)))
    assert next_impacts(sunk, 0.0, Impact(-1.0, 0.0, 0.1), 50.0, 1) == []


def test_what_a_record_does_not_determine_is_named():
    """Times stay as they are where all lengths grow together; a wall that was not struck is in no record."""
    free = {"amplitude": 0.1, "left.position": 0.1, "right.position": 0.1, "damping": 0.01}
    found = jv.fit(CHAOTIC, impact_record(), free)
    assert found.status == UNIDENTIFIABLE
    (lost,) = found.unidentifiable
    shares = np.array([lost.shares[name] for name in free])
    assert shares * np.sign(shares[0]) == pytest.approx(np.array([1, -1, 1, 0]) / np.sqrt(3), abs=0.02)
    assert np.isinf([found.sigma[name] for name in ("amplitude", "left.position", "right.position")]).all()
    assert abs(found.values["damping"] - 0.05) < 4 * found.sigma["damping"]
    far = CHAOTIC.replace(**{"left.position": -5.0, "right.restitution": 0.5, "amplitude": 0.6})
    free = {"damping": 0.01, "left.position": 0.1, "right.restitution": 0.1}
    found = jv.fit(far.replace(damping=0.052), sample_record(16, 10, scene=far), free)
    assert found.status == UNIDENTIFIABLE
    (lost,) = found.unidentifiable
    assert abs(lost.shares["left.position"]) == pytest.approx(1.0)
    assert np.isinf(found.sigma["left.position"]) and found.values["left.position"] == -5.0
    assert abs(errors(found, far))[[0, 2]].max() < 4.0


@pytest.mark.parametrize("what", ["impacts", "samples"])
def test_an_unknown_phase_is_found(what):
    late = {"impacts": 0.4, "samples": 1.1}[what]
    data = impact_record(3, late=late, phase=None, flawed=False)
    if what == "samples":
        data = sample_record(16, 8, late=late, phase=None)
    found = jv.fit(CHAOTIC.replace(damping=0.052), data, {"damping": 0.01, "right.position": 0.1})
    assert found.status == OK
    turned = (found.values["phase"] - late * OMEGA + np.pi) % (2 * np.pi) - np.pi
    assert abs(turned) < 4 * found.sigma["phase"] < 0.02
    assert abs(found.values["damping"] - 0.05) < 4 * found.sigma["damping"]


@pytest.mark.parametrize("what", ["impacts", "samples"])
def test_a_number_goes_no_further_than_its_bound(what):
    """The others are then those of a fit in which it is known."""
    data = impact_record(flawed=False) if what == "impacts" else sample_record(16, 6)
    begin, free = (
        CHAOTIC.replace(**{"damping": 0.052, "right.position": 0.998}),
        {"damping": 0.01, "right.position": 0.1},
    )
    found = jv.fit(begin, data, free, bounds={"right.position": (0.9, 0.9985)})
    assert found.status == jv.FitStatus.BOUND
    assert found.values["right.position"] == pytest.approx(0.9985, abs=1e-9)
    alone = jv.fit(begin.replace(**{"right.position": 0.9985}), data, {"damping": 0.01})
    assert found.values["damping"] == pytest.approx(alone.values["damping"], rel=1e-6)


def test_a_settled_record_holds_the_values_of_one_cycle():
    scene = jv.make_scene(1.0, 1.2, 0.1, 0.8, (jv.Wall(-0.6, 0.8), jv.Wall(0.6, 0.8)))
    settled, _ = jv.strobe(scene, jv.State(0.1, 1.0), periods=400)
    _, found = jv.strobe(scene, settled, periods=25, slots=60)
    hit, rng = np.asarray(found.side) != 0, np.random.default_rng(0)
    assert hit.sum() == 50
    heard = jv.ImpactRecord(
        np.asarray(found.time)[hit] + SIGMA * rng.normal(size=50), np.asarray(found.side)[hit], SIGMA
    )
    x, v = (float(part) + SIGMA * rng.normal(size=20) for part in (settled.x, settled.v))
    section = jv.SampleRecord(np.arange(20) * 2.0 * np.pi / 1.2, x, SIGMA, v)
    few = dict.fromkeys(("damping", "left.restitution", "amplitude"), 0.1)
    for data, free, least, held in ((heard, FREE, 5, "3 is recorded: .*frequency"), (section, few, 3, "2 is recorded")):
        with pytest.raises(
            jv.ArgumentError, match=f"at least {least} independent values, .* a settled motion with {held}"
        ):
            jv.fit(scene, data, free)
        found = jv.fit(scene.replace(damping=0.101), data, {"damping": 0.01})
        assert found.status == OK and abs(errors(found, scene)).max() < 4.0


def test_sections_of_a_chaotic_motion_are_fitted():
    """Once a period, in which neighbouring motions have long parted."""
    found = jv.fit(start(), sample_record(1, 60, True), FREE)
    assert found.status == OK
    assert abs(errors(found)).max() < 4.0 and max(found.sigma.values()) < 3e-3
    assert 0.7 < found.chi2 / found.dof < 1.4


def test_errors_larger_than_sigma_are_a_misfit_and_another_scene_fits_nothing():
    free = {name: FREE[name] for name in ("damping", "right.position")}
    found = jv.fit(start(tuple(free)), sample_record(16, 4, sigma=0.5 * SIGMA), free)
    assert found.status == jv.FitStatus.MISFIT and abs(errors(found)).max() < 8.0
    found = jv.fit(CHAOTIC.replace(amplitude=2.0), sample_record(16, 4), {"damping": 0.01})
    assert found.status == jv.FitStatus.NONE and found.values == {"damping": 0.05}


def test_a_motion_that_comes_to_rest_is_fitted():
    rests = jv.make_scene(1.5, 0.4, 0.05, 0.8, (jv.Wall(-0.5, 0.3), jv.Wall(0.6, 0.4)))
    assert np.sum(abs(np.diff(samples(40, 5, rests)[1])) < 1e-12) > 20
    free = {"right.restitution": 0.1, "amplitude": 0.1}
    found = jv.fit(start(tuple(free), rests), sample_record(40, 5, scene=rests), free)
    assert found.status in (OK, UNIDENTIFIABLE)
    assert abs(errors(found, rests)).max() < 4.0


@pytest.fixture(scope="module")
def points():
    """SN and SB of a scene, and their values in a scene with other damping and restitution."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    found = []
    for each in (scene, scene.replace(damping=0.062, restitution=0.74)):
        branch = jv.follow(jv.find_orbit(each, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
        found.append((branch.points("SN")[0], branch.points("SB")[0]))
    return scene, found[0], [point.value for point in found[1]]


POINT_FREE = {"damping": 0.02, "restitution": 0.05}


def test_special_points_are_fitted(points):
    scene, special, values = points
    pair = ("left.restitution", "right.restitution")
    for free, bounds in ((POINT_FREE, None), ({"damping": 0.02, pair: 0.05}, {pair: (0.5, 0.9)})):
        found = jv.fit(scene, jv.PointRecord(special, values, 1e-4), free, bounds)
        assert found.status == OK and found.dof == 0
        assert list(found.values) == ["damping", "restitution" if bounds is None else " = ".join(pair)]
        assert list(found.values.values()) == pytest.approx([0.062, 0.74], abs=1e-12)
        assert float(found.scene.damping) == found.values["damping"]
        assert "damping" in found.table() and "OK" in found.table()
    assert [float(wall.restitution) for wall in found.scene.walls.values()] == pytest.approx([0.74, 0.74], abs=1e-12)
    wrong = jv.fit(scene, jv.PointRecord(special, [values[0], values[1] + 0.06], 1e-3), {"damping": 0.02})
    assert wrong.status == jv.FitStatus.MISFIT and wrong.dof == 1 and wrong.chi2 > 100.0
    rough = jv.fit(scene, jv.PointRecord(special, values, 0.5), POINT_FREE)
    assert rough.status == UNIDENTIFIABLE and len(rough.unidentifiable) >= 1


def test_bad_fits_of_special_points(points):
    scene, special, values = points
    data = jv.PointRecord(special, values, 1e-4)
    for free, bounds, message in (
        ({}, None, r"free: must be"),
        ({"amplitude": 0.1}, None, r"free.amplitude: must not be the parameter of a point"),
        (POINT_FREE | {"frequency": 0.1}, None, r"data: must hold at least 3 values, as many as unknowns"),
        ({"damping": None}, None, r"free.damping: must be a real number"),
        ({"size": 1.0}, None, r"size: is not a parameter"),
        (POINT_FREE, {"damping": (0.1, 0.2)}, r"bounds.damping: must be \(low, high\)"),
    ):
        with pytest.raises(jv.ArgumentError, match=f"^{message}"):
            jv.fit(scene, data, free, bounds)
    for given, message in (
        ((values[:1], 1e-4), r"values: must have one entry for each point, 2"),
        (([np.nan, 1.0], 1e-4), r"values: must be finite"),
        ((values, 1e-4, ("up", None)), r"walls: must be"),
    ):
        with pytest.raises(jv.ArgumentError, match=f"^{message}"):
            jv.PointRecord(special, *given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": [0.0, np.nan]}, "times: must be finite"),
        ({"times": [1.0, 0.5]}, "times: must be in order"),
        ({"sides": [1, 0]}, "sides: must be -1"),
        ({"sides": [1]}, "sides: must have one entry for each"),
        ({"sigma": 0.0}, "sigma: must be a number greater than 0"),
        ({"phase": np.inf}, "phase: must be finite"),
        ({"x": [0.0, np.nan]}, "x"),
        ({"x": [0.0, 0.0], "times": [0.0, np.inf]}, "times"),
        ({"x": [0.0, 0.0], "times": [1.0, 1.0]}, "times.*in order"),
        ({"x": [0.0]}, "x: must have one entry for each time, 2"),
        ({"x": [0.0, 0.0], "sigma": 0.0}, "sigma: must be a number greater than 0"),
        ({"x": [0.0, 0.0], "v": [0.0]}, "v: must have one entry for each time, 2"),
        ({"x": [0.0, 0.0], "sigma_v": 0.1}, "sigma_v: must be omitted if v is not given"),
        ({"x": [0.0, 0.0], "v": [0.0, 0.0], "sigma_v": -0.1}, "sigma_v: must be a number greater than 0"),
        ({"x": [], "times": []}, "times"),
    ],
)
def test_bad_records(change, message):
    given = {"times": [0.0, 1.0], "sigma": 0.1, **change}
    with pytest.raises(jv.ArgumentError, match=f"^{message}"):
        jv.SampleRecord(**given) if "x" in change else jv.ImpactRecord(**{"sides": [-1, 1], **given})


def test_bad_arguments_of_a_fit():
    data, one_wall = impact_record(), jv.make_scene(1.0, 1.3, 0.05, 0.8, (None, 1.0))
    single = jv.make_scene(1.0, 1.3, 0.05, 0.8, (-1.0, 1.0), dtype=np.float32)
    short = jv.ImpactRecord(data.times[:6], data.sides[:6], SIGMA)
    few, free = jv.SampleRecord(np.arange(6.0), 0.1 * np.ones(6), SIGMA), {"damping": 0.01}
    for scene, record, free_numbers, bounds, message in [
        (single, data, free, None, "scene: must be in double precision; got 'float32'"),
        (CHAOTIC, data, {}, None, "free: must be"),
        (CHAOTIC, data, {"damping": 0.0}, None, "free.damping: must be a positive number"),
        (CHAOTIC, data, {"damping": None}, None, "free.damping: must be a real number"),
        (CHAOTIC, data, {"dampin": 0.1}, None, "dampin: is not a parameter"),
        (one_wall, data, free, None, "the scene has no left wall"),
        (CHAOTIC, data, free, {"amplitude": (0.5, 2.0)}, "bounds.amplitude: must belong to a free parameter"),
        (CHAOTIC, data, free, {"damping": (0.1, 0.2)}, r"\(low, high\) and contain the value of the scene, 0.05"),
        (CHAOTIC, short, FREE, None, r"at least 7 values, .*got '6 times'"),
        (CHAOTIC, few, FREE, None, "at least 7 values, as many as unknowns including the initial state; got '6"),
        (CHAOTIC, data.times, FREE, None, "data: must be"),
    ]:
        with pytest.raises(jv.ArgumentError, match=message):
            jv.fit(scene, record, free_numbers, bounds)
    with pytest.raises(jv.ArgumentError, match="runs on the host"):
        jax.jit(lambda scene: jv.fit(scene, data, FREE).chi2)(CHAOTIC)


@pytest.mark.parametrize(
    ("cost", "chi2", "prior_chi2", "accepted"),
    [(14.0, 39.0, 2.0, True), (1e6, 39.0, 2.0, False), (14.0, 40.0, 2.0, False), (14.0, 2.0, 40.0, False)],
)
def test_a_chain_is_accepted_if_it_is_a_motion_and_noise_explains_the_rest(cost, chi2, prior_chi2, accepted):
    """Ten residuals beyond two: noise exceeds a chi2 of 41.3 with probability 1e-5."""
    solution = SimpleNamespace(chi2=chi2, prior_chi2=prior_chi2, residuals=np.zeros(12))
    assert is_acceptable_chain(ImpactChain(np.zeros(6, int), (), solution, cost)) == accepted
