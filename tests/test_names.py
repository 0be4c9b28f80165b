"""Names of parameters: a text is one name, several in a tuple are one parameter, and unknown names are refused.

`test_arguments` checks that values of other types are refused.
"""

import pytest

import jaxvibro as jv

PAIR = ("left.restitution", "right.restitution")
BOUNDS = {"amplitude": (0.2, 3.0), "frequency": (2.0, 2.2)}
START = jv.State(0.0, 0.0)


def fold(scene):
    """Return the fold of P111 in the amplitude."""
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "amplitude", (0.2, 2.3), "backward", stop="GR")
    return next(point for point in branch.points("SN") if point.label == "P111")


@pytest.fixture(scope="module")
def point():
    return fold(jv.make_scene(2.0, 2.1, 0.05, 0.7, (jv.Wall(-1.0, 0.7), jv.Wall(1.0, 0.7))))


@pytest.mark.parametrize("name", ["", "amplitud"])
def test_a_value_that_is_not_one_name_is_refused_with_one_line(point, name):
    scene, row = point.scene, ("amplitude", (0.0, 3.0))
    for function, arguments in (
        (jv.follow, (point.orbit, name, (0.0, 3.0))),
        (jv.explore, (scene, name, (0.0, 3.0))),
        (jv.diagrams, (scene, name, (0.0, 3.0), "damping", [0.1])),
        (jv.diagrams, (scene, *row, name, [0.1])),
        (jv.sweep, (scene, name, [0.1, 0.2], START)),
        (jv.spectrum, (scene, name, [0.1, 0.2], START)),
        (jv.family, (point, tuple(BOUNDS), BOUNDS, name, [0.1])),
        (jv.locus, (point, ("amplitude", name), BOUNDS)),
        (scene.parameter, (name,)),
    ):
        with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
            function(*arguments)


@pytest.mark.parametrize(
    "names", [["ab"], "amplitud", (), [()], [("damping", 3)], [("damping", "damping")], PAIR[:1], [None]]
)
def test_a_value_that_is_not_several_names_is_refused_with_one_line(point, names):
    calls = [(jv.locus, (point, names, BOUNDS)), (jv.family, (point, names, BOUNDS, "damping", [0.1]))]
    calls += [(jv.sensitivity, (point, names))] if names != PAIR[:1] else []
    for function, arguments in calls:
        with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
            function(*arguments)


def test_a_text_is_one_name_and_not_its_letters(point):
    assert jv.sensitivity(point, "damping") == jv.sensitivity(point, ["damping"])
    with pytest.raises(jv.ArgumentError, match=r"^[^\n]*$"):
        jv.follow(point.orbit, "amplitude", (0.2, 3.0), monitors="ab")
    with pytest.raises(jv.ArgumentError, match=r"^figure: must be one of .*; got 'fig99'$"):
        jv.paper("fig99")


def test_parameters_in_a_tuple_have_one_value_and_move_a_point_as_all_of_them_do(point):
    left, right = jv.sensitivity(point, PAIR).values
    assert float(jv.sensitivity(point, [PAIR])[0]) == pytest.approx(left + right, rel=1e-9)
    scene, step = point.scene.replace(**{"amplitude": 2.0, PAIR[1]: 0.6}), 1e-4
    other = fold(scene)
    for names in (PAIR, PAIR[::-1]):
        with pytest.raises(jv.ArgumentError, match=r"^names: must have one value in one tuple; .* add the results"):
            jv.sensitivity(other, ["damping", names])
    upper, lower = (fold(scene.replace(**{PAIR[0]: 0.7 + by, PAIR[1]: 0.6 + by})).value for by in (step, -step))
    assert jv.sensitivity(other, PAIR).values.sum() == pytest.approx((upper - lower) / (2.0 * step), rel=1e-5)
