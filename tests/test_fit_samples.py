"""Fits of samples of x(t) and of sections: against another minimiser, the numbers that made a record, and its gaps."""

import functools

import numpy as np
import pytest
from scipy import optimize

import jaxvibro as jv
from jaxvibro.design import sample_fit
from jaxvibro.design.constrained_least_squares import FreeParameterSpec

SIGMA = 1e-3
CHAOTIC = jv.make_scene(1.0, 1.3, 0.05, 0.8, (jv.Wall(-1.0, 0.8), jv.Wall(1.0, 0.7)))
FREE = {"damping": 0.01, "left.restitution": 0.1, "right.restitution": 0.1, "right.position": 0.1, "frequency": 0.05}
OFF = {"damping": 1.04, "left.restitution": 0.97, "right.restitution": 1.02, "right.position": 0.96, "frequency": 1.03}
PERIOD = 2.0 * np.pi / 1.3


@functools.cache
def motion(often, periods, scene=CHAOTIC):
    """(times, x, v) so often in each of some drive periods."""
    times = np.arange(often * periods + 1) * 2.0 * np.pi / float(scene.frequency) / often
    state, status = jv.sample(scene, jv.State(0.3, 0.2), times)
    assert int(status) == 0
    return times, np.asarray(state.x), np.asarray(state.v)


def noisy(often, periods, velocities=False, seed=0, scene=CHAOTIC, **more):
    times, *channels = motion(often, periods, scene)
    rng = np.random.default_rng(seed)
    x, v = (one + SIGMA * rng.normal(size=len(times)) for one in channels)
    return jv.SampleRecord(times, x, SIGMA, v if velocities else None, **more)


def begun(names=tuple(FREE), scene=CHAOTIC):
    return scene.replace(**{name: scene.numbers[name] * OFF.get(name, 1.02) for name in names})


def away(found, scene=CHAOTIC):
    """The errors of a fit, in sigma."""
    return np.array([(value - scene.numbers[name]) / found.sigma[name] for name, value in found.values.items()])


def free_numbers(names, begun):
    ends = np.full(len(names), np.inf)
    return FreeParameterSpec(names, np.full(len(names), 0.1), begun, -ends, ends, 0.0 * np.eye(len(names)))


@pytest.mark.parametrize("velocities", [False, True])
def test_derivatives_are_those_of_differences(velocities):
    """Of what shots leave open and of residuals, by every node and number, the phase too; a wall moves."""
    walls = (jv.Wall(-1.0, 0.8, motion=jv.Motion(0.1, 0.3)), jv.Wall(1.0, 0.7))
    scene = jv.make_scene(1.2, 1.3, 0.05, 0.8, walls)
    names = ("left.motion.amplitude", "right.position", "phase")
    numbers = np.array([scene.numbers[name] for name in names[:2]] + [0.0])
    data = noisy(10, 3, velocities, scene=scene, phase=None)
    samples = sample_fit.make_sample_problem(scene, data, free_numbers(names, numbers))
    times, x, v = motion(10, 3, scene)
    node = samples.shots.start_indices
    states = np.stack([x[node], v[node]], 1)
    felt = sample_fit._linearise_shots(samples, samples.shots, states, numbers)
    assert len(felt.residuals) == (2 if velocities else 1) * len(times)
    assert abs(felt.constraint_values).max() < 1e-12
    assert felt.residuals == pytest.approx(
        np.stack([x, v], 1)[:, : 1 + velocities].ravel() / SIGMA - samples.measurements.ravel() / SIGMA, abs=1e-8
    )
    size = felt.constraint_jacobian.shape[1]
    for k in range(size):
        step = 1e-6 * (np.arange(size) == k)
        ends = [
            sample_fit._linearise_shots(
                samples, samples.shots, states + way * step[:-3].reshape(-1, 2), numbers + way * 0.1 * step[-3:]
            )
            for way in (1, -1)
        ]
        assert (
            abs(
                (ends[0].constraint_values - ends[1].constraint_values) / 2e-6
                - felt.constraint_jacobian[:, [k]].toarray()[:, 0]
            ).max()
            < 1e-6
        )
        by = felt.residual_jacobian[:, [k]].toarray()[:, 0]
        assert abs((ends[0].residuals - ends[1].residuals) / 2e-6 - by).max() < 1e-6 / SIGMA


def test_numbers_are_those_of_another_minimiser():
    """Of a short record: scipy's, of the distance of samples of one motion, ends at the same numbers and errors."""
    data = noisy(12, 3)
    free = {"left.restitution": 0.1, "right.position": 0.1}
    found = jv.fit(begun(tuple(free)), data, free)
    assert found.status == jv.FitStatus.OK
    assert found.dof == len(data.times) - 4

    def apart(unknowns):
        scene = CHAOTIC.replace(**{"left.restitution": unknowns[0], "right.position": unknowns[1]})
        return (np.asarray(jv.sample(scene, jv.State(*unknowns[2:]), data.times)[0].x) - data.x) / SIGMA

    theirs = optimize.least_squares(apart, [0.8, 1.0, 0.3, 0.2], xtol=1e-14, ftol=1e-14, gtol=1e-12)
    assert list(found.values.values()) == pytest.approx(theirs.x[:2], abs=1e-6)
    assert found.chi2 == pytest.approx(2 * theirs.cost, rel=1e-6)
    assert found.residuals == pytest.approx(-apart(theirs.x), abs=1e-2)
    assert found.covariance.values == pytest.approx(np.linalg.inv(theirs.jac.T @ theirs.jac)[:2, :2], rel=1e-3)


@pytest.mark.parametrize(
    ("often", "periods", "velocities"),
    [pytest.param(16, 30, False, marks=pytest.mark.long), pytest.param(1, 60, True, marks=pytest.mark.slow)],
)
def test_numbers_that_made_a_chaotic_record_are_found(often, periods, velocities):
    """Of x(t), and of a section once a period, in which neighbouring motions have long parted."""
    found = jv.fit(begun(), noisy(often, periods, velocities), FREE)
    assert found.status == jv.FitStatus.OK
    assert abs(away(found)).max() < 4.0
    assert max(found.sigma.values()) < 3e-3
    assert 0.7 < found.chi2 / found.dof < 1.4


def test_a_phase_that_is_not_known_is_found():
    data = noisy(16, 8)
    late = jv.SampleRecord(data.times - 1.1, data.x, SIGMA, phase=None)
    found = jv.fit(begun(("damping", "right.position")), late, {"damping": 0.01, "right.position": 0.1})
    assert found.status == jv.FitStatus.OK
    turned = (found.values["phase"] - 1.1 * 1.3 + np.pi) % (2 * np.pi) - np.pi
    assert abs(turned) < 4 * found.sigma["phase"] < 0.01
    assert abs(found.values["damping"] - 0.05) < 4 * found.sigma["damping"]


def test_a_wall_that_was_not_struck_is_not_in_the_record():
    far = CHAOTIC.replace(**{"left.position": -5.0, "right.restitution": 0.5, "amplitude": 0.6})
    free = {"damping": 0.01, "left.position": 0.1, "right.restitution": 0.1}
    found = jv.fit(far.replace(damping=0.052), noisy(16, 10, scene=far), free)
    assert found.status == jv.FitStatus.UNIDENTIFIABLE
    (lost,) = found.unidentifiable
    assert abs(lost.shares["left.position"]) == pytest.approx(1.0)
    assert np.isinf(found.sigma["left.position"])
    assert found.values["left.position"] == -5.0
    assert abs(away(found, far))[[0, 2]].max() < 4.0


def test_a_section_that_has_settled_holds_one_point():
    one = jv.make_scene(1.0, 1.2, 0.1, 0.8, (jv.Wall(-0.6, 0.8), jv.Wall(0.6, 0.8)))
    settled, _ = jv.strobe(one, jv.State(0.1, 1.0), periods=400)
    rng, times = np.random.default_rng(0), np.arange(20) * 2.0 * np.pi / 1.2
    x, v = (float(each) + SIGMA * rng.normal(size=20) for each in (settled.x, settled.v))
    with pytest.raises(
        jv.ArgumentError,
        match=r"data: must hold at least 3 independent values, .* a settled motion with 2 is recorded: .*damping",
    ):
        jv.fit(
            one, jv.SampleRecord(times, x, SIGMA, v), dict.fromkeys(("damping", "left.restitution", "amplitude"), 0.1)
        )
    found = jv.fit(one.replace(damping=0.101), jv.SampleRecord(times, x, SIGMA, v), {"damping": 0.01})
    assert found.status == jv.FitStatus.OK
    assert abs(away(found, one)).max() < 4.0


def test_errors_that_are_larger_than_told_are_a_misfit():
    data = noisy(16, 10)
    found = jv.fit(begun(), jv.SampleRecord(data.times, data.x, 0.5 * SIGMA), FREE)
    assert found.status == jv.FitStatus.MISFIT
    assert abs(away(found)).max() < 8.0


def test_a_record_of_another_scene_is_explained_by_none():
    found = jv.fit(CHAOTIC.replace(amplitude=2.0), noisy(16, 10), {"damping": 0.01})
    assert found.status == jv.FitStatus.NONE
    assert found.values == {"damping": 0.05}


def test_a_number_goes_no_further_than_its_bound():
    free = {"damping": 0.01, "right.position": 0.1}
    start = CHAOTIC.replace(**{"damping": 0.052, "right.position": 0.99})
    found = jv.fit(start, noisy(16, 6), free, bounds={"right.position": (0.9, 0.9985)})
    assert found.status == jv.FitStatus.BOUND
    assert found.values["right.position"] == pytest.approx(0.9985, abs=1e-9)


def test_a_soft_wall_and_a_motion_that_comes_to_rest():
    walls = (jv.Wall(-0.7, stiffness=40.0, damping=0.3), jv.Wall(0.9, 0.6))
    soft = jv.make_scene(1.5, 1.1, 0.05, 0.8, walls)
    free = {"damping": 0.01, "left.stiffness": 5.0, "left.damping": 0.1, "right.position": 0.1}
    found = jv.fit(begun(tuple(free), soft), noisy(16, 15, scene=soft), free)
    assert found.status == jv.FitStatus.OK
    assert abs(away(found, soft)).max() < 4.0
    rests = jv.make_scene(1.5, 0.4, 0.05, 0.8, (jv.Wall(-0.5, 0.3), jv.Wall(0.6, 0.4)))
    _, x, _ = motion(40, 5, rests)
    assert np.sum(abs(np.diff(x)) < 1e-12) > 20
    free = {"right.restitution": 0.1, "amplitude": 0.1}
    found = jv.fit(begun(tuple(free), rests), noisy(40, 5, scene=rests), free)
    assert found.status in (jv.FitStatus.OK, jv.FitStatus.UNIDENTIFIABLE)
    assert abs(away(found, rests)).max() < 4.0


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (([0.0, 1.0], [0.0, np.nan], SIGMA), "x"),
        (([0.0, np.inf], [0.0, 0.0], SIGMA), "times"),
        (([1.0, 1.0], [0.0, 0.0], SIGMA), "times.*in order"),
        (([0.0, 1.0], [0.0], SIGMA), "x: must have one entry for each time, 2"),
        (([0.0, 1.0], [0.0, 0.0], 0.0), "sigma: must be a number greater than 0"),
        (([0.0, 1.0], [0.0, 0.0], SIGMA, [0.0]), "v: must have one entry for each time, 2"),
        (([0.0, 1.0], [0.0, 0.0], SIGMA, None, 0.1), "sigma_v: must be omitted if v is not given"),
        (([0.0, 1.0], [0.0, 0.0], SIGMA, [0.0, 0.0], -0.1), "sigma_v: must be a number greater than 0"),
        (([], [], SIGMA), "times"),
    ],
)
def test_records_that_cannot_be(given, told):
    with pytest.raises(jv.ArgumentError, match=f"^{told}"):
        jv.SampleRecord(*given)


def test_more_unknowns_than_samples():
    with pytest.raises(
        jv.ArgumentError,
        match="data: must hold at least 7 values, as many as unknowns including the initial state; got '6",
    ):
        jv.fit(CHAOTIC, jv.SampleRecord(np.arange(6.0), 0.1 * np.ones(6), SIGMA), FREE)
