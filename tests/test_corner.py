"""The onset of impacts between two walls: GR of P100 where both are touched at once, against its closed form."""

import numpy as np
import pytest

import jaxvibro as jv

GAMMA, OMEGA = 0.05, 2.1
SOFT = {"stiffness": 20.0, "damping": 0.3}
PAIRS = {
    "two restitutions": lambda far: (-far, jv.Wall(far, 0.55)),
    "a soft and a rigid wall": lambda far: (-far, jv.Wall(far, **SOFT)),
    "two soft walls": lambda far: (jv.Wall(-far, **SOFT), jv.Wall(far, stiffness=50.0, damping=0.1)),
    "two moving walls": lambda far: (
        jv.Wall(-far, motion=jv.Motion(0.1, 0.3 + np.pi)),
        jv.Wall(far, 0.6, motion=jv.Motion(0.1, 0.3)),
    ),
}


def amplitude(frequency, damping, far, swing=0j):
    """A at which the response touches a wall at far + Re(swing exp(i frequency t)).

    x - x_b is a wave of size abs(A h - swing), h being the response: that is to be far.
    """
    response = 1.0 / (1.0 - frequency**2 + 2j * damping * frequency)
    square, middle = abs(response) ** 2, (response * np.conj(swing)).real
    return (middle + np.sqrt(middle**2 - square * (abs(swing) ** 2 - far**2))) / square


def grazing(walls, frequency=OMEGA, damping=GAMMA):
    """The GR of P100 along the amplitude."""
    scene = jv.make_scene(0.3, frequency, damping, 0.8, walls)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.2, 30.0), "forward", stop="GR")
    return branch.points("GR")[0]


def swing(name):
    return 0.1 * np.exp(0.3j) if "moving" in name else 0j


@pytest.mark.parametrize("name", PAIRS)
def test_a_grazing_of_both_walls_is_an_ordinary_point(name):
    rng = np.random.default_rng(list(PAIRS).index(name))
    far, frequency, damping = rng.uniform((0.7, 1.6, 0.03), (1.5, 2.6, 1.3))
    touch = grazing(PAIRS[name](far), frequency, damping)
    assert touch.value == pytest.approx(amplitude(frequency, damping, far, swing(name)), abs=1e-12)
    by, step = jv.sensitivity(touch, ("frequency", "damping")).values, 1e-6
    for k, (ways, given) in enumerate(((np.eye(2)[0], 0), (np.eye(2)[1], 1))):
        ends = [amplitude(*(np.array([frequency, damping]) + sign * step * ways), far, swing(name)) for sign in (1, -1)]
        assert by[given] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-7), k
    for other, low, high in (("frequency", 1.3, 3.0), ("damping", 0.02, 1.6))[: 1 if "soft" in name else 2]:
        locus = jv.locus(touch, ("amplitude", other), {"amplitude": (0.1, 30.0), other: (low, high)})
        own = {"frequency": frequency, "damping": damping}
        true = [amplitude(**own | {other: value}, far=far, swing=swing(name)) for value in locus.values[:, 1]]
        assert np.allclose(locus.values[:, 0], true, rtol=0, atol=1e-9)
        assert sorted(locus.values[[0, -1], 1]) == [low, high]


@pytest.mark.parametrize("seed", range(4))
def test_along_the_position_of_a_wall_the_nearer_wall_counts(seed):
    rng = np.random.default_rng(seed)
    far, frequency, damping = rng.uniform((0.7, 1.6, 0.03), (1.5, 2.6, 1.3))
    touch, size = grazing((-far, jv.Wall(far, 0.55)), frequency, damping), amplitude(frequency, damping, 1.0)
    for name, sign in (("right.position", 1.0), ("left.position", -1.0)):
        side, still = name.split(".")[0], "left" if sign > 0 else "right"
        assert jv.sensitivity(touch, name, wall=side).values == pytest.approx([sign * size], rel=1e-10)
        assert jv.sensitivity(touch, name, wall=still).values == pytest.approx([0.0], abs=1e-10)
        with pytest.raises(jv.ArgumentError, match=r"^wall: must be .* got {'left': \[.*\], 'right': \[.*\]}$"):
            jv.sensitivity(touch, ("damping", name))
        ends = sorted(sign * each for each in (0.3 * far, 2.0 * far))
        bounds = {"amplitude": (0.01, 40.0), name: tuple(ends)}
        locus = jv.locus(touch, ("amplitude", name), bounds)
        assert np.allclose(locus.values[:, 0], np.minimum(abs(locus.values[:, 1]), far) * size, rtol=0, atol=1e-11)
        assert sorted(locus.values[[0, -1], 1]) == ends
        (corner,) = locus.points("GG")
        assert corner.values[name] == pytest.approx(sign * far, abs=1e-12)
        assert {one.kind for one in locus.special} == {"GG", "EP"}
        assert (np.diff(sign * locus.values[:, 1]) * np.sign(np.diff(sign * locus.values[[0, -1], 1])) > 0).all()
        other = jv.locus(touch, (name, "amplitude"), bounds)
        assert np.allclose(other.values[:, 1], np.minimum(abs(other.values[:, 0]), far) * size, rtol=0, atol=1e-11)


def test_a_locus_goes_on_along_the_other_wall_from_where_it_meets_it():
    size = amplitude(OMEGA, GAMMA, 1.0)
    touch = grazing((-1.3, jv.Wall(1.0, 0.55)))
    bounds = {"amplitude": (0.01, 40.0), "right.position": (0.4, 2.5)}
    locus = jv.locus(touch, ("amplitude", "right.position"), bounds)
    assert np.allclose(locus.values[:, 0], np.minimum(locus.values[:, 1], 1.3) * size, rtol=0, atol=1e-11)
    assert [one.kind for one in locus.special] == ["EP", "GG", "EP"]
    assert sorted(locus.values[[0, -1], 1]) == [0.4, 2.5]
    (sides,) = (np.unique(locus.data["side"].values[locus.values[:, 1] > far]) for far in (1.3 + 1e-9,))
    assert sides.tolist() == [-1]
    near, beyond = jv.family(
        touch,
        ("amplitude", "frequency"),
        {"amplitude": (0.1, 40.0), "frequency": (1.5, 3.0)},
        "right.position",
        [0.7, 1.9],
    )
    for one, far in ((near, 0.7), (beyond, 1.3)):
        true = [amplitude(value, GAMMA, far) for value in one.values[:, 1]]
        assert np.allclose(one.values[:, 0], true, rtol=0, atol=1e-10)


def test_an_invalid_wall_is_refused():
    touch = grazing((-1.3, jv.Wall(1.0, 0.55)))
    assert jv.sensitivity(touch, "damping", wall="right") == jv.sensitivity(touch, "damping")
    for wall in ("left", "middle", 1):
        with pytest.raises(jv.ArgumentError, match=r"^wall: must be "):
            jv.sensitivity(touch, "damping", wall=wall)
