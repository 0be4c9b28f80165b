"""Lyapunov exponents and sweeps: error estimates, batches, moved walls, tables and pictures."""

from importlib import import_module

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.attractors.chaotic_exponents import standard_error
from jaxvibro.flight.wall_positions import adapt_to_moved_walls, wall_states
from tests.reference.soft_lanes import Lanes, Wall, exponents

OMEGA, GAMMA = 2.1, 0.05
LENGTH = 2 * np.pi / OMEGA
START = jv.State(0.9, -1.1)
CAP, FULL = 2, 1  # status


def scene(restitution=0.7, walls=(-1.0, 1.0), damping=GAMMA, frequency=OMEGA, amplitude=1.0):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls)


def test_without_losses_the_exponents_are_opposite():
    """At 0 and 0.8 a shear alone, which the error allows for."""
    lossless = scene(1.0, damping=0.0)
    data = jv.spectrum(lossless, "amplitude", [0.0, 0.8, 3.2], state=START, error=0.02, most=1)
    assert abs(data.exponent.sum("order")).max() < 1e-15
    assert (abs(data.exponent[:2, 0]) < 3 * data.error[:2, 0]).all() and data.exponent[2, 0] > 0.3


def test_a_mass_that_sticks_forgets_its_start():
    """The growth between sticking phases is that of `next_rest` in test_rest, by closed forms of the flight."""
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    data = jv.spectrum(chatter, "amplitude", [0.3, 0.2], jv.State(-1.2, 0.3))
    assert np.isneginf(data.exponent).all() and (data.error == 0).all() and (data.status == 0).all()
    assert (data.rests == 0).all() and np.isnan(data.between).all()  # pressed on all the time
    data = jv.spectrum(chatter, "amplitude", [0.3, 1.5], jv.State(-1.2, 0.0))
    assert data.rests.values.tolist() == [0.0, 1.0] and np.isneginf(data.exponent).all()
    assert abs(float(data.between[1]) - 1.8547) < 0.05
    assert data.between.attrs["units"] == data.rests.attrs["units"] == "per drive period"


def test_no_wall_any_damping():
    free = scene(walls=(None, None))
    data = jv.spectrum(free, "damping", [0.0, 0.2, 2.0], jv.State(0.3, 0.1), settle=100)
    fast, slow = 2.0 + 3.0**0.5, 2.0 - 3.0**0.5
    true = np.array([[0.0, 0.0], [-0.2, -0.2], [-slow, -fast]]) * LENGTH
    assert abs(data.exponent[0]).max() < 1e-7  # where it recurs M is the identity: a root of rounding is left
    assert abs(data.exponent - true)[1:].max() < 1e-10 and (data.impacts == 0).all()


@pytest.fixture(scope="module")
def many():
    """One chaotic motion from many starts, as many estimates."""
    rng = np.random.default_rng(5)
    starts = jv.State(rng.uniform(-1, 1, 24), rng.uniform(-2, 2, 24))
    return jv.spectrum(scene(), "amplitude", np.full(24, 10.0), starts, error=1.0, most=30_000)


def test_errors_are_those_of_many_estimates(many):
    for k in range(2):
        rates, errors = many.exponent[:, k].values, many.error[:, k].values
        pulls = (rates - rates.mean()) / errors
        assert abs(pulls).max() < 4 and 0.6 < pulls.std() < 1.5
        assert errors.max() < 2 * errors.min()
    assert many.periods.max() == 0


def test_exponents_of_chaos_by_another_method(many):
    """Closed forms in NumPy, both tangents measured: chaotic and periodic motions."""
    values, copies, periods = np.array([5.0, 5.95, 8.0, 10.0]), 64, 200
    data = jv.spectrum(scene(), "amplitude", values, START, error=5e-3)
    walls, growth, hits = [Wall(-1, -1.0, 0.7), Wall(1, 1.0, 0.7)], [], []
    for amplitude in values:
        v = START.v + 1e-7 * np.random.default_rng(1).normal(size=copies)
        rates, impacts, _ = exponents(Lanes(amplitude, OMEGA, GAMMA, walls, np.full(copies, START.x), v), periods, 150)
        growth.append(rates)
        hits.append(impacts.sum(axis=0))
    growth, hits = np.array(growth), np.array(hits)
    errors = np.maximum(growth.std(axis=1, ddof=1) / copies**0.5, 1.0 / periods)
    pulls = (data.exponent.values - growth.mean(axis=1)) / np.hypot(data.error.values, errors)
    assert errors.max() < 0.025 and abs(pulls).max() < 4 and abs(data.impacts.values - hits.mean(axis=1)).max() < 0.04
    assert abs(data.exponent[3].values - many.exponent.mean("amplitude").values).max() < 0.02


def test_the_average_ends_by_its_errors_or_by_most(many):
    coarse = jv.spectrum(scene(), "amplitude", [10.0], START, error=8e-3)
    fine = jv.spectrum(scene(), "amplitude", [10.0], START, error=4e-3, most=2**20)
    short = jv.spectrum(scene(), "amplitude", [10.0], START, error=1e-4, most=50_000)
    assert coarse.error.max() <= 8e-3 and fine.error.max() <= 4e-3 and short.error.max() > 1e-4
    assert 40_000 <= short["count"] <= 60_000 and fine["count"] < 2**20
    for one in (coarse, fine, short):
        pulls = (one.exponent[0] - many.exponent.mean("amplitude")) / np.hypot(one.error[0], many.error[0] / 24**0.5)
        assert abs(pulls).max() < 4


def test_values_do_not_depend_on_each_other():
    done = []
    both = jv.spectrum(scene(), "amplitude", [10.0, 2.0], START, error=0.05, most=1, progress=done.append)
    alone = jv.spectrum(scene(), "amplitude", [10.0], START, error=0.05, most=1)
    assert done == [1, 2]
    assert (both.exponent[0].values == alone.exponent[0].values).all()
    assert both.attrs["swept"] == "amplitude" and both.attrs["damping"] == GAMMA and both.exponent.attrs["units"]


def test_a_motion_that_settles_while_it_is_averaged_is_an_orbit(monkeypatch):
    """Near the pitchfork at 3.5439 motions settle slowly; here they have too little time."""
    values, home = [2.0, 3.53], import_module("jaxvibro.attractors.spectrum")
    patient, estimate = jv.spectrum(scene(), "amplitude", values, START), home.estimate_exponents
    monkeypatch.setattr(home, "FEW_ROUNDS", 1)
    monkeypatch.setattr(home, "MANY_ROUNDS", 1)
    averaged, done = [], []
    monkeypatch.setattr(home, "estimate_exponents", lambda *given: averaged.append(given) or estimate(*given))
    data = jv.spectrum(scene(), "amplitude", values, START, settle=0, progress=done.append)
    assert len(averaged) > 0 and done[-1] == 2
    assert (data.periods == 1).all() and abs(data.exponent - patient.exponent).max() < 1e-9


def test_a_motion_with_too_many_impacts_has_no_exponents():
    narrow = scene(amplitude=0.0, damping=0.0, walls=(-0.01, 0.01))
    endless = jv.spectrum(narrow, "restitution", [1.0], jv.State(0.0, 10.0), settle=1)
    assert np.isnan(endless.exponent).all() and endless.status == CAP and endless["count"] == 0
    often = jv.spectrum(narrow, "restitution", [1.0], jv.State(0.0, 0.4), settle=1, most=1)
    assert np.isnan(often.exponent).all() and often.status == FULL


def correlated(blocks, copies, memory, seed=0):
    """Return numbers of variance 1 with a memory: x = memory x + noise."""
    rng, x, numbers = np.random.default_rng(seed), np.zeros(copies), []
    for _ in range(blocks + 100):
        x = memory * x + (1 - memory**2) ** 0.5 * rng.normal(size=copies)
        numbers.append(x)
    return np.stack(numbers[100:])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_a_standard_error_allows_for_memory_and_for_equal_copies(memory):
    true = ((1 + memory) / (1 - memory) / (2000 * 16)) ** 0.5
    assert abs(standard_error(16.0 * correlated(2000, 16, memory), 16) / true - 1) < 0.2
    one = correlated(2000, 1, 0.5)
    assert abs(standard_error(np.tile(one, 64), 1) / (3 / 2000) ** 0.5 - 1) < 0.35
    assert standard_error(one[:4], 1) == np.inf


def drawn(exponent, error=0.0):
    values, dims = np.linspace(0.0, 6.0, len(exponent)), ("amplitude", "order")
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
    (shade,) = (patch for patch in ax.patches if patch.get_label() == "_chaotic")
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


def forced(amplitude, frequency, damping):
    """Return x and v at phase 0 of the steady motion that meets no wall."""
    d = (1 - frequency**2) ** 2 + (2 * damping * frequency) ** 2
    return amplitude * (1 - frequency**2) / d, amplitude * 2 * damping * frequency**2 / d


def test_batches_and_the_attributes_of_a_sweep():
    """Lanes of the scene and of the state, on a wall's parameter; a parameter with lanes becomes a coordinate."""
    lanes = scene(amplitude=np.array([0.5, 1.0, 3.0]), walls=(-3.0, jv.Wall(3.0, restitution=0.9)))
    data = jv.sweep(lanes, "right.restitution", [0.9, 0.1], jv.State(x=0.1, v=[0.0, 0.1, 0.2]), settle=200, keep=2)
    assert data.x.dims == ("right.restitution", "lane", "period") and data.x.shape == (2, 3, 2)
    assert list(data.amplitude) == [0.5, 1.0, 3.0] and data.amplitude.dims == ("lane",)
    expected = {"damping": 0.05, "left.position": -3.0, "walls": "left right", "restitution": 0.7, "phase": 0.0}
    expected |= {"swept": "right.restitution"}
    assert {key: data.attrs.get(key) for key in expected} == expected
    assert not {"right.restitution", "left.restitution"} & data.attrs.keys()
    assert data.x.attrs["units"] and data.v.attrs["units"]
    x, v = forced(np.array([0.5, 1.0, 3.0]), 2.1, 0.05)
    assert abs(data.x.values - x[:, None]).max() < 1e-10 and abs(data.v.values - v[:, None]).max() < 1e-10
    values, done = [2.0, 3.0, 2.5], []
    start, counts = jv.State(x=0.3, v=2.0), {"settle": 2, "keep": 3}
    single = jv.sweep(scene(), "amplitude", values, start, **counts, chunk=2, progress=done.append)
    assert single.x.dims == ("amplitude", "period") and done == [2, 3]
    assert list(single.amplitude) == values and list(single.period) == [0, 1, 2]
    legs = np.array([[2.0, 3.0], [3.0, 2.0]])
    both = jv.sweep(scene(), "amplitude", legs, start, **counts)
    assert both.x.dims == ("step", "lane", "period") and both.amplitude.dims == ("step", "lane")
    assert (both.amplitude.values == legs).all() and (both.x[:, 0].values == single.x[:2].values).all()


def test_a_lane_with_a_bad_status_restarts_and_no_other_lane_depends_on_it():
    """1.0 bounces for ever between close walls: at most 1,000 impacts a period. At 0.5 it comes to rest."""
    narrow = scene(amplitude=0.0, damping=0.0, walls=(-0.01, 0.01))
    starts, values, few = jv.State(x=0.0, v=np.array([10.0, 0.02])), [1.0, 0.5, 1.0, 1.0], {"settle": 2, "keep": 3}
    data = jv.sweep(narrow, "restitution", values, starts, **few)
    assert data.status.values.tolist() == [[CAP, 0], [0, 0], [0, 0], [0, 0]]
    assert np.isnan(data.x[0, 0]).all() and np.isfinite(data.x[1:]).all() and np.isfinite(data.x[:, 1]).all()
    calm = jv.sweep(narrow, "restitution", values, jv.State(0.0, np.array([0.01, 0.02])), **few)
    assert (calm.x[:, 1].values == data.x[:, 1].values).all() and (calm.status == 0).all()
    fresh = jv.sweep(narrow, "restitution", values[1:], starts, **few)
    assert (fresh.x[:, 0].values == data.x[1:, 0].values).all()


def test_a_wall_that_moves_over_the_mass_carries_it_along():
    """A mass at rest with no drive: the wall pushes it from -0.2 to 0.4, and it rests there, pressed on."""
    still = scene(amplitude=0.0, frequency=1.0, damping=0.5, restitution=0.0)
    values = np.array([-0.2, 0.2, 0.4, -0.5])
    data = jv.sweep(still, "left.position", values, jv.State(x=0.5, v=0.0), settle=20, keep=1)
    assert (data.status == 0).all()
    assert abs(data.x[:, 0] - [0.0, 0.2, 0.4, 0.0]).max() < 1e-12 and abs(data.v).max() < 1e-12


def test_states_are_adapted_to_moving_walls():
    moving = scene(walls=(-1.0, jv.Wall(1.0, motion=jv.Motion(0.25, phase=0.5, harmonic=2))))
    (low, _), (high, velocity) = wall_states(moving, 1.3)
    assert low == -1.0 and abs(high - (1.0 + 0.25 * np.cos(3.1))) < 1e-15
    assert abs(velocity + 0.25 * 2 * 2.1 * np.sin(3.1)) < 1e-15
    x, v = (jnp.array(a) for a in ([2.0, 0.3, 0.2, 0.2, -1.0], [3.0, 3.0, 3.0, 3.0, 1.0]))
    kept = adapt_to_moved_walls(moving, jv.State(x, v, 1.3, jnp.array([0.0, 0.0, 2.0, 1.0, -1.0])))
    assert np.allclose(kept.x, [high, 0.3, high, high, -1.0], rtol=0, atol=0)
    assert np.allclose(kept.v, [3.0, 3.0, velocity, 3.0, 1.0], rtol=0, atol=0)
    assert list(kept.contact) == [0.0, 0.0, 2.0, 0.0, -1.0]


def stretches(folder, scene, ends, count, settle, keep):
    """Return the table of a run of a scene file, and (motion, periods) of its stretches."""
    low, high = ends
    leg = f'{{name = "up", from = {low}, to = {high}, start = {{x = 0.5, v = 0.1}}}}'
    jv.save_scene(scene, folder / "sweep.toml", force=True)
    with (folder / "sweep.toml").open("a") as file:
        print(f"[sweep]\ncount = {count}\nsettle = {settle}\nkeep = {keep}\nlegs = [{leg}]", file=file)
        print('parameter = "amplitude"', file=file)
    done = jv.run(folder / "sweep.toml", folder / "out", force=True)
    return done.table, [(row["motion"], row["periods"], row["count"]) for row in done.summary["stretches"]]


def test_chaos_and_transients_of_a_sweep_are_distinguished(tmp_path):
    """Between walls at 1 the motion is chaotic at 6. A linear response that decays like exp(-.015 t) has not settled
    after 100 periods, and has after 400; after 10, too few periods are discarded to decide."""
    table, rows = stretches(tmp_path, scene(amplitude=6.0), (2.0, 6.0), 3, 300, 40)
    assert rows[0][:2] == ("periodic", 1) and rows[-1] == ("chaotic", 0, 1)
    assert "chaotic: the largest Lyapunov exponent is positive" in table
    linear = scene(amplitude=0.2, frequency=1.3, damping=0.015)
    for settle, expected in ((10, ("not settled", 0, 2)), (100, ("not settled", 0, 2)), (400, ("periodic", 1, 2))):
        table, rows = stretches(tmp_path, linear, (0.2, 0.25), 2, settle, 20)
        assert rows == [expected]
        assert ("not settled: a transient: more periods must be discarded" in table) == (settle < 400)
    assert ["up", "0.2", "0.25", "2", "1"] in [line.split() for line in table.splitlines()]
