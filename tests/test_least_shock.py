"""The least shock: against a separatrix by SciPy, flights in NumPy, grids of basins; and what cannot be."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxvibro as jv

from .reference.soft_lanes import Lanes, Wall

FIG5 = {"amplitude": 4.65, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
UNEVEN = {"amplitude": 2.4, "frequency": 2.1, "damping": 0.05}
WALLS = Wall(-1, -1.1, 0.7), Wall(1, 0.9, 0.7)
FEW = 4096
OTHERS = [pytest.param(*each, marks=pytest.mark.long) for each in (("v", 1.0), ("xv", 2.0))]


@cache
def known(name):
    if name == "figure 5":
        scene = jv.make_scene(**FIG5)
    else:
        scene = jv.make_scene(**UNEVEN, restitution=0.7, walls=tuple(each.position for each in WALLS))
    return scene, jv.find_attractors(scene, starts=60)


def free_response():
    """x and v at phase 0 of the motion that meets no wall, by its closed form."""
    w = UNEVEN["frequency"]
    turn = UNEVEN["amplitude"] / (1.0 - w * w + 2j * UNEVEN["damping"] * w)
    return np.array([turn.real, (1j * w * turn).real])


def stays(change, periods=40):
    """Whether the free response struck so, (dx, dv) a row, comes back to itself: flights in NumPy."""
    lanes = Lanes(*UNEVEN.values(), WALLS, *(free_response() + change).T)
    for _ in range(periods):
        lanes.period()
    apart = np.hypot(*(np.stack([lanes.x, lanes.v], -1) - free_response()).T)
    assert ((apart < 0.05) | (apart > 0.3)).all()
    return apart < 0.05


@pytest.mark.parametrize("direction", ["v", "xv"])
def test_the_free_response_leaves_at_that_size_and_at_none_smaller_in_flights_by_numpy(direction):
    scene, attractors = known("uneven")
    place = next(k for k, one in enumerate(attractors) if one.label == "P100")
    found = jv.least_shock(scene, attractors, place, direction=direction, shocks=FEW)
    np.testing.assert_allclose([found.state.x, found.state.v], free_response(), rtol=1e-12)
    change = np.array([found.dx, found.dv])
    assert np.hypot(*change) == pytest.approx(found.size, rel=1e-15) and (direction == "xv" or not found.dx)
    assert stays(change * np.array([[1.0 - 1e-7], [1.0 + 1e-7], [1.01]])).tolist() == [True, False, False]
    assert (1.0 - 1e-7) * found.size < found.bracket[0] < found.size < found.until
    if direction == "v":  # a strip of its own basin, 1e-5 above: by both routes
        assert found.until < 1.0001 * found.size and stays(1.0000107 * change[None]).all()
    share, turn = np.sqrt(np.arange(1, 100) / 100.0), 2.4 * np.arange(1, 100)
    way = np.stack([np.cos(turn), np.sin(turn)], -1) if direction == "xv" else np.outer(np.sign(np.cos(turn)), [0, 1])
    assert stays(found.size * (1.0 - 1e-7) * share[:, None] * way).all()


def well(t, x, v, p):
    """A double well: rests at -1 and 1."""
    return x - x**3 - 2.0 * p["damping"] * v


def test_out_of_a_well_the_least_shock_just_comes_to_the_separatrix_by_scipy():
    damping = 0.1
    scene = jv.make_scene(0.0, 1.0, restitution=0.7, walls=(-3.0, 3.0), force=jv.Force(well, {"damping": damping}))
    attractors = jv.find_attractors(scene, starts=20)
    rate, small = -damping - np.sqrt(damping**2 + 1.0), 1e-6  # the stable direction of the saddle at 0

    def backwards(_, z):
        return [-z[1], -(z[0] - z[0] ** 3 - 2.0 * damping * z[1])]

    def at_one(_, z):
        return z[0] - 1.0

    curve = solve_ivp(
        backwards,
        (0.0, 30.0),
        [small, rate * small],
        "DOP853",
        rtol=1e-12,
        atol=1e-14,
        events=at_one,
        dense_output=True,
    )
    speeds = abs(curve.y_events[0][:, 1])
    place = int(np.argmax([one.points[0, 0] for one in attractors]))
    found = jv.least_shock(scene, attractors, place, shocks=FEW)
    assert found.size == pytest.approx(speeds.min(), rel=1e-7)
    times = np.linspace(0.0, 30.0, 300_000)
    nearest = np.hypot(curve.sol(times)[0] - 1.0, curve.sol(times)[1]).min()
    both = jv.least_shock(scene, attractors, place, direction="xv", shocks=FEW)
    assert both.size == pytest.approx(nearest, rel=1e-6) and both.size < found.size
    assert found.safe < found.bracket[0] < found.size and found.bracket[0] > (1.0 - 1e-7) * found.size


@pytest.mark.slow
@pytest.mark.parametrize(("direction", "phase"), [("xv", 0.0), *OTHERS])
def test_no_start_of_a_grid_nearer_than_it_is_in_another_basin(direction, phase):
    scene, attractors = known("figure 5")
    for place in (0, 2):
        found = jv.least_shock(scene, attractors, place, phase, direction)
        shares = np.linspace(-1.0, 1.0, 401)
        for share, fewest in ((1.0, 0), (1.01, 1)):
            size = share * found.size
            x = found.state.x + (size * shares if direction == "xv" else np.array([0.0, 1e-9]))
            data = jv.basins(scene, x, found.state.v + size * shares, phase, attractors)
            size_of = np.hypot(*np.meshgrid(x - found.state.x, data["v"].values - found.state.v))
            label = data["label"].values[size_of < size * (1.0 - 1e-7)]
            assert (np.sum((label >= 0) & (label != place)) >= 1) == fewest
            assert (label != -1).all()


def test_the_least_of_several_phases_is_the_answer_and_each_is_told():
    scene, attractors = known("figure 5")
    counts = []
    phases = np.linspace(0.0, 2.0 * np.pi, 7)
    found = jv.least_shock(scene, attractors, 0, phases, shocks=FEW, progress=counts.append)
    told = found.by_phase
    assert told["size"].values[0] == pytest.approx(told["size"].values[-1], rel=1e-6)
    assert found.size == told["size"].values.min() and found.phase == phases[told["size"].values.argmin()]
    assert counts == sorted(counts) and counts[-1] >= found.below
    twin = attractors[0].mirror_of
    mirrored = jv.least_shock(scene, attractors, twin, found.phase + np.pi, shocks=FEW)
    assert mirrored.size == pytest.approx(found.size, rel=1e-6)
    assert mirrored.dv == pytest.approx(-found.dv, rel=1e-6) and mirrored.to == attractors[found.to].mirror_of
    lines = found.table().splitlines()
    assert len(lines) == 1 + len(phases) + 2 and f"{found.size:.7g}" in found.table()


def test_of_a_chaotic_attractor_all_of_its_sample_is_struck():
    scene = jv.make_scene(5.24, 2.1, 0.05, 0.7, (-1.0, 1.0))
    attractors = jv.find_attractors(scene, starts=100)
    place = next(k for k, one in enumerate(attractors) if one.kind == "chaotic")
    found = jv.least_shock(scene, attractors, place, direction="xv", shocks=1 << 15)
    assert attractors[found.to].kind == "periodic" and found.safe == 0.0
    end, _ = jv.strobe(scene, jv.State(found.state.x + found.dx, found.state.v + found.dv), 3000, 0)
    apart = abs(attractors[found.to].points - np.array([end.x, end.v])).max(axis=-1)
    assert apart.min() < 1e-8


def test_where_nothing_else_is_reached_the_size_is_infinite():
    scene, attractors = known("figure 5")
    found = jv.least_shock(scene, attractors, 0, reach=0.3, shocks=FEW)
    assert (found.size, found.to, found.reach) == (np.inf, -1, 0.3) and np.isnan(found.dv)
    assert "none found" in found.table() and found.below >= FEW
    alone = jv.least_shock(scene, attractors[:1], 0, shocks=FEW, patience=40)
    assert alone.size == np.inf and alone.undecided > 0 and 0.6 < alone.least_undecided < 0.7


def test_single_precision_finds_it_as_well():
    scene, attractors = known("figure 5")
    double = jv.least_shock(scene, attractors, 0, shocks=FEW)
    single = jv.make_scene(**FIG5, dtype=jnp.float32)
    found = jv.least_shock(single, jv.find_attractors(single, starts=60), 0, shocks=FEW)
    assert found.size == pytest.approx(double.size, rel=1e-3)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("place", {"place": 9}),
        ("place", {"place": -1}),
        ("phase", {"phase": [[0.0]]}),
        ("phase", {"phase": []}),
        ("phase", {"phase": np.nan}),
        ("direction", {"direction": "x"}),
        ("reach", {"reach": 0.0}),
        ("reach", {"reach": [1.0]}),
        ("shocks", {"shocks": 0}),
        ("patience", {"patience": 0}),
        ("seed", {"seed": -1}),
        ("scene", {"scene": jv.make_scene(np.array([1.0, 2.0]), 2.1, 0.05, 0.7, (-1.0, 1.0), dtype=jnp.float32)}),
    ],
)
def test_what_cannot_be_is_refused(key, given):
    scene, attractors = known("uneven")
    with pytest.raises(jv.ArgumentError) as caught:
        jv.least_shock(**{"scene": scene, "attractors": attractors} | given)
    assert caught.value.key == key


def test_a_phase_at_which_the_attractor_meets_a_wall_is_refused():
    scene, attractors = known("figure 5")
    phase = scene.frequency * attractors[0].orbit.impacts.time[0]
    with pytest.raises(jv.ArgumentError, match="choose another phase"):
        jv.least_shock(scene, attractors, 0, float(phase), shocks=FEW)
