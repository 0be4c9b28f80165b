"""Basin fractions along a parameter, and smallest shocks: known branches, a separatrix in NumPy, files, pictures."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.surveys import fractions
from jaxvibro.surveys.attractor_matching import median_set_distance, nearest_rotation
from tests.pictures import tube

from .reference.soft_lanes import Lanes, Wall

STARTS, VALUES = 40, [4.5, 4.7, 4.9]  # two P111 all along; P121 and its image come at 4.53 and double at 4.8
SHORT = {"starts": 1, "settle": 100}
UNEVEN = {"amplitude": 2.4, "frequency": 2.1, "damping": 0.05}
WALLS = Wall(-1, -1.1, 0.7), Wall(1, 0.9, 0.7)
FEW = 4096


def plain(**changes):
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)).replace(**changes)


@pytest.fixture(scope="module")
def progress():
    return []


@pytest.fixture(scope="module")
def data(progress):
    return jv.fractions(tube(), "amplitude", VALUES, STARTS, progress=progress.append)


def rows(data):
    """Return {labels along the parameter: how many attractors have these}."""
    labels = [tuple(row) for row in data["label"].values.T.tolist()]
    return {row: labels.count(row) for row in labels}


def test_each_attractor_has_one_name_along_the_parameter(data, progress):
    assert rows(data) == {("P111", "P111", "P111"): 2, ("", "P112", "P224"): 1, ("", "P121", "P242"): 1}
    assert progress == [1, 2, 3] and (data["status"] == 0).all()
    exists = data["label"].values != ""
    assert ((data["kind"] == "periodic").values == exists).all()
    assert data["periods"].values[exists].tolist() == [int(label[1]) for label in data["label"].values[exists]]
    assert (data["exponent"].values[exists] < 0).all()
    for row, labels, rates in zip(data["mirror_of"].values, data["label"].values, data["exponent"].values, strict=True):
        for place in np.flatnonzero(labels):
            assert row[row[place]] == place != row[place]
            n, left, right = labels[place][1:]
            assert labels[row[place]] == f"P{n}{right}{left}"
            assert rates[row[place]] == pytest.approx(rates[place], abs=1e-6)
        assert (row[labels == ""] == -1).all()


def test_files_hold_every_bit_and_physical_units_scale_it(data, tmp_path):
    data.to_netcdf(tmp_path / "plain.nc", engine="scipy")
    loaded = xr.load_dataset(tmp_path / "plain.nc")
    xr.testing.assert_identical(loaded.drop_attrs(), data.drop_attrs())
    assert all(np.array_equal(loaded.attrs[key], value) for key, value in data.attrs.items())
    physical = jv.to_physical(loaded)
    assert physical["state_x"].attrs["units"] == "mm" and physical["amplitude"].attrs["units"] == "N"
    assert physical["amplitude"].values == pytest.approx(15.0 * np.array(VALUES))
    assert (physical["label"] == data["label"]).all()


def test_an_attractor_that_no_start_approaches_is_carried_on():
    """P100 keeps off the walls up to sqrt(D) = 3.4165, where hardly any start comes to it."""
    data = jv.fractions(plain(), "amplitude", [2.0, 3.2, 3.4, 3.45], 5)
    assert rows(data)["P100", "P100", "P100", ""] == 1
    place = int(np.flatnonzero(data["label"].values[0] == "P100")[0])
    assert data["share"].values[2, place] == 0.0 == data["share_low"].values[2, place]
    assert data["share_high"].values[2, place] == pytest.approx(1.0 - 0.05**0.2)
    expected = np.array([2.0, 3.2, 3.4]) * (1 - 2.1**2) / 3.4165**2
    assert data["state_x"].values[:3, place] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("index", "counts"), [(None, [3, 3]), (0, [1, 1, 1, 3])])
def test_matching_of_attractors_whose_transport_decides_nothing(monkeypatch, index, counts):
    """None: all motions settle too slowly, so that the nearest attractor is the next; 0: all lead to the first one."""
    transport = fractions.transport_attractors

    def blind(nodes, *settings):
        transport(nodes, *settings)
        for node in nodes:
            node.transports = {
                way: {place: moved._replace(attractor_index=index) for place, moved in ways.items()}
                for way, ways in node.transports.items()
            }

    monkeypatch.setattr(fractions, "transport_attractors", blind)
    data = jv.fractions(tube(), "amplitude", [4.4, 4.45, 4.5], 4)
    assert sorted((data["label"] == "P111").sum("amplitude").values.tolist()) == counts


def test_two_attractors_that_lead_to_each_other_but_coexist_are_two():
    """From P100 at 0.2 the mass comes to P111 at 3.6, and back: between, from the fold of P111 to 3.4165, both are."""
    assert sorted(rows(jv.fractions(plain(), "amplitude", [0.2, 3.45], **SHORT))) == [("", "P111"), ("P100", "")]
    data = jv.fractions(plain(), "amplitude", [3.45, 3.7], **SHORT)  # the symmetric one goes on as the first image
    assert data["mirror_of"].values.tolist() == [[0, -1], [1, 0]]
    assert rows(data) == {("P111", "P111"): 1, ("", "P111"): 1}
    assert data["state_x"].values[1, 0] < data["state_x"].values[1, 1]


def test_without_attractors_all_starts_are_unresolved(tmp_path):
    data = jv.fractions(plain(damping=0.0, restitution=1.0), "amplitude", [2.0, 2.1], 3, settle=64)
    assert data.sizes["attractor"] == 1 and (data["label"] == "").all() and (data["unresolved"] == 1.0).all()
    data.to_netcdf(tmp_path / "none.nc", engine="scipy")
    assert xr.load_dataset(tmp_path / "none.nc")["share"].isnull().all()
    jv.plot.fractions(data, Figure().subplots())


def test_distances_and_rotations_of_point_sets():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    assert (nearest_rotation(points, np.roll(points, 1, axis=0) + 0.1) == np.roll(points, 1, axis=0)).all()
    assert median_set_distance(points, points + np.array([0.0, 0.25])) == 0.25


def test_a_picture_has_a_band_for_each_attractor(data):
    ax = jv.plot.fractions(data, Figure().subplots())
    bands = [patch for patch in ax.patches if patch.get_gid() == "attractor"]
    assert len(bands) == 4 and len({patch.get_facecolor() for patch in bands}) == 4
    top = np.zeros(len(VALUES))
    for band in bands:
        values, edges, base = band.get_data()
        assert np.allclose(base, top)
        top = values
    assert np.allclose(top + data["unresolved"].values, 1.0)
    assert edges == pytest.approx([4.4, 4.6, 4.8, 5.0])
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts[:2] == ["P111", "P111 (mirror image)"] and sorted(texts[2:]) == ["P112, P224", "P121, P242"]
    ax = jv.plot.fractions(data, Figure().subplots(), legend=False, bounds=False, units="physical")
    assert "(N)" in ax.get_xlabel() and ax.get_legend() is None
    assert ax.get_xlim() == pytest.approx((15.0 * 4.4, 15.0 * 5.0))
    for wrong in (data.drop_vars("share"), 3):
        with pytest.raises(jv.ArgumentError, match="Dataset of fractions"):
            jv.plot.fractions(wrong)


def test_the_least_shock_along_a_parameter():
    data = jv.fractions(plain(), "amplitude", [0.3, 4.65], 60, shocks=1 << 12)
    assert data.attrs["shocks"] == 1 << 12 and data["least_shock"].attrs["units"] == "length w0"
    exists, sizes = data["label"].values != "", data["least_shock"].values
    assert np.isnan(sizes[~exists]).all() and np.isinf(sizes[0][exists[0]]).all()  # at 0.3 P100 alone
    scene, attractors = known("figure 5")
    for place in np.flatnonzero(exists[1]):
        apart = [abs(one.points[:, 0] - data["state_x"].values[1, place]).min() for one in attractors]
        size = jv.least_shock(scene, attractors, int(np.argmin(apart)), shocks=1 << 12).size
        assert min(apart) < 1e-6 and abs(sizes[1, place] / size - 1.0) < 1e-3


@cache
def known(name):
    scene = plain()
    if name == "uneven":
        scene = jv.make_scene(**UNEVEN, restitution=0.7, walls=tuple(wall.position for wall in WALLS))
    return scene, jv.find_attractors(scene, starts=60)


def free_response():
    """Return x and v at phase 0 of the motion that meets no wall, by its closed form."""
    w = UNEVEN["frequency"]
    turn = UNEVEN["amplitude"] / (1.0 - w * w + 2j * UNEVEN["damping"] * w)
    return np.array([turn.real, (1j * w * turn).real])


def returns(change, periods=40):
    """Return whether the free response comes back to itself after shocks (dx, dv), a row each: flights in NumPy."""
    lanes = Lanes(*UNEVEN.values(), WALLS, *(free_response() + change).T)
    for _ in range(periods):
        lanes.period()
    apart = np.hypot(*(np.stack([lanes.x, lanes.v], -1) - free_response()).T)
    assert ((apart < 0.05) | (apart > 0.3)).all()
    return apart < 0.05


@pytest.mark.parametrize("direction", ["v", "xv"])
def test_the_least_shock_of_the_free_response_by_flights_in_numpy(direction):
    scene, attractors = known("uneven")
    place = next(k for k, one in enumerate(attractors) if one.label == "P100")
    shock = jv.least_shock(scene, attractors, place, direction=direction, shocks=FEW)
    np.testing.assert_allclose([shock.state.x, shock.state.v], free_response(), rtol=1e-12)
    change = np.array([shock.dx, shock.dv])
    assert np.hypot(*change) == pytest.approx(shock.size, rel=1e-15) and (direction == "xv" or not shock.dx)
    x, v = free_response()
    fastest = 3.0 * max(1.0, np.hypot(UNEVEN["frequency"] * x, v))  # of the box of initial states, between the walls
    farthest = max(x - WALLS[0].position, WALLS[1].position - x), fastest + abs(v)
    assert shock.reach == pytest.approx(np.hypot(*farthest) if direction == "xv" else farthest[1], rel=1e-12)
    assert returns(change * np.array([[1.0 - 1e-7], [1.0 + 1e-7], [1.01]])).tolist() == [True, False, False]
    assert (1.0 - 1e-7) * shock.size < shock.bracket[0] < shock.size < shock.until
    if direction == "v":  # a strip of its own basin, 1e-5 above: by both methods
        assert shock.until < 1.0001 * shock.size and returns(1.0000107 * change[None]).all()
    share, turn = np.sqrt(np.arange(1, 100) / 100.0), 2.4 * np.arange(1, 100)
    way = np.stack([np.cos(turn), np.sin(turn)], -1) if direction == "xv" else np.outer(np.sign(np.cos(turn)), [0, 1])
    assert returns(shock.size * (1.0 - 1e-7) * share[:, None] * way).all()


def test_the_least_of_several_phases_is_the_result_and_each_is_reported():
    scene, attractors = known("figure 5")
    counts, phases = [], np.linspace(0.0, 2.0 * np.pi, 7)
    shock = jv.least_shock(scene, attractors, 0, phases, shocks=FEW, progress=counts.append)
    sizes = shock.by_phase["size"].values
    assert sizes[0] == pytest.approx(sizes[-1], rel=1e-6)
    assert shock.size == sizes.min() and shock.phase == phases[sizes.argmin()]
    assert counts == sorted(counts) and counts[-1] >= shock.below
    mirrored = jv.least_shock(scene, attractors, attractors[0].mirror_of, shock.phase + np.pi, shocks=FEW)
    assert mirrored.size == pytest.approx(shock.size, rel=1e-6)
    assert mirrored.dv == pytest.approx(-shock.dv, rel=1e-6) and mirrored.to == attractors[shock.to].mirror_of
    assert len(shock.table().splitlines()) == 1 + len(phases) + 2 and f"{shock.size:.7g}" in shock.table()


def test_all_of_the_sample_of_a_chaotic_attractor_is_perturbed():
    scene = plain(amplitude=5.24)
    attractors = jv.find_attractors(scene, starts=100)
    place = next(k for k, one in enumerate(attractors) if one.kind == "chaotic")
    shock = jv.least_shock(scene, attractors, place, direction="xv", shocks=1 << 15)
    assert attractors[shock.to].kind == "periodic" and shock.safe == 0.0
    end, _ = jv.strobe(scene, jv.State(shock.state.x + shock.dx, shock.state.v + shock.dv), 1000, 0)
    assert abs(attractors[shock.to].points - np.array([end.x, end.v])).max(axis=-1).min() < 1e-8


def test_the_size_is_infinite_where_no_other_attractor_is_reached():
    scene, attractors = known("figure 5")
    shock = jv.least_shock(scene, attractors, 0, reach=0.3, shocks=FEW)
    assert (shock.size, shock.to, shock.reach) == (np.inf, -1, 0.3) and np.isnan(shock.dv)
    assert "none found" in shock.table() and shock.below >= FEW
    alone = jv.least_shock(scene, attractors[:1], 0, shocks=FEW, patience=40)
    assert alone.size == np.inf and alone.undecided > 0 and 0.6 < alone.least_undecided < 0.7


def test_single_precision_finds_the_least_shock_as_well():
    single = jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0), dtype=jnp.float32)
    size = jv.least_shock(single, jv.find_attractors(single, starts=60), 0, shocks=FEW).size
    assert size == pytest.approx(jv.least_shock(*known("figure 5"), 0, shocks=FEW).size, rel=1e-3)


def test_a_phase_at_which_the_attractor_meets_a_wall_is_refused():
    scene, attractors = known("figure 5")
    phase = scene.frequency * attractors[0].orbit.impacts.time[0]
    with pytest.raises(jv.ArgumentError, match="choose another phase"):
        jv.least_shock(scene, attractors, 0, float(phase), shocks=FEW)
