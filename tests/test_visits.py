"""Sections of a motion: against orbits, the maps from impact to impact, and the strobe."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxvibro as jv

SCENE = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
MOVING = {"walls": (jv.Wall(-1.2, 0.6), jv.Wall(1.0, None, motion=jv.Motion(0.1, 0.5)))}


def test_an_orbit_leaves_one_point_on_each_section():
    scene = jv.make_scene(**SCENE)
    found = jv.sections(scene, jv.State(0.9, -1.1), periods=10)
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    assert found["x"].values == pytest.approx(np.full(10, orbit.state.x), abs=1e-9)
    assert found["v"].values == pytest.approx(np.full(10, orbit.state.v), abs=1e-9)
    for name, side in (("left", -1), ("right", 1)):
        here = np.asarray(orbit.impacts.side) == side
        late, speed = (np.asarray(each)[here] for each in (orbit.impacts.time, orbit.impacts.speed))
        assert found[f"{name}_phase"].values == pytest.approx(np.full(10, 2.1 * late), abs=1e-8)
        assert found[f"{name}_velocity"].values == pytest.approx(np.full(10, -0.7 * side * speed), abs=1e-8)


@pytest.mark.parametrize(
    "walls", [pytest.param({}, marks=pytest.mark.long), pytest.param(MOVING, marks=pytest.mark.long)]
)
def test_the_maps_lead_from_each_point_to_the_next(walls):
    scene = jv.make_scene(**SCENE | walls | {"amplitude": 5.4})
    found = jv.sections(scene, jv.State(0.5, -1.1), phase=2.0, periods=80, settle=50)
    end, _ = jv.strobe(scene, jv.State(found["x"].values[:-1], found["v"].values[:-1], 2.0))
    assert found["x"].values[1:] == pytest.approx(np.asarray(end.x), abs=1e-9)
    for name in ("left", "right"):
        phase, velocity = (found[f"{name}_{key}"].values for key in ("phase", "velocity"))
        assert len(phase) > 60
        after = jv.return_map(scene, name, phase[:-1], velocity[:-1], periods=4)
        assert np.asarray(after.found).all()
        turn = np.angle(np.exp(1j * (phase[1:] - np.asarray(after.phase))))
        assert abs(turn).max() < 1e-7
        assert velocity[1:] == pytest.approx(np.asarray(after.velocity), abs=1e-7)


def test_a_missing_wall_has_no_points():
    found = jv.sections(jv.make_scene(**SCENE | {"walls": (None, 1.0)}), jv.State(0.0, 0.0), periods=3)
    assert found.sizes["left_impact"] == 0 and found.sizes["period"] == 3


def test_pictures():
    found = jv.sections(jv.make_scene(**SCENE), jv.State(0.9, -1.1), periods=5)
    for which, line in (("sigma", found["x"]), ("left", found["left_phase"] / np.pi)):
        ax = jv.plot.section(found, which)
        assert ax.lines[0].get_xdata() == pytest.approx(line.values)
        assert ax.get_xlabel() and ax.get_ylabel()
    with pytest.raises(jv.ArgumentError, match="which"):
        jv.plot.section(found, "top")
    plt.close("all")


@pytest.mark.parametrize(
    ("key", "given"), [("periods", {"periods": 0}), ("settle", {"settle": -1}), ("phase", {"phase": np.nan})]
)
def test_bad_arguments_are_refused(key, given):
    with pytest.raises(jv.ArgumentError) as error:
        jv.sections(jv.make_scene(**SCENE), jv.State(0.9, -1.1), **given)
    assert error.value.key == key
