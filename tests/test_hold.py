"""Orbits that share a number along two parameters."""

import numpy as np
import pytest

import jaxvibro as jv

WALLS = tuple(jv.Wall(place, stiffness=60.0, damping=0.5) for place in (-1.0, 1.0))


def assert_found_alone(held, count):
    """Check points of a branch against the orbits that `find_orbit` finds at their numbers."""
    for k in np.linspace(0, len(held) - 1, count).astype(int).tolist():
        scene, own = held.located(k)[0], held.orbit(k)
        orbit = jv.find_orbit(scene, own.state, periods=1, settle=0)
        number = jv.peak(orbit) if held.held == "peak" else orbit.least_speed
        assert abs(number - held.value) < 1e-10
        assert abs(orbit.state.x - own.state.x) + abs(orbit.state.v - own.state.v) < 1e-10


@pytest.mark.parametrize("size", ["small", "large"])
def test_a_peak_between_soft_walls_is_held(size):
    orbit = jv.find_orbit(jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS), jv.State(0.9, -1.1))
    bounds = {"amplitude": (0.2, 6.0), "frequency": (1.2, 4.0) if size == "large" else (2.05, 2.15)}
    held = jv.follow(orbit, ("amplitude", "frequency"), bounds, hold={"peak": 1.2})
    assert held.names == ("amplitude", "frequency")
    assert 2.1 in held.values[:, 1] and jv.peak(orbit) > 1.25  # it began aside
    assert_found_alone(held, 50 if size == "large" else 4)
    if size == "large":
        assert len(held) > 50 and [one.split(" ")[0] for one in held.reasons] == ["frequency", "amplitude"]


def test_a_slowest_impact_is_held(tmp_path):
    orbit = jv.find_orbit(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.3)), jv.State(0.9, -1.1))
    bounds = {"amplitude": (0.5, 4.0), "right.position": (1.2, 1.5)}
    held = jv.follow(orbit, ("amplitude", "right.position"), bounds, hold={"least_speed": 1.5})
    assert len(held) > 5 and abs(held.data["least_speed"].values - 1.5).max() < 1e-10
    assert set(held.values[[0, -1], 1]) <= {1.2, 1.5} and "right.position reached" in held.reason["last"]
    assert_found_alone(held, 3)
    assert "least_speed 1.5 along amplitude and right.position" in repr(held)
    assert np.array_equal(held.to_frame()["least_speed"], np.full(len(held), 1.5)) and held.label == "P111"
    held.save(tmp_path / "held.nc")
    assert jv.load_held_branch(tmp_path / "held.nc").data.identical(held.data)
    for change, key in (
        ({"hold": {"speed": 1.0}}, "hold"),
        ({"bounds": (0.0, 4.0)}, "bounds"),
        ({"stop": "GR"}, "monitors"),
    ):
        given = {"orbit": orbit, "name": tuple(bounds), "bounds": bounds, "hold": {"least_speed": 1.5}} | change
        with pytest.raises(jv.ArgumentError) as error:
            jv.follow(**given)
        assert error.value.key == key
