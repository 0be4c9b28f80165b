"""What can be asked on the page: the Python that is shown does what was done, and nothing else can be asked."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.explorer.page_calls import (
    CALLS,
    SCENE_NAME,
    build_call,
    evaluate_call_line,
    prune_call_lines,
    python_code_of_page,
    resolve_reference,
)
from jaxvibro.explorer.scene_code import scales_code, scene_code
from jaxvibro.scene.scene_table import make_scene_table
from jaxvibro.studies.schema import ViewTable

from .explorer_pages import two_walls

STATE = {"x": 0.9, "v": -1.1}
BOX = {"amplitude": [1.5, 2.5], "frequency": [2.0, 2.2]}
ALONG = {"parameter": "amplitude"}
SWEPT = ALONG | {"first": 2.0, "last": 1.0, "count": 3, "x": 0.0, "v": 0.0}
GRID = {"bounds": {name: BOX[name] for name in ("frequency", "amplitude")}, "count": 3}


def line(name, call, of=SCENE_NAME, **arguments):
    return ViewTable(name=name, call=call, of=of, arguments=arguments)


LINES = [
    line("scene_2", "replace", changes={"amplitude": 2.1, "left.restitution": 0.6}),
    line("orbit_1", "find_orbit", **STATE),
    line("orbit_4", "moved", **STATE),
    line("motion_1", "motion", "scene_2", **STATE, periods=3, phase=0.5),
    line("branch_1", "follow", "orbit_1", **ALONG, low=0.0, high=4.0),
    line("orbit_2", "orbit", "branch_1", place=7),
    line("orbit_3", "special", "branch_1.special[1]"),
    line("branches_1", "switch", "branch_1.special[3]"),
    line("sweep_1", "sweep", **SWEPT),
    line("map_1", "map", **GRID),
    line("basins_1", "basins", x=[-1.0, 1.0], v=[-2.0, 2.0], count=6),
    line("attractors_1", "attractors"),
    line("locus_1", "locus", "branch_1.special[2]", bounds=BOX | {"amplitude": [0.4, 0.7]}),
]


def numbers(value):
    """All numbers of a result, in order."""
    if isinstance(value, tuple):
        return np.concatenate([numbers(one) for one in value])
    if isinstance(value, jv.Branch | jv.Locus):
        return np.concatenate([np.ravel(value.data[name].values) for name in sorted(value.data)])
    if isinstance(value, jv.Orbit):
        return np.array([value.state.x, value.state.v, *value.multipliers.view(float), *value.impacts.time])
    if isinstance(value, jv.Scene):
        return np.array(list(value.numbers.values()))
    if hasattr(value, "share"):
        return np.array([value.share, *np.ravel(value.points)])
    return np.concatenate([np.ravel(value[name].values) for name in sorted(value) if value[name].dtype.kind in "if"])


def test_the_python_that_is_shown_has_the_numbers_of_the_page():
    results = {SCENE_NAME: two_walls()}
    for one in LINES:
        results[one.name] = evaluate_call_line(one, results)
    text = python_code_of_page(make_scene_table(results[SCENE_NAME]), LINES, results)
    known = {}
    exec(compile(text, "lines.py", "exec"), known)
    for one in LINES:
        np.testing.assert_allclose(
            numbers(known[one.name]), numbers(results[one.name]), rtol=1e-11, atol=1e-12, err_msg=one.name
        )  # not to the bit: some answers are NumPy's until the compiled ones are there
    assert {one.call for one in LINES} == set(CALLS) - {"explore", "margin"}  # of many minutes; their texts below


def test_texts_of_what_takes_long():
    results = {SCENE_NAME: two_walls(), "orbit_1": jv.find_orbit(two_walls(), jv.State(**STATE))}
    given = {"parameter": "amplitude", "low": 0.0, "high": 6.0, "max_period": 3}
    explored = ViewTable(name="diagram_1", call="explore", of=SCENE_NAME, arguments=given)
    assert build_call(explored, results).text == "jv.explore(scene_1, 'amplitude', (0.0, 6.0), max_period=3)"
    near = ViewTable(name="margin_1", call="margin", of="orbit_1", arguments={"free": {"amplitude": 0.2}})
    assert build_call(near, results).text == "jv.margin(orbit_1, {'amplitude': 0.2})"


@pytest.mark.parametrize(
    "reference",
    [
        "orbit_9",
        "scene_1.__class__",
        "scene_1.replace",
        "scene_1[0]",
        "branch_1.special[99]",
        "os",
        "scene_1; import os",
        "",
    ],
)
def test_a_reference_is_a_result_and_nothing_else(reference):
    with pytest.raises(jv.ArgumentError, match="must refer to the result of an earlier line"):
        resolve_reference(reference, {SCENE_NAME: two_walls(), "branch_1": ()})


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"call": "system"}, "view.call: must be one of"),
        ({"call": "__import__"}, "view.call: must be one of"),
        ({"name": "x = 1; y"}, "view.name: must be a word and a number"),
        ({"arguments": {"x": 0.0}}, "view.arguments: must match those of find_orbit"),
        ({"arguments": STATE | {"more": 1}}, "view.arguments: must match those of find_orbit"),
        ({"call": "margin", "arguments": {"free": {"amplitude": 1.0}}}, "must be an Orbit"),
        ({"call": "switch", "arguments": {}}, "must be a special point"),
    ],
)
def test_what_no_page_can_have_asked_is_refused(change, rule):
    given = {"name": "orbit_1", "call": "find_orbit", "of": SCENE_NAME, "arguments": STATE} | change
    with pytest.raises(jv.ArgumentError, match=rule):
        evaluate_call_line(ViewTable(**given), {SCENE_NAME: two_walls()})


def test_lines_that_nothing_needs_are_left_out():
    kept = [one.name for one in prune_call_lines(LINES, ("orbit_3", SCENE_NAME))]
    assert kept == [one.name for one in LINES if one.name not in ("scene_2", "orbit_4", "motion_1", "orbit_2")]


SCENES = {
    "one wall": lambda: jv.make_scene(1.3, 2.0, 0.01, 0.8, (None, 0.4)),
    "soft": lambda: jv.make_scene(3.0, 2.1, 0.05, walls=(None, jv.Wall(0.5, stiffness=400.0, damping=3.0))),
    "moving": lambda: jv.make_scene(
        *(1.0, 1.5, 0.1, 0.7), (jv.Wall(-1.0, motion=jv.Motion(0.1, 0.5, 2)), jv.Wall(1.2, 0.9)), drive=[(0.4, 3, 0.2)]
    ),
    "law": lambda: jv.make_scene(
        *(1.0, 1.5),
        walls=(jv.Wall(-1.0, law=jv.Push("hertz", {"stiffness": 50.0})), None),
        force=jv.Force("polynomial", {"c1": 1.0, "damping": 0.1}),
    ),
    "force": lambda: jv.make_scene(
        1.0,
        1.5,
        restitution=0.7,
        walls=(-1.0, 1.0),
        force=jv.Force("duffing", {"damping": 0.1, "cubic": 1.0}),
    ),
    "physical": lambda: jv.scene_from_physical(
        mass=0.5, stiffness=800.0, damping=2.0, force=10.0, frequency=9.0, restitution=0.7, walls=(-0.01, 0.01)
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_python_of_a_scene_makes_it(name):
    scene = SCENES[name]()
    table = make_scene_table(scene)
    found = eval(scene_code(table), {"jv": jv})
    if scales_code(table):
        found = dataclasses.replace(found, scales=eval(scales_code(table), {"jv": jv}))
    assert make_scene_table(found) == table
    assert jax.tree.structure(found) == jax.tree.structure(scene)
