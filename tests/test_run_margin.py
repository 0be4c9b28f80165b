"""The table [margin] of a scene file: what a run of it tells, writes and draws."""

from pathlib import Path

import numpy as np
import pytest

import jaxvibro as jv

SCENE = Path(__file__).parents[1] / "scenes" / "margin.toml"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return jv.run(SCENE, out), out


def test_what_is_told_is_what_margin_finds(done):
    ran, out = done
    orbit = jv.find_orbit(jv.load_scene(SCENE), jv.State(0.9, -1.1))
    near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.05, "right.position": 0.02})
    assert near.table() in ran.table
    told = ran.summary["margin"]
    assert [one["kind"] for one in told] == [one.kind for one in near.points]
    assert [one["distance"] for one in told] == [one.distance for one in near.points]
    data = jv.load_data(out / "margin.nc")
    assert data["free"].values.tolist() == list(near.free) and data["free_unit"].values.tolist() == [0.1, 0.05, 0.02]
    for k, one in enumerate(near.points):
        assert data["near_kind"].values[k] == one.kind and data["near_status"].values[k] == one.status
        assert data["near_change"].values[k].tolist() == [one.change[name] for name in near.free]
    assert np.linalg.norm(data["near_change"].values[0] / data["free_unit"].values) == pytest.approx(near.distance)
    assert {one.name for one in out.iterdir()} == {f"margin{end}" for end in (".png", ".nc", ".txt", ".margin.png")}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("margin.free={amplitude=-1.0}", r"^margin.free.amplitude: must be a positive number"),
        ("margin.free={size=1.0}", r"^margin.size: "),
        ("margin.bounds={damping=[0.0,1.0]}", r"^margin.bounds.damping: must belong to a free parameter"),
        (
            "margin.bounds={amplitude=[2.0,3.0]}",
            r"^margin.bounds.amplitude: must be \(low, high\) and contain the value of the scene, 1",
        ),
        ("margin.kinds=['HB']", r"^margin.kinds\[0\]: must be one of SN, PD, SB, GR"),
        ("margin.directions=3", r"^margin.directions: "),
        ("margin.start={x=2.0,v=0.0}", r"^margin.start.x: must lie between the walls"),
        ("margin.at={frequency=-1.0}", r"^margin.at.frequency: "),
    ],
)
def test_what_may_not_stand_there_is_one_clear_error(tmp_path, change, told):
    with pytest.raises(jv.SceneError, match=told):
        jv.run(SCENE, tmp_path, [change])
    assert not list(tmp_path.iterdir())
