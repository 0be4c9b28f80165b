"""Lyapunov exponents: exact ones, the sum that impacts and damping make, error bars that are honest, and refusals."""

from importlib import import_module

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.attractors.batch_means import standard_error
from jaxvibro.attractors.chaotic_exponents import estimate_exponents
from jaxvibro.scene.check import ArgumentError
from jaxvibro.scene.codes import Status
from tests.reference import closed
from tests.spectrum_proof import other
from tests.test_rest import BY_HAND, NEAR, next_rest

OMEGA, GAMMA = 2.1, 0.05
LENGTH = 2 * np.pi / OMEGA
START = jv.State(0.9, -1.1)


def scene(restitution=0.7, walls=(-1.0, 1.0), damping=GAMMA, frequency=OMEGA, amplitude=1.0):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls)


def exact(amplitude, restitution=0.7):
    """The exponents of symmetric P111, in closed form."""
    orbit = closed.orbits(GAMMA, OMEGA, amplitude, restitution, 1.0, symmetric=True)[0]
    pair = closed.multipliers(GAMMA, OMEGA, amplitude, restitution, orbit, symmetric=True)
    return sorted((float(np.log(float(abs(one)))) if one else -np.inf for one in pair), reverse=True)


def test_orbits_have_the_logarithms_of_their_multipliers():
    starts = jv.State(x=np.array([0.0, 0.9, 0.9]), v=np.array([0.0, -1.1, -1.1]))
    found = jv.spectrum(scene(), "amplitude", [1.0, 2.0, 3.5], starts)
    assert abs(found.exponent[0] + GAMMA * LENGTH).max() < 1e-14  # P100
    assert abs(found.exponent[1] - exact(2.0)).max() < 1e-12
    assert abs(found.exponent[2] - exact(3.5)).max() < 1e-12
    assert list(found.periods) == [1, 1, 1] and list(found["count"]) == [1, 1, 1]
    assert found.impacts_on.values.tolist() == [[0, 0], [1, 1], [1, 1]]
    assert found.error.max() < 1e-12 and (found.status == 0).all()


def test_longer_orbits():
    """P112 and what it has become after doubling, against the product of the strobe's derivatives."""
    values = [4.8, 5.2]
    found = jv.spectrum(scene(), "amplitude", values, START)
    for value, n, rates in zip(values, found.periods.values.tolist(), found.exponent.values, strict=True):
        assert n > 1
        here, state = scene(amplitude=value), START
        for _ in range(10):
            state, _ = jv.strobe(here, state, periods=100)
        pair = np.linalg.eigvals(jv.monodromy(here, state, periods=n))
        assert abs(rates[0] - np.log(abs(pair)).max() / n) < 1e-6


def test_the_sum_is_what_impacts_and_damping_leave():
    walls = (jv.Wall(-1.0, restitution=0.7), jv.Wall(1.0, restitution=0.72))
    found = jv.spectrum(scene(walls=walls), "amplitude", [2.0, 8.0, 10.0], START, error=0.02, most=1)
    left, right = found.impacts_on.values.T
    assert (found["count"] > 8000).any()
    off = found.exponent.sum("order").values + 2 * GAMMA * LENGTH - 2 * (np.log(0.7) * left + np.log(0.72) * right)
    assert abs(off).max() < 1e-12
    assert (found.exponent[:, 0] >= found.exponent[:, 1]).all()


def test_a_wall_that_takes_all_speed():
    """One multiplier is 0, the other the limit of that for small R. At A = 4 a wall holds the mass for a while."""
    found = jv.spectrum(scene(0.0), "amplitude", [2.0, 4.0], START)
    assert abs(found.exponent[0, 0] - exact(2.0, 1e-9)[0]) < 1e-7 and np.isneginf(found.exponent[0, 1])
    assert np.isneginf(found.exponent[1]).all()
    assert (found.status == 0).all() and (found.impacts == 2).all() and found.error.max() < 1e-12


def test_without_losses_the_exponents_are_opposite():
    """At these amplitudes there is no chaos from this start: a shear alone, which the error allows for."""
    lossless = scene(1.0, damping=0.0)
    found = jv.spectrum(lossless, "amplitude", [0.0, 0.8, 3.2], START, error=0.02, most=1)
    assert abs(found.exponent.sum("order")).max() < 1e-15
    assert (abs(found.exponent[:2, 0]) < 3 * found.error[:2, 0]).all() and found.exponent[2, 0] > 0.3


def test_a_mass_that_rests_forgets_all():
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    found = jv.spectrum(chatter, "amplitude", [0.3, 0.2], jv.State(-1.2, 0.3))
    assert np.isneginf(found.exponent).all() and (found.error == 0).all() and (found.status == 0).all()
    assert (found.rests == 0).all() and np.isnan(found.between).all()  # pressed on all the time


def test_the_rests_of_a_period_and_the_growth_between_them_are_told():
    """Against the moment of rest by brute force (test_rest)."""
    hopping = jv.make_scene(1.5, 0.5, 0.1, 0.6, (None, -1.0))
    found = jv.spectrum(hopping, "amplitude", [0.3, 1.5], jv.State(-1.2, 0.0))
    assert found.rests.values.tolist() == [0.0, 1.0] and np.isneginf(found.exponent).all()
    growth, span = next_rest(*BY_HAND[0])
    assert abs(float(found.between[1]) * span / (4 * np.pi) - np.log(growth)) < NEAR and found.between[1] > 0
    assert found.between.attrs["units"] == found.rests.attrs["units"] == "per drive period"


def test_no_wall_any_damping():
    free = scene(walls=(None, None))
    found = jv.spectrum(free, "damping", [0.0, 0.2, 2.0], jv.State(0.3, 0.1), settle=100)
    fast, slow = 2.0 + 3.0**0.5, 2.0 - 3.0**0.5
    true = np.array([[0.0, 0.0], [-0.2, -0.2], [-slow, -fast]]) * LENGTH
    assert abs(found.exponent[0]).max() < 1e-7  # where it recurs M is the identity: a root of rounding is left
    assert abs(found.exponent - true)[1:].max() < 1e-10 and (found.impacts == 0).all()


def test_walls_shaken_together_are_another_drive():
    """z = x - x_b feels A - B (1 - omega^2 + 2 i gamma omega) in place of A."""
    swing = 0.2
    moving = [jv.Wall(place, motion=jv.Motion(swing)) for place in (-1.0, 1.0)]
    shift = swing * (1 - OMEGA**2 + 2j * GAMMA * OMEGA)
    values = np.array([3.2, 3.5])
    found = jv.spectrum(scene(walls=moving), "amplitude", values, START)
    still = jv.spectrum(scene(), "amplitude", abs(values - shift), START)
    assert abs(found.exponent - still.exponent.values).max() < 1e-9
    assert (found.impacts.values == still.impacts.values).all() and (found.impacts > 0).all()


@pytest.fixture(scope="module")
def many():
    """One chaotic motion from many starts, as many estimates."""
    rng = np.random.default_rng(5)
    starts = jv.State(rng.uniform(-1, 1, 24), rng.uniform(-2, 2, 24))
    return jv.spectrum(scene(), "amplitude", np.full(24, 10.0), starts, error=1.0, most=30_000)


def test_error_bars_are_honest(many):
    for k in range(2):
        rates, errors = many.exponent[:, k].values, many.error[:, k].values
        pulls = (rates - rates.mean()) / errors
        assert abs(pulls).max() < 4 and 0.6 < pulls.std() < 1.5
        assert errors.max() < 2 * errors.min()


def test_it_stops_by_its_errors_or_by_most(many):
    coarse = jv.spectrum(scene(), "amplitude", [10.0], START, error=8e-3)
    fine = jv.spectrum(scene(), "amplitude", [10.0], START, error=4e-3, most=2**20)
    short = jv.spectrum(scene(), "amplitude", [10.0], START, error=1e-4, most=50_000)
    assert coarse.error.max() <= 8e-3 and fine.error.max() <= 4e-3 and short.error.max() > 1e-4
    assert 40_000 <= short["count"] <= 60_000 and fine["count"] < 2**20
    for one in (coarse, fine, short):
        pulls = (one.exponent[0] - many.exponent.mean("amplitude")) / np.hypot(one.error[0], many.error[0] / 24**0.5)
        assert abs(pulls).max() < 4
    assert many.periods.max() == 0


def test_values_do_not_see_each_other():
    done = []
    both = jv.spectrum(scene(), "amplitude", [10.0, 2.0], START, error=0.05, most=1, progress=done.append)
    alone = jv.spectrum(scene(), "amplitude", [10.0], START, error=0.05, most=1)
    assert done == [1, 2]
    assert (both.exponent[0].values == alone.exponent[0].values).all()
    assert both.attrs["swept"] == "amplitude" and both.attrs["damping"] == GAMMA and both.exponent.attrs["units"]


def test_what_settles_while_it_is_averaged_is_an_orbit(monkeypatch):
    """Near the pitchfork at 3.5439 motions settle slowly; here they are given too little time."""
    values, home = [2.0, 3.53], import_module("jaxvibro.attractors.spectrum")
    patient = jv.spectrum(scene(), "amplitude", values, START)
    monkeypatch.setattr(home, "FEW_ROUNDS", 1)
    monkeypatch.setattr(home, "MANY_ROUNDS", 1)
    averaged, done = [], []
    monkeypatch.setattr(home, "estimate_exponents", lambda *given: averaged.append(given) or estimate_exponents(*given))
    found = jv.spectrum(scene(), "amplitude", values, START, settle=0, progress=done.append)
    assert len(averaged) > 0 and done[-1] == 2
    assert (found.periods == 1).all() and abs(found.exponent - patient.exponent).max() < 1e-9


def test_a_motion_without_end_has_no_exponents():
    narrow = scene(amplitude=0.0, damping=0.0, walls=(-0.01, 0.01))
    found = jv.spectrum(narrow, "restitution", [1.0], jv.State(0.0, 10.0), settle=1)
    assert np.isnan(found.exponent).all() and found.status == Status.CAP and found["count"] == 0
    often = jv.spectrum(narrow, "restitution", [1.0], jv.State(0.0, 0.4), settle=1, most=1)
    assert np.isnan(often.exponent).all() and often.status == Status.FULL


def correlated(blocks, copies, memory, seed=0):
    """Numbers of variance 1 that remember: x = memory x + noise."""
    rng, x, found = np.random.default_rng(seed), np.zeros(copies), []
    for _ in range(blocks + 100):
        x = memory * x + (1 - memory**2) ** 0.5 * rng.normal(size=copies)
        found.append(x)
    return np.stack(found[100:])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_a_standard_error_knows_of_memory(memory):
    true = ((1 + memory) / (1 - memory) / (2000 * 16)) ** 0.5
    assert abs(standard_error(16.0 * correlated(2000, 16, memory), 16) / true - 1) < 0.2


def test_a_standard_error_sees_copies_that_are_one():
    one = correlated(2000, 1, 0.5)
    true = (3 / 2000) ** 0.5
    assert abs(standard_error(np.tile(one, 64), 1) / true - 1) < 0.35
    assert standard_error(one[:4], 1) == np.inf


@pytest.mark.parametrize(
    "more, key, rule",
    [
        ({"name": "amplitud"}, "amplitud", "is not a parameter of this scene"),
        ({"values": [1.0, np.nan]}, "amplitude", "must be finite; got nan at index"),
        ({"values": []}, "amplitude", "at least one"),
        ({"values": [[1.0, 2.0]]}, "amplitude", "must be a sequence of at least one value"),
        ({"name": "frequency", "values": [1.0, 0.0]}, "frequency", "must be greater than 0; got 0.0 at index (1,)"),
        ({"name": "right.position", "values": [3.0, 0.5]}, "state.x", "must lie between the walls"),
        ({"state": jv.State(0.0, [0.0, 1.0, 2.0])}, "state.v", "must broadcast"),
        ({"state": jv.State(np.inf, 0.0)}, "state.x", "must be finite; got inf"),
        ({"state": (0.0, 0.0)}, "state", "must be a State"),
        ({"settle": -1}, "settle", "must be a whole number from 0 on; got -1"),
        ({"most": 0}, "most", "must be a whole number from 1 on; got 0"),
        ({"error": 0.0}, "error", "must be greater than 0; got 0.0"),
        ({"error": np.nan}, "error", "must be finite; got nan"),
        ({"error": [1e-3, 2e-3]}, "error", "must be a real number"),
        ({"scene": jv.make_scene}, "scene", "must be a single scene"),
    ],
)
def test_refused_before_any_work(more, key, rule):
    given = {"scene": scene(), "name": "amplitude", "values": [1.0, 2.0], "state": START} | more
    if "scene" in more:
        given["scene"] = scene(amplitude=np.array([1.0, 2.0]))
    with pytest.raises(ArgumentError) as told:
        jv.spectrum(**given, progress=pytest.fail)
    assert told.value.key == key and rule in str(told.value)


def drawn(exponent, error=0.0):
    values = np.linspace(0.0, 6.0, len(exponent))
    dims = ("amplitude", "order")
    numbers = {"exponent": (dims, np.array(exponent, float)), "error": (dims, np.full((len(exponent), 2), error))}
    return xr.Dataset(numbers, {"amplitude": values}, {"swept": "amplitude"})


def test_a_picture_of_both_exponents():
    data, ax = drawn([[-0.1, -1.0], [0.2, -2.0], [0.3, -np.inf], [np.nan, np.nan]], 0.01), Figure().subplots()
    assert jv.plot.spectrum(data, ax) is ax and plt.get_fignums() == []
    zero, first, _, second, deep = ax.lines
    assert list(zero.get_ydata()) == [0.0, 0.0]
    assert list(first.get_ydata()[:3]) == [-0.1, 0.2, 0.3] and np.isnan(first.get_ydata()[3])
    assert np.isnan(second.get_ydata()[2]) and list(deep.get_xdata()) == [4.0]
    assert first.get_linestyle() != second.get_linestyle() and first.get_color() != second.get_color()
    (shade,) = (one for one in ax.patches if one.get_label() == "_chaotic")
    assert (shade.get_x(), shade.get_width()) == (1.0, 4.0)
    assert len(ax.collections) == 2 and "A = F" in ax.get_xlabel() and "drive period" in ax.get_ylabel()
    apart = drawn([[np.nan, np.nan], [0.2, -1.0], [-np.inf, -np.inf], [0.1, -np.inf], [0.1, -1.0]])
    dots = [line for line in jv.plot.spectrum(apart, Figure().subplots()).lines if line.get_marker() == "o"]
    assert [line.get_xydata().tolist() for line in dots] == [[[1.5, 0.2]], [[1.5, -1.0], [6.0, -1.0]]]
    between = apart.assign(between=("amplitude", [np.nan, np.nan, 1.5, np.nan, np.nan]))
    ax = jv.plot.spectrum(between, Figure().subplots())
    assert ax.get_legend_handles_labels()[1][-1] == "growth between rests"
    doubtful = jv.plot.spectrum(drawn([[0.02, -1.0], [0.02, -1.0]], 0.01), Figure().subplots())
    assert not doubtful.patches


def test_against_another_method():
    values = np.array([5.0, 5.95, 8.0, 9.5])
    found = jv.spectrum(scene(), "amplitude", values, START, error=3e-3)
    rates, errors, hits = other(values, START, periods=250, count=256)
    pulls = (found.exponent.values - rates) / np.hypot(found.error.values, errors)
    assert errors.max() < 0.012 and abs(pulls).max() < 4 and abs(found.impacts.values - hits).max() < 0.02
