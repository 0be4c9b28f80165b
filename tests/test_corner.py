"""The onset of impacts between two walls: GR of P100 where both are touched at once, against its closed form."""

import numpy as np
import pytest

import jaxvibro as jv

GAMMA, OMEGA = 0.05, 2.1
SOFT = {"stiffness": 20.0, "damping": 0.3}
SWING = jv.Motion(0.1, 0.3)
# from the distance of the walls: the left wall, the right one
PAIRS = {
    "two restitutions": lambda far: (-far, jv.Wall(far, 0.55)),
    "a soft and a rigid wall": lambda far: (-far, jv.Wall(far, **SOFT)),
    "two soft walls": lambda far: (jv.Wall(-far, **SOFT), jv.Wall(far, stiffness=50.0, damping=0.1)),
    "two moving walls": lambda far: (
        jv.Wall(-far, motion=jv.Motion(0.1, 0.3 + np.pi)),
        jv.Wall(far, 0.6, motion=SWING),
    ),
}


def amplitude(frequency, damping, far, swing=0j):
    """Return A at which the response touches a wall at far + Re(swing exp(i frequency t)).

    x - x_b is a wave of size abs(A h - swing), h being the response: that is to be far.
    """
    response = 1.0 / (1.0 - frequency**2 + 2j * damping * frequency)
    square, middle = abs(response) ** 2, (response * np.conj(swing)).real
    return (middle + np.sqrt(middle**2 - square * (abs(swing) ** 2 - far**2))) / square


def grazing(walls, frequency=OMEGA, damping=GAMMA):
    """Return the GR of P100 along the amplitude."""
    scene = jv.make_scene(0.3, frequency, damping, 0.8, walls)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.2, 30.0), "forward", stop="GR")
    return branch.points("GR")[0]


def draw(seed):
    """Return a random distance of the walls, frequency and damping."""
    return np.random.default_rng(seed).uniform((0.7, 1.6, 0.03), (1.5, 2.6, 1.3))


def assert_locus(touch, name, bounds, expected, tolerance=1e-10):
    """Check a locus in the amplitude and a parameter against the amplitude as a function of it, from bound to bound."""
    locus = jv.locus(touch, ("amplitude", name), {"amplitude": (0.01, 40.0), name: bounds})
    np.testing.assert_allclose(locus.values[:, 0], expected(locus.values[:, 1]), rtol=0, atol=tolerance)
    assert sorted(locus.values[[0, -1], 1]) == sorted(bounds)
    assert abs(np.diff(np.sign(np.diff(locus.values[:, 1])))).max() == 0
    return locus


@pytest.mark.parametrize("name", PAIRS)
def test_a_grazing_of_both_walls_is_an_ordinary_point(name):
    far, frequency, damping = draw(list(PAIRS).index(name))
    swing = 0.1 * np.exp(0.3j) if "moving" in name else 0j
    touch = grazing(PAIRS[name](far), frequency, damping)
    assert touch.value == pytest.approx(amplitude(frequency, damping, far, swing), abs=1e-12)
    slopes, step = jv.sensitivity(touch, ("frequency", "damping")).values, 1e-6
    for slope, change in zip(slopes, step * np.eye(2), strict=True):
        ends = [amplitude(frequency + sign * change[0], damping + sign * change[1], far, swing) for sign in (1, -1)]
        assert slope == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-7)
    assert_locus(touch, "frequency", (1.3, 3.0), lambda value: amplitude(value, damping, far, swing), 1e-9)
    if "soft" not in name:
        assert_locus(touch, "damping", (0.02, 1.6), lambda value: amplitude(frequency, value, far, swing), 1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_along_the_position_of_a_wall_the_nearer_wall_counts(seed):
    far, frequency, damping = draw(seed)
    touch, size = grazing((-far, jv.Wall(far, 0.55)), frequency, damping), amplitude(frequency, damping, 1.0)
    for side, still, sign in (("right", "left", 1.0), ("left", "right", -1.0)):
        name = f"{side}.position"
        assert jv.sensitivity(touch, name, wall=side).values == pytest.approx([sign * size], rel=1e-10)
        assert jv.sensitivity(touch, name, wall=still).values == pytest.approx([0.0], abs=1e-10)
        with pytest.raises(jv.ArgumentError, match=r"^wall: must be .* got {'left': \[.*\], 'right': \[.*\]}$"):
            jv.sensitivity(touch, ("damping", name))
        bounds = tuple(sorted((0.3 * sign * far, 2.0 * sign * far)))
        locus = assert_locus(touch, name, bounds, lambda value: np.minimum(abs(value), far) * size, 1e-11)
        (corner,) = locus.points("GG")
        assert corner.values[name] == pytest.approx(sign * far, abs=1e-12)
        assert {one.kind for one in locus.special} == {"GG", "EP"}
        other = jv.locus(touch, (name, "amplitude"), {"amplitude": (0.01, 40.0), name: bounds})
        np.testing.assert_allclose(other.values[:, 1], np.minimum(abs(other.values[:, 0]), far) * size, atol=1e-11)


def test_a_locus_goes_on_along_the_other_wall_from_where_it_meets_it():
    touch, size = grazing((-1.3, jv.Wall(1.0, 0.55))), amplitude(OMEGA, GAMMA, 1.0)
    locus = assert_locus(touch, "right.position", (0.4, 2.5), lambda value: np.minimum(value, 1.3) * size, 1e-11)
    assert [one.kind for one in locus.special] == ["EP", "GG", "EP"]
    assert np.unique(locus.data["side"].values[locus.values[:, 1] > 1.3 + 1e-9]).tolist() == [-1]
    bounds = {"amplitude": (0.1, 40.0), "frequency": (1.5, 3.0)}
    family = jv.family(touch, ("amplitude", "frequency"), bounds, "right.position", [0.7, 1.9])
    for one, far in zip(family, (0.7, 1.3), strict=True):
        np.testing.assert_allclose(one.values[:, 0], amplitude(one.values[:, 1], GAMMA, far), rtol=0, atol=1e-10)


def test_an_invalid_wall_is_refused():
    touch = grazing((-1.3, jv.Wall(1.0, 0.55)))
    assert jv.sensitivity(touch, "damping", wall="right") == jv.sensitivity(touch, "damping")
    for wall in ("left", "middle", 1):
        with pytest.raises(jv.ArgumentError, match=r"^wall: must be "):
            jv.sensitivity(touch, "damping", wall=wall)
