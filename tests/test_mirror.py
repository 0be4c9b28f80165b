"""`mirror_branch`, against the other half that `switch` follows by itself; which scenes stay symmetric."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches.branch_tree import mirror_branch
from jaxvibro.scene.scene_properties import stays_symmetric

from . import figure_4


@pytest.fixture(scope="module")
def scene():
    return figure_4.scene(3.7)


def halves(scene, name, bounds, wide):
    """The two branches that leave the symmetric P111's SB."""
    found = jv.find_orbits(scene, 1, 200, 0)
    (orbit,) = (one for one in found if one.impacts.count and np.ptp(one.impacts.speed) < 1e-6)
    return jv.switch(jv.follow(orbit, name, wide).points("SB")[0], bounds)


def test_the_other_half_of_a_pitchfork(scene):
    one, other = halves(scene, "amplitude", (3.0, 4.7), (3.0, 4.7))
    image, period = mirror_branch(one), 2.0 * np.pi / 2.1
    assert len(other) == len(image) > 10
    assert np.allclose(image.values, other.values, rtol=0, atol=1e-9)
    for key in ("x", "v", "multiplier_real", "least_clearance"):
        assert np.allclose(image.data[key], other.data[key], rtol=0, atol=1e-8), key
    rows = {}
    for key in ("time", "speed", "side", "time_slope", "speed_slope"):
        for each in (image, other):
            late = np.mod(each.data["time"].values + 0.1, period)
            value = late if key == "time" else each.data[key].values
            rows.setdefault(key, []).append(np.take_along_axis(value, np.argsort(late, axis=1), axis=1))
        assert np.allclose(*rows[key], rtol=0, atol=1e-6), key
    assert [each.kind for each in image.special] == [each.kind for each in other.special]
    for each, twin in zip(image.special, other.special, strict=True):
        assert abs(each.value - twin.value) < 1e-9 and each.label == twin.label
        assert [each.label for each in each.meets] == [each.label for each in twin.meets]


def test_an_image_along_the_frequency(scene):
    one, _ = halves(scene, "frequency", (2.08, 2.3), (1.9, 2.3))
    image = mirror_branch(one)
    data, values = image.data, image.values
    for place in (1, 4, 7):
        period, row = 2.0 * np.pi / values[place], data.isel(point=place)
        start = jv.State(float(row["x"][0]), float(row["v"][0]))
        end, impacts = jv.strobe(scene.replace(frequency=values[place]), start, slots=8)
        assert abs(end.x - start.x) + abs(end.v - start.v) < 1e-9
        times = np.sort(np.mod(row["time"].values, period))
        assert np.allclose(np.asarray(impacts.time)[:2], times, rtol=0, atol=1e-9)
    for key in ("time", "speed"):
        slope = data[f"{key}_slope"].values[3:-3] / data["value_slope"].values[3:-3, None]
        assert np.allclose(np.gradient(data[key].values, values, axis=0)[3:-3], slope, rtol=0.15, atol=0.1)


def test_which_scenes_stay_symmetric(scene):
    assert stays_symmetric(scene, "amplitude") and stays_symmetric(scene, "damping", "frequency", "restitution")
    assert not stays_symmetric(scene, "right.position") and not stays_symmetric(scene, "left.restitution")
    assert not stays_symmetric(jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.5, 1.0)), "amplitude")
