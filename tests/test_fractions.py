"""Attractors along a parameter: shares against other starts, names against known branches, files, bad input."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.attractors.basin_fraction_bounds import compute_share_bounds
from jaxvibro.attractors.basin_labels import build_neighbourhoods, label_starts_in_parallel
from jaxvibro.maps.initial_conditions import draw_initial_states
from jaxvibro.output.checksums import netcdf_bytes
from jaxvibro.surveys.attractor_matching import match_attractors, median_set_distance, nearest_rotation
from jaxvibro.surveys.attractor_transport import ParameterNode, assign_or_add_attractors, transport_attractors
from tests.pictures import tube

STARTS, MANY = 40, 400
VALUES = [4.5, 4.7, 4.9]  # two P111 all along; P121 and its image come at 4.53 and double at 4.8
PAIRS = {("P111", "P111", "P111"): 2, ("", "P112", "P224"): 1, ("", "P121", "P242"): 1}
SHORT = {"starts": 1, "settle": 100}


def plain(**changes):
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)).replace(**changes)


@pytest.fixture(scope="module")
def progress():
    return []


@pytest.fixture(scope="module")
def found(progress):
    return jv.fractions(tube(), "amplitude", VALUES, STARTS, progress=progress.append)


def rows(data):
    """{labels along the parameter: how many attractors have these}."""
    told = [tuple(row) for row in data["label"].values.T.tolist()]
    return {row: told.count(row) for row in told}


def test_each_attractor_has_one_name_along_the_parameter(found, progress):
    assert rows(found) == PAIRS and progress == [1, 2, 3]
    total = found["share"].sum("attractor") + found["unresolved"]
    assert abs(total - 1.0).max() < 1e-12
    there = found["label"] != ""
    assert (np.isfinite(found["share"]) == there).all() and ((found["kind"] == "periodic") == there).all()
    assert (
        found["periods"].where(there, 0)
        == np.array([int(one[1:2] or 0) for one in found["label"].values.flat]).reshape(3, -1)
    ).all()
    assert (found["exponent"].where(there, -1.0) < 0).all() and (found["status"] == 0).all()


def test_names_stay_on_the_branches_that_are_followed(found):
    for place in range(found.sizes["attractor"]):
        entry = found.isel(attractor=place)
        if (entry["label"] != "P111").any():
            continue
        state = jv.State(float(entry["state_x"][0]), float(entry["state_v"][0]))
        orbit = jv.find_orbit(plain(amplitude=VALUES[0]), state, settle=0)
        branch = jv.follow(orbit, "amplitude", (VALUES[0], 4.91), "forward")
        for key in "xv":
            line = np.interp(VALUES, branch.values, branch.data[key].values[:, 0])
            assert abs(line - entry[f"state_{key}"].values).max() < 2e-3


def test_shares_are_those_of_other_starts(found):
    scene = plain(amplitude=VALUES[1])
    known = jv.find_attractors(scene, 40, seed=5)
    given = draw_initial_states(scene, MANY, 77)
    label, _ = label_starts_in_parallel(scene, given.x, given.v, 0.0, build_neighbourhoods(scene, known, 0.0, 6.0), 400)
    assert (label >= 0).all() and len(known) == 4
    here = found.isel(amplitude=1)
    for place, one in enumerate(known):
        apart = np.hypot(here["state_x"] - one.state.x, here["state_v"] - one.state.v).values
        entry = here.isel(attractor=int(np.nanargmin(apart)))
        assert np.nanmin(apart) < 1e-6 and entry["label"] == one.label
        share = (label == place).mean()
        assert abs(entry["share"] - share) < 3.5 * np.sqrt(share * (1.0 - share) * (1.0 / STARTS + 1.0 / MANY))
    counts = np.round(here["share"].values * STARTS).astype(int)
    bounds = [compute_share_bounds(int(count), STARTS) for count in counts]
    assert (np.stack([here["share_low"], here["share_high"]], -1) == bounds).all()


def test_mirror_images_know_each_other(found):
    mirror = found["mirror_of"].values
    for row, labels, rates in zip(mirror, found["label"].values, found["exponent"].values, strict=True):
        for place in np.flatnonzero(labels):
            assert row[row[place]] == place != row[place]
            n, left, right = labels[place][1:]
            assert labels[row[place]] == f"P{n}{right}{left}"
            assert rates[row[place]] == pytest.approx(rates[place], abs=1e-6)
        assert (row[labels == ""] == -1).all()


def test_starts_are_those_of_the_value_alone(found):
    near = jv.fractions(tube(), "amplitude", [VALUES[0], VALUES[0] + 1e-6], STARTS)
    first, second = np.sort(near["share"].values, axis=1)
    assert (first == np.sort(found["share"].values[0, :2])).all() and (first != second).all()


def test_files_hold_every_bit(found, tmp_path):
    path = tmp_path / "found.nc"
    path.write_bytes(netcdf_bytes(found))
    loaded = jv.load_data(path)
    found.to_netcdf(tmp_path / "plain.nc", engine="scipy")
    for other in (loaded.drop_attrs(deep=False), xr.load_dataset(tmp_path / "plain.nc").drop_attrs(deep=False)):
        assert other.identical(found.drop_attrs(deep=False))
        for key, one in found.variables.items():
            assert one.dtype.kind == "U" or (
                one.dtype == other[key].dtype and one.values.tobytes() == other[key].values.tobytes()
            )
    for key, told in found.attrs.items():
        assert np.array_equal(loaded.attrs[key], told)
    physical = jv.to_physical(loaded)
    assert physical["state_x"].attrs["units"] == "mm" and physical["amplitude"].attrs["units"] == "N"
    assert physical["amplitude"].values == pytest.approx(15.0 * np.array(VALUES))
    assert (physical["label"] == found["label"]).all()


def test_an_attractor_that_no_start_found_is_carried_on():
    """P100 keeps off the walls up to sqrt(D) = 3.4165, where hardly any start comes to it."""
    data = jv.fractions(plain(), "amplitude", [2.0, 3.2, 3.4, 3.45], 5)
    assert rows(data)["P100", "P100", "P100", ""] == 1
    place = int(np.flatnonzero(data["label"].values[0] == "P100")[0])
    assert data["share"].values[2, place] == 0.0 == data["share_low"].values[2, place]
    assert data["share_high"].values[2, place] == pytest.approx(1.0 - 0.05**0.2)
    assert data["state_x"].values[:3, place] == pytest.approx(
        np.array([2.0, 3.2, 3.4]) * (1 - 2.1**2) / 3.4165**2, rel=1e-4
    )


def test_one_that_a_start_found_at_the_first_value_alone_is_carried_to_the_last():
    stations = [ParameterNode(value, plain(amplitude=value), [], 0, 6.0, 0) for value in VALUES]
    homes = assign_or_add_attractors(stations[0], jv.State(*(np.full(2, each) for each in (0.9, -1.1, 0.0, 0.0))), 300)
    assert homes.tolist() == [0, 0]
    transport_attractors(stations, "amplitude", 300)
    for station in stations:  # with its mirror image
        assert [(one.attractor_fields["label"], one.lanes) for one in station.candidates] == [("P111", [])] * 2
    names = match_attractors(stations, "amplitude", 300)
    assert [list(one) for one in names] == [[0, 1, 2]] * 2
    for station in stations:  # as where all settle too slowly: by where they are
        station.transports = {
            way: {place: one._replace(attractor_index=None) for place, one in ways.items()}
            for way, ways in station.transports.items()
        }
    assert match_attractors(stations, "amplitude", 300) == names
    for station in stations:  # as where all lead to the first
        station.transports = {
            way: {place: one._replace(attractor_index=0) for place, one in ways.items()}
            for way, ways in station.transports.items()
        }
    assert [list(one) for one in match_attractors(stations, "amplitude", 300)] == [[0, 1, 2], [0], [1], [2]]


def test_two_that_lead_to_each_other_but_are_there_side_by_side_are_two():
    """From P100 at 0.2 the mass comes to P111 at 3.6, and back: between, from the fold of P111 to 3.4165, both are."""
    data = jv.fractions(plain(), "amplitude", [0.2, 3.45], **SHORT)
    assert sorted(rows(data)) == [("", "P111"), ("P100", "")]


def test_a_symmetric_motion_goes_on_as_the_first_of_its_two_images():
    data = jv.fractions(plain(), "amplitude", [3.45, 3.7], **SHORT)
    assert data["mirror_of"].values.tolist() == [[0, -1], [1, 0]]
    assert rows(data) == {("P111", "P111"): 1, ("", "P111"): 1}
    assert data["state_x"].values[1, 0] < data["state_x"].values[1, 1]


def test_where_nothing_is_known_a_place_stands_empty(tmp_path):
    data = jv.fractions(plain(damping=0.0, restitution=1.0), "amplitude", [2.0, 2.1], 3, settle=64)
    assert data.sizes["attractor"] == 1 and (data["label"] == "").all() and (data["unresolved"] == 1.0).all()
    data.to_netcdf(tmp_path / "none.nc", engine="scipy")
    assert xr.load_dataset(tmp_path / "none.nc")["share"].isnull().all()
    plot.fractions(data, Figure().subplots())


def test_distances_and_turns():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    assert (nearest_rotation(points, np.roll(points, 1, axis=0) + 0.1) == np.roll(points, 1, axis=0)).all()
    assert median_set_distance(points, points + np.array([0.0, 0.25])) == 0.25


BAD = [
    ("amplitud", [1.0, 2.0], {}, "amplitude"),
    (3, [1.0, 2.0], {}, "^name: must be a string"),
    ("amplitude", [2.0, 1.0], {}, "increasing order"),
    ("amplitude", [1.0, 1.0], {}, "increasing order"),
    ("amplitude", [], {}, "increasing order"),
    ("amplitude", 1.0, {}, "^values: must be a sequence of real numbers"),
    ("amplitude", [1.0, np.nan], {}, "finite"),
    ("restitution", [0.5, 1.5], {}, "restitution"),
    ("amplitude", [1.0, 2.0], {"starts": 0}, "starts"),
    ("amplitude", [1.0, 2.0], {"seed": -1}, "seed"),
    ("amplitude", [1.0, 2.0], {"settle": 1.5}, "settle"),
]


@pytest.mark.parametrize("name,values,more,told", BAD)
def test_what_cannot_be_is_told_at_once(name, values, more, told):
    with pytest.raises(jv.ArgumentError, match=told):
        jv.fractions(plain(), name, values, **more)


def test_a_batch_is_refused():
    with pytest.raises(jv.ArgumentError, match="single"):
        jv.fractions(plain(damping=np.array([0.1, 0.2])), "amplitude", [1.0, 2.0])


def test_a_picture_has_a_band_for_each_attractor(found):
    ax = plot.fractions(found, Figure().subplots())
    bands = [one for one in ax.patches if one.get_gid() == "attractor"]
    assert len(bands) == 4 and len({one.get_facecolor() for one in bands}) == 4
    top = np.zeros(len(VALUES))
    for band in bands:
        values, edges, base = band.get_data()
        assert np.allclose(base, top)
        top = values
    assert np.allclose(top + found["unresolved"].values, 1.0)
    assert edges == pytest.approx([4.4, 4.6, 4.8, 5.0])
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told[:2] == ["P111", "P111 (mirror image)"] and sorted(told[2:]) == ["P112, P224", "P121, P242"]


def test_a_picture_in_physical_units(found):
    ax = plot.fractions(found, Figure().subplots(), legend=False, bounds=False, units="physical")
    assert "(N)" in ax.get_xlabel() and ax.get_legend() is None
    assert ax.get_xlim() == pytest.approx((15.0 * 4.4, 15.0 * 5.0))
    for wrong in (found.drop_vars("share"), 3):
        with pytest.raises(jv.ArgumentError, match="Dataset of fractions"):
            plot.fractions(wrong)


def test_the_least_shock_along_a_parameter():
    scene, values = jv.make_scene(4.65, 2.1, 0.05, 0.7, (jv.Wall(-1.0), jv.Wall(1.0))), [0.3, 4.65]
    found = jv.fractions(scene, "amplitude", values, 60, shocks=1 << 12)
    assert found.attrs["shocks"] == 1 << 12 and found["least_shock"].attrs["units"] == "length w0"
    there = found["label"].values != ""
    assert np.isnan(found["least_shock"].values[~there]).all()
    assert np.isinf(found["least_shock"].values[0][there[0]]).all()  # P100 alone
    here = scene.replace(amplitude=4.65)
    known = jv.find_attractors(here, 60)
    for place, x in enumerate(found["state_x"].values[1]):
        if there[1, place]:
            own = next(k for k, one in enumerate(known) if abs(one.points[:, 0] - x).min() < 1e-6)
            size = jv.least_shock(here, known, own, shocks=1 << 14).size
            assert abs(found["least_shock"].values[1, place] / size - 1.0) < 1e-3
