"""Fits: a chain's equations against flights, numbers against those that made a record, what a record does not say."""

import functools

import jax
import numpy as np
import pytest
from scipy import optimize

import jaxvibro as jv
from jaxvibro.design import impact_chain_equations
from jaxvibro.design.impact_chain_equations import ChainNodes
from jaxvibro.design.impact_prediction import Impact, MotionPredictor

from . import fit_proof

NAMES, SCALES = fit_proof.NAMES, fit_proof.SCALES
SIGMA = 1e-3
CHAOTIC = jv.make_scene(1.0, 1.3, 0.05, 0.8, (jv.Wall(-1.0, 0.8), jv.Wall(1.0, 0.7)))


@functools.cache
def motion():
    """(times, sides, speeds) of the first fifty impacts."""
    _, found = jv.strobe(CHAOTIC, jv.State(0.3, 0.2), periods=28, slots=60)
    return tuple(np.asarray(one)[:50] for one in (found.time, found.side, found.speed))


def begun(off=1.0):
    """The scene with its numbers some per cent off."""
    ways = np.array([0.04, -0.03, 0.02, -0.04, 0.03]) * off
    return CHAOTIC.replace(**{n: CHAOTIC.numbers[n] * (1 + way) for n, way in zip(NAMES, ways, strict=True)})


def noisy(seed=0, without=(), more=(), flawless=False):
    """A record of the motion: impacts taken out, or put in (time, side)."""
    times, sides, _ = motion()
    times = times + SIGMA * np.random.default_rng(seed).normal(size=len(times))
    times, sides = np.delete(times, without), np.delete(sides, without)
    times = np.append(times, [time for time, _ in more])
    sides = np.append(sides, [side for _, side in more])
    order = np.argsort(times)
    return jv.ImpactRecord(times[order], sides[order], SIGMA, flawed=not flawless)


def test_a_motion_leaves_nothing_open_and_derivatives_are_those_of_differences():
    times, sides, speeds = motion()
    nodes = ChainNodes(sides.astype(float), 0 * times, times, speeds)
    true = np.array([CHAOTIC.numbers[name] for name in NAMES])
    found = impact_chain_equations.flight_residuals(CHAOTIC, NAMES, nodes, true, 0.0)
    assert abs(found.values).max() < 1e-12
    least, _, _ = MotionPredictor(CHAOTIC, 0.0).min_clearances(nodes)
    assert least.min() > 0
    for k in range(len(NAMES)):
        ends = [
            impact_chain_equations.flight_residuals(CHAOTIC, NAMES, nodes, true + way * 1e-6 * np.eye(5)[k], 0.0)
            for way in (1, -1)
        ]
        assert abs((ends[0].values - ends[1].values) / 2e-6 - found.derivatives[:, :, 4 + k]).max() < 1e-6
    ends = [nodes._replace(time_or_x=times + way * 1e-6 * (np.arange(50) == 7)) for way in (1, -1)]
    ends = [impact_chain_equations.flight_residuals(CHAOTIC, NAMES, one, true, 0.0).values for one in ends]
    by = (ends[0] - ends[1]) / 2e-6
    assert abs(by[7] - found.derivatives[7, :, 0]).max() < 1e-6
    assert abs(by[6] - found.derivatives[6, :, 2]).max() < 1e-6


def test_a_motion_goes_on_from_soft_walls_both_ways():
    """Through stays within a moving soft wall, as the kernel has it, and the chain's equations leave nothing open."""
    moving = jv.Wall(-0.7, stiffness=30.0, damping=0.2, motion=jv.Motion(0.1, 2.0, harmonic=2))
    scene = jv.make_scene(2.0, 1.1, 0.05, 0.8, (moving, jv.Wall(0.8, 0.7)))
    _, found = jv.strobe(scene, jv.State(0.0, 1.0), periods=6, slots=30)
    times, sides, speeds = (np.asarray(one)[:9] for one in (found.time, found.side, found.speed))
    assert sorted(set(sides)) == [-1, 1]
    impacts = [Impact(*map(float, one)) for one in zip(sides, times, speeds, strict=True)]
    onward = MotionPredictor(scene, 0.0).next_impacts(impacts[0], times[-1] + 1e-6, 8)
    back = MotionPredictor(scene, 0.0, -1).next_impacts(impacts[-1], times[0] - 1e-6, 8)
    for mine, theirs in zip([*onward, *back], [*impacts[1:], *impacts[-2::-1]], strict=True):
        assert mine == pytest.approx(theirs, abs=1e-10)
    nodes = ChainNodes(sides.astype(float), 0 * times, times, speeds)
    found = impact_chain_equations.flight_residuals(scene, ("left.stiffness",), nodes, np.array([30.0]), 0.0)
    assert abs(found.values).max() < 1e-12
    least, _, _ = MotionPredictor(scene, 0.0).min_clearances(nodes)
    assert least.min() > 0
    sunk = jv.make_scene(0.0, 1.1, 0.05, 0.8, (jv.Wall(0.5, stiffness=30.0, damping=20.0), jv.Wall(2.0, 0.7)))
    assert MotionPredictor(sunk, 0.0).next_impacts(Impact(-1.0, 0.0, 0.1), 50.0, 1) == []


def test_impacts_on_a_soft_wall_are_fitted():
    """With two of them missing; an impact is when the mass comes to the wall."""
    scene = jv.make_scene(1.5, 1.3, 0.05, 0.8, (jv.Wall(-0.7, stiffness=30.0, damping=0.3), jv.Wall(0.9, 0.7)))
    _, found = jv.strobe(scene, jv.State(0.3, 0.2), periods=28, slots=60)
    times, sides = np.asarray(found.time)[:40], np.asarray(found.side)[:40]
    noisy_times = np.delete(times + SIGMA * np.random.default_rng(0).normal(size=40), (9, 23))
    data = jv.ImpactRecord(noisy_times, np.delete(sides, (9, 23)), SIGMA)
    free = {"damping": 0.01, "left.stiffness": 5.0, "left.damping": 0.1, "right.position": 0.1}
    off = {"damping": 0.052, "left.stiffness": 31.0, "left.damping": 0.29, "right.position": 0.88}
    fitted = jv.fit(scene.replace(**off), data, free)
    assert fitted.status == jv.FitStatus.OK
    assert [time for time, _ in fitted.missed] == pytest.approx(times[[9, 23]], abs=20 * SIGMA)
    for name in free:
        assert abs(fitted.values[name] - scene.numbers[name]) < 4.0 * fitted.sigma[name]


def test_numbers_are_those_of_least_squares_of_simulated_times():
    """Of a short record: a general minimiser, of the distance of times that strobes give, ends at the same numbers."""
    _times, sides, _ = motion()
    data = jv.ImpactRecord(noisy().times[:12], sides[:12], SIGMA, flawed=False)
    free = {"left.restitution": 0.1, "right.position": 0.1}
    found = jv.fit(begun(0.0).replace(**{"left.restitution": 0.79, "right.position": 1.01}), data, free)
    assert found.status == jv.FitStatus.OK

    def away(unknowns):
        scene = CHAOTIC.replace(**{"left.restitution": unknowns[0], "right.position": unknowns[1]})
        _, impacts = jv.strobe(scene, jv.State(unknowns[2], unknowns[3]), periods=28, slots=60)
        return (np.asarray(impacts.time)[:12] - data.times) / SIGMA

    theirs = optimize.least_squares(away, [0.8, 1.0, 0.3, 0.2], xtol=1e-14, ftol=1e-14, gtol=1e-12)
    assert list(found.values.values()) == pytest.approx(theirs.x[:2], abs=1e-6)
    assert found.chi2 == pytest.approx(2 * theirs.cost, rel=1e-6)
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac)[:2, :2]
    assert found.covariance.values == pytest.approx(covariance, rel=1e-3)


def test_errors_are_as_large_as_told():
    squares = []
    for seed in range(10):
        found = jv.fit(begun(), noisy(seed), SCALES)
        assert found.status == jv.FitStatus.OK
        assert found.missed == ()
        assert found.spurious == ()
        squares.append(fit_proof.apart(found, CHAOTIC)[1])
    assert 25 < np.sum(squares) < 85  # chi2 of 50: 0.2 % on either side
    assert "right.position" in found.table()


def test_missed_and_spurious_impacts_are_found():
    times, sides, _ = motion()
    found = jv.fit(begun(), noisy(1, without=(8, 30, 31)), SCALES)
    assert found.status == jv.FitStatus.OK
    assert [side for _, side in found.missed] == list(sides[[8, 30, 31]])
    assert [time for time, _ in found.missed] == pytest.approx(times[[8, 30, 31]], abs=10 * SIGMA)
    between = (float(times[20]) + 0.6 * float(times[21] - times[20]), int(sides[21]))
    found = jv.fit(begun(), noisy(2, more=(between,)), SCALES)
    assert found.status == jv.FitStatus.OK
    assert found.spurious == (21,)
    assert found.missed == ()
    assert fit_proof.apart(found, CHAOTIC)[1] < 20


def test_what_a_record_does_not_say_is_named():
    """Times stay as they are where the amplitude and all lengths grow together."""
    free = {"amplitude": 0.1, "left.position": 0.1, "right.position": 0.1, "damping": 0.01}
    found = jv.fit(CHAOTIC, noisy(), free)
    assert found.status == jv.FitStatus.UNIDENTIFIABLE
    (lost,) = found.unidentifiable
    shares = np.array([lost.shares[name] for name in free])
    assert shares * np.sign(shares[0]) == pytest.approx(np.array([1, -1, 1, 0]) / np.sqrt(3), abs=0.02)
    assert np.isinf([found.sigma[name] for name in ("amplitude", "left.position", "right.position")]).all()
    assert abs(found.values["damping"] - 0.05) < 4 * found.sigma["damping"]


def test_a_phase_that_is_not_known_is_found():
    _times, _sides, _ = motion()
    data = noisy(3)
    late = jv.ImpactRecord(data.times - 0.4, data.sides, SIGMA, phase=None, flawed=False)
    found = jv.fit(CHAOTIC.replace(damping=0.052), late, {"damping": 0.01, "right.position": 0.1})
    assert found.status == jv.FitStatus.OK
    turned = (found.values["phase"] - 0.4 * 1.3 + np.pi) % (2 * np.pi) - np.pi
    assert abs(turned) < 4 * found.sigma["phase"]


def test_a_number_goes_no_further_than_its_bound():
    """And the others are then those of a fit in which it is known."""
    start = CHAOTIC.replace(**{"damping": 0.052, "right.position": 0.998})
    free = {"damping": 0.01, "right.position": 0.1}
    found = jv.fit(start, noisy(flawless=True), free, bounds={"right.position": (0.9, 0.9985)})
    assert found.status == jv.FitStatus.BOUND
    assert found.values["right.position"] == pytest.approx(0.9985, abs=1e-9)
    alone = jv.fit(start.replace(**{"right.position": 0.9985}), noisy(flawless=True), {"damping": 0.01})
    assert found.values["damping"] == pytest.approx(alone.values["damping"], rel=1e-6)


def test_a_settled_record_holds_its_phases_alone():
    one = jv.make_scene(1.0, 1.2, 0.1, 0.8, (jv.Wall(-0.6, 0.8), jv.Wall(0.6, 0.8)))
    settled, _ = jv.strobe(one, jv.State(0.1, 1.0), periods=400)
    _, found = jv.strobe(one, settled, periods=25, slots=60)
    hit = np.asarray(found.side) != 0
    assert hit.sum() == 50
    times = np.asarray(found.time)[hit] + SIGMA * np.random.default_rng(0).normal(size=50)
    data = jv.ImpactRecord(times, np.asarray(found.side)[hit], SIGMA)
    with pytest.raises(
        jv.ArgumentError, match=r"at least 5 independent values, .* a settled motion with 3 is recorded: .*frequency"
    ):
        jv.fit(one, data, SCALES)
    two = jv.fit(one.replace(damping=0.102), data, {"damping": 0.01})
    assert abs(two.values["damping"] - 0.1) < 4 * two.sigma["damping"]


BAD = [
    ({"times": [0.0, np.nan]}, "times: must be finite"),
    ({"times": [1.0, 0.5]}, "times: must be in order"),
    ({"sides": [1, 0]}, "sides: must be -1"),
    ({"sides": [1]}, "sides: must have one entry for each"),
    ({"sigma": 0.0}, "sigma: must be a number greater than 0"),
    ({"phase": np.inf}, "phase: must be finite"),
]


@pytest.mark.parametrize(("change", "told"), BAD)
def test_bad_records_are_refused(change, told):
    with pytest.raises(jv.ArgumentError, match=told):
        jv.ImpactRecord(**{"times": [0.0, 1.0], "sides": [-1, 1], "sigma": 0.1, **change})


def test_bad_questions_are_refused():
    data, one_wall = noisy(), jv.make_scene(1.0, 1.3, 0.05, 0.8, (None, 1.0))
    single = jv.make_scene(1.0, 1.3, 0.05, 0.8, (-1.0, 1.0), dtype=np.float32)
    for scene, free, told in [
        (single, {"damping": 0.1}, "scene: must be in double precision; got 'float32'"),
        (CHAOTIC, {}, "free: must be"),
        (CHAOTIC, {"damping": 0.0}, "free.damping: must be a positive number"),
        (CHAOTIC, {"damping": None}, "free.damping: must be a real number"),
        (CHAOTIC, {"dampin": 0.1}, "dampin: is not a parameter"),
        (one_wall, {"damping": 0.1}, "the scene has no left wall"),
    ]:
        with pytest.raises(jv.ArgumentError, match=told):
            jv.fit(scene, data, free)
    for bounds, told in [
        ({"amplitude": (0.5, 2.0)}, "bounds.amplitude: must belong to a free parameter"),
        ({"damping": (0.1, 0.2)}, r"bounds.damping: must be \(low, high\) and contain the value of the scene, 0.05"),
    ]:
        with pytest.raises(jv.ArgumentError, match=told):
            jv.fit(CHAOTIC, data, {"damping": 0.01}, bounds)
    short = jv.ImpactRecord(data.times[:6], data.sides[:6], SIGMA)
    with pytest.raises(jv.ArgumentError, match=r"at least 7 values, .*got '6 times'"):
        jv.fit(CHAOTIC, short, SCALES)
    with pytest.raises(jv.ArgumentError, match="data: must be"):
        jv.fit(CHAOTIC, data.times, SCALES)
    with pytest.raises(jv.ArgumentError, match="runs on the host"):
        jax.jit(lambda scene: jv.fit(scene, data, SCALES).chi2)(CHAOTIC)
