"""Names of parameters: a text is one name, several in a tuple are one parameter, and another value is refused."""

import numpy as np
import pytest

import jaxvibro as jv

PAIR = ("left.restitution", "right.restitution")
BOUNDS = {"amplitude": (0.2, 3.0), "frequency": (2.0, 2.2)}
ONE = {
    "follow": lambda scene, point, name: jv.follow(point.orbit, name, (0.0, 3.0)),
    "explore": lambda scene, point, name: jv.explore(scene, name, (0.0, 3.0)),
    "diagrams": lambda scene, point, name: jv.diagrams(scene, name, (0.0, 3.0), "damping", [0.1]),
    "diagrams over": lambda scene, point, name: jv.diagrams(scene, "amplitude", (0.0, 3.0), name, [0.1]),
    "sweep": lambda scene, point, name: jv.sweep(scene, name, [0.1, 0.2], jv.State(0.0, 0.0)),
    "spectrum": lambda scene, point, name: jv.spectrum(scene, name, [0.1, 0.2], jv.State(0.0, 0.0)),
    "family": lambda scene, point, name: jv.family(point, tuple(BOUNDS), BOUNDS, name, [0.1]),
    "locus": lambda scene, point, name: jv.locus(point, ("amplitude", name), BOUNDS),
    "parameter": lambda scene, point, name: scene.parameter(name),
}
SEVERAL = {
    "sensitivity": lambda point, names: jv.sensitivity(point, [names] if names is None else names),  # None: all
    "locus": lambda point, names: jv.locus(point, names, BOUNDS),
    "family": lambda point, names: jv.family(point, names, BOUNDS, "damping", [0.1]),
}
NOT_ONE = (PAIR, ["amplitude"], "", "amplitud", 3, None, np.array(["damping"] * 2))
NOT_SEVERAL = ["ab", "amplitud", 3, None, [3], [None], (), [()], [("damping", 3)], np.arange(2)]
NOT_SEVERAL += [[("damping", "damping")]]


def fold(scene):
    """Return the fold of P111 in the amplitude."""
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "amplitude", (0.2, 2.3), "backward", stop="GR")
    return next(point for point in branch.points("SN") if point.label == "P111")


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (jv.Wall(-1.0, 0.7), jv.Wall(1.0, 0.7)))


@pytest.fixture(scope="module")
def point(scene):
    return fold(scene)


@pytest.mark.parametrize("call", ONE)
def test_a_value_that_is_not_one_name_is_refused_with_one_line(scene, point, call):
    for name in NOT_ONE:
        with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
            ONE[call](scene, point, name)


@pytest.mark.parametrize("call", SEVERAL)
def test_a_value_that_is_not_several_names_is_refused_with_one_line(point, call):
    for names in NOT_SEVERAL:
        with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
            SEVERAL[call](point, names)
    with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
        jv.follow(point.orbit, "amplitude", (0.2, 3.0), monitors="ab")


def test_a_text_is_one_name_and_not_its_letters(point):
    assert jv.sensitivity(point, "damping") == jv.sensitivity(point, ["damping"])
    with pytest.raises(jv.ArgumentError, match=r"^figure: must be one of .*; got 'fig99'$"):
        jv.paper("fig99")


@pytest.mark.parametrize("seed", range(4))
def test_parameters_in_a_tuple_have_one_value_and_move_a_point_as_all_of_them_do(seed):
    rng = np.random.default_rng(seed)
    restitution, other = rng.uniform(0.45, 0.8, 2)
    numbers = {"frequency": rng.uniform(2.0, 2.3), "damping": rng.uniform(0.02, 0.1)}
    walls = jv.Wall(-1.0, restitution), jv.Wall(1.0, restitution)
    scene = jv.make_scene(2.0, walls=walls, restitution=1.0, **numbers)
    point = fold(scene)
    both, left, right = float(jv.sensitivity(point, [PAIR])[0]), *jv.sensitivity(point, PAIR).values
    assert both == pytest.approx(left + right, rel=1e-9)
    scene = scene.replace(**{PAIR[1]: other})
    point = fold(scene)
    for names in (PAIR, PAIR[::-1]):
        with pytest.raises(jv.ArgumentError, match=r"^names: must have one value in one tuple; .* add the results"):
            jv.sensitivity(point, ["damping", names])
    step = 1e-4
    upper, lower = (
        fold(scene.replace(**{PAIR[0]: restitution + change, PAIR[1]: other + change})).value
        for change in (step, -step)
    )
    assert jv.sensitivity(point, PAIR).values.sum() == pytest.approx((upper - lower) / (2.0 * step), rel=1e-5)
