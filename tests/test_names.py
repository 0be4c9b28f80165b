"""Names of parameters: a text is one name, several in a tuple are one parameter, and what is neither is one line."""

import numpy as np
import pytest

import jaxvibro as jv

NOT_ONE = (("left.restitution", "right.restitution"), ["amplitude"], "", "amplitud", 3, None, np.array(["damping"] * 2))
NOT_SEVERAL = (
    "ab",
    "amplitud",
    3,
    None,
    [3],
    [None],
    (),
    [()],
    [("damping", 3)],
    np.arange(2),
    [("damping", "damping")],
)
WALLS = (jv.Wall(-1.0, 0.7), jv.Wall(1.0, 0.7))


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS)


@pytest.fixture(scope="module")
def branch(scene):
    return folded(scene)


def folded(scene):
    """The branch of P111 about its fold."""
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.2, 2.3), "backward", stop="GR")


def fold(branch):
    return next(one for one in branch.points("SN") if one.label == "P111")


@pytest.mark.parametrize("name", NOT_ONE, ids=repr)
def test_what_is_no_name_is_one_clear_line(scene, branch, name):
    orbit, point, bounds = branch.orbit(0), fold(branch), {"amplitude": (0.2, 3.0), "frequency": (2.0, 2.2)}
    calls = (
        lambda: jv.follow(orbit, name, (0.0, 3.0)),
        lambda: jv.explore(scene, name, (0.0, 3.0)),
        lambda: jv.diagrams(scene, name, (0.0, 3.0), "damping", [0.1]),
        lambda: jv.diagrams(scene, "amplitude", (0.0, 3.0), name, [0.1]),
        lambda: jv.sweep(scene, name, [0.1, 0.2], jv.State(0.0, 0.0)),
        lambda: jv.spectrum(scene, name, [0.1, 0.2], jv.State(0.0, 0.0)),
        lambda: jv.family(point, tuple(bounds), bounds, name, [0.1]),
        lambda: jv.locus(point, ("amplitude", name), bounds),
        lambda: scene.parameter(name),
    )
    for call in calls:
        with pytest.raises(jv.ArgumentError) as told:
            call()
        assert "\n" not in str(told.value)


@pytest.mark.parametrize("names", NOT_SEVERAL, ids=repr)
def test_what_are_no_names_is_one_clear_line(branch, names):
    point, bounds = fold(branch), {"amplitude": (0.2, 3.0), "frequency": (2.0, 2.2)}
    calls = (
        lambda: jv.sensitivity(point, [names] if names is None else names),  # without names it is of all
        lambda: jv.locus(point, names, bounds),
        lambda: jv.family(point, names, bounds, "damping", [0.1]),
        lambda: jv.follow(branch.orbit(0), "amplitude", (0.2, 3.0), monitors="ab"),
    )
    for call in calls:
        with pytest.raises(jv.ArgumentError) as told:
            call()
        assert "\n" not in str(told.value)


def test_a_text_is_one_name_and_not_its_letters(branch):
    assert jv.sensitivity(fold(branch), "damping") == jv.sensitivity(fold(branch), ["damping"])
    with pytest.raises(jv.ArgumentError, match=r"^figure: must be one of .*; got 'fig99'$"):
        jv.paper("fig99")


@pytest.mark.parametrize("seed", range(4))
def test_parameters_in_a_tuple_have_one_value_and_move_a_point_as_all_of_them_do(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.uniform(0.45, 0.8, 2)
    numbers = {"frequency": rng.uniform(2.0, 2.3), "damping": rng.uniform(0.02, 0.1)}
    pair = ("left.restitution", "right.restitution")
    point = fold(
        folded(scene := jv.make_scene(2.0, walls=(jv.Wall(-1.0, one), jv.Wall(1.0, one)), restitution=1.0, **numbers))
    )
    both, left, right = float(jv.sensitivity(point, [pair])[0]), *jv.sensitivity(point, pair).values
    assert both == pytest.approx(left + right, rel=1e-9)
    scene = scene.replace(**{"right.restitution": other})
    point = fold(folded(scene))
    for names in (pair, pair[::-1]):
        with pytest.raises(jv.ArgumentError, match=r"^names: must have one value in one tuple; .* add the results"):
            jv.sensitivity(point, ["damping", names])
    step = 1e-4
    ends = [fold(folded(scene.replace(**{pair[0]: one + way, pair[1]: other + way}))).value for way in (step, -step)]
    assert jv.sensitivity(point, pair).values.sum() == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-5)
