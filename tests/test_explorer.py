"""One page without a server: what each message changes, the Python that is shown, and requests that are refused."""

import re

import jax
import numpy as np
import pytest
import tomli_w
import xarray as xr

import jaxvibro as jv
from jaxvibro.explorer.action_calls import current_motion_state
from jaxvibro.explorer.page_screen import DRAW_FUNCTIONS

from .explorer_fuzz import ALL, CHEAP, check_answers
from .explorer_pages import PATIENCE, SIZES, Desk, complaints, two_walls
from .kinds import KINDS

STATE = {"x": 0.9, "v": -1.1}
BOX = {"amplitude": [1.5, 2.5], "frequency": [2.0, 2.2]}
RANGE = {"parameter": "amplitude", "low": 0.0, "high": 4.0}
SWEPT = {"parameter": "amplitude", "first": 2.0, "last": 1.0, "count": 3, "x": 0.0, "v": 0.0}
NARROW = {"parameter": "amplitude", "low": 2.0, "high": 2.2, "max_period": 1}
# Lines of Python of the page, one for each call: (name, call, object, arguments).
LINES = [
    ("scene_2", "replace", "scene_1", {"changes": {"amplitude": 2.1, "left.restitution": 0.6}}),
    ("orbit_1", "find_orbit", "scene_1", STATE),
    ("orbit_4", "moved", "scene_1", STATE),
    ("motion_1", "motion", "scene_2", STATE | {"periods": 3, "phase": 0.5}),
    ("branch_1", "follow", "orbit_1", RANGE),
    ("orbit_2", "orbit", "branch_1", {"place": 7}),
    ("orbit_3", "special", "branch_1.special[1]", {}),
    ("branches_1", "switch", "branch_1.special[3]", {}),
    ("sweep_1", "sweep", "scene_1", SWEPT),
    ("map_1", "map", "scene_1", {"bounds": {name: BOX[name] for name in ("frequency", "amplitude")}, "count": 3}),
    ("basins_1", "basins", "scene_1", {"x": [-1.0, 1.0], "v": [-2.0, 2.0], "count": 6}),
    ("attractors_1", "attractors", "scene_1", {}),
    ("locus_1", "locus", "branch_1.special[2]", {"bounds": BOX | {"amplitude": [0.4, 0.7]}}),
    ("diagram_1", "explore", "scene_1", NARROW),
    ("margin_1", "margin", "orbit_1", {"free": {"amplitude": 0.2}}),
]
QUICK = LINES[:7]


def page_file(lines):
    """Return a scene file with the lines of a page."""
    scene = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7}
    scene |= {"left": {"position": -1.0}, "right": {"position": 1.0}}
    keys = ("name", "call", "of", "arguments")
    return tomli_w.dumps({"scene": scene, "view": [dict(zip(keys, line, strict=True)) for line in lines]})


def needed_lines(line):
    """Return a line after those that it refers to."""
    earlier = [other for other in LINES if other[0] == line[2].partition(".")[0]]
    return [*(each for other in earlier for each in needed_lines(other)), line]


def numbers(value, singular=True):
    """Return all numbers of a result in order, with or without points of a branch whose equations are singular."""
    if isinstance(value, jv.Branch) and not singular:
        value = value.data.isel(point=abs(value.multipliers - 1.0).min(axis=1) > 1e-3)
    value = getattr(value, "branches", getattr(value, "data", value))
    if isinstance(value, tuple | list):
        return np.concatenate([numbers(item, singular) for item in value])
    if isinstance(value, jv.Orbit):
        return np.array([value.state.x, value.state.v, *value.multipliers.view(float), *value.impacts.time])
    if isinstance(value, jv.Scene):
        return np.array(list(value.numbers.values()))
    if isinstance(value, jv.Margin):
        return np.array([value.distance])
    if hasattr(value, "share"):
        return np.array([value.share, *np.ravel(value.points)])
    return np.concatenate([np.ravel(value[name].values) for name in sorted(value) if value[name].dtype.kind in "if"])


def executed(desk):
    """Return the names that the Python of a page defines."""
    names = {}
    exec(compile(desk.sent["python"], "lines.py", "exec"), names)
    return names


@pytest.mark.parametrize("line", LINES, ids=[line[1] for line in LINES])
def test_the_python_that_is_shown_has_the_numbers_of_the_page(line):
    desk = Desk()
    assert complaints(desk.run("load", text=page_file(needed_lines(line)))) == []
    names = executed(desk)
    for name in {line[0], *desk.lines}:  # not to the bit: some answers are those of NumPy, until a program is compiled
        for singular, rtol, atol in ((False, 1e-11, 1e-12), (True, 1e-6, 1e-6)):
            shown, expected = (numbers(each, singular) for each in (names[name], desk.session.results[name]))
            np.testing.assert_allclose(shown, expected, rtol=rtol, atol=atol, err_msg=name)


def test_lines_that_no_other_line_needs_are_left_out():
    desk = Desk()
    desk.run("load", text=page_file(QUICK))
    assert desk.lines == ["scene_2", "orbit_1", "branch_1", "orbit_3"]


def test_a_motion_goes_on_from_its_last_state():
    motion = xr.Dataset({"x": ("time", [0.1, 0.2]), "v": ("time", [0.3, 0.4]), "phase": ("time", [6.0, 7.0])})
    state = current_motion_state(motion)
    assert (state.x, state.v, state.phase) == pytest.approx((0.2, 0.4, 7.0 - 2.0 * np.pi), rel=1e-15)


@pytest.mark.parametrize("name", [*KINDS, "physical"])
def test_the_python_of_a_scene_makes_it(name):
    rig = jv.scene_from_physical(0.5, 2.0, 800.0, 10.0, None, 0.7, (-0.01, 0.01), frequency_hz=9.0)
    desk = Desk(rig if name == "physical" else KINDS[name].draw_single(0)[0])
    desk.say("stop")
    scene, made = desk.result("scene"), executed(desk)["scene_1"]
    assert jax.tree.structure(made) == jax.tree.structure(scene)
    assert jax.tree.leaves(made) == jax.tree.leaves(scene)


@pytest.fixture(scope="module")
def followed():
    """A page on which P111 has been followed in the amplitude, from 0 to 4."""
    desk = Desk()
    desk.resize()
    desk.run("hello")
    return desk


@pytest.fixture
def desk(followed):
    """The same page, as it was after the branch was followed."""
    session = followed.session
    before = session.page, list(session.history), dict(session.results), dict(session.screen.limits)
    yield followed
    session.close()
    session.page, session.history, session.results, session.screen.limits = before
    session.drag_start = None


@pytest.fixture
def branch(desk):
    return desk.session.results["branch_1"]


def pictures(records):
    """Return the panels that were drawn."""
    return [record["panel"] for record in records if record["kind"] == "picture"]


def check_orbit(desk, scene, x=0.9, v=-1.1):
    """Check that the page shows the orbit of a scene that a start settles on."""
    expected = jv.find_orbit(scene, jv.State(x, v)).multipliers
    np.testing.assert_allclose(desk.result("current").multipliers, expected, rtol=1e-9)


def test_a_page_begins_with_the_orbit_and_its_branch(desk, branch):
    check_orbit(desk, two_walls(), 0.0, 0.0)
    assert (branch.name, branch.bounds) == ("amplitude", (0.0, 4.0))
    assert set(pictures(desk.records)) == set(SIZES)
    assert [action["call"] for action in desk.sent["actions"]][:2] == ["follow", "margin"]


def test_a_click_shows_the_nearest_point_of_a_branch(desk, branch):
    row = len(branch) // 3
    value, x = branch.values[row], float(branch.data["x"].values[row, 0])
    records = desk.say("pick", panel="diagram", x=float(value), y=x)
    assert desk.session.page.place == row and desk.result("scene").amplitude == value
    np.testing.assert_allclose(desk.result("current").multipliers, branch.multipliers[row], rtol=1e-6)
    assert pictures(records) == ["portrait", "trace"] and desk.sent["marks"]["diagram"] == [[value, x]]
    desk.say("move", by=1)
    assert desk.session.page.place == row + 1
    desk.say("undo")
    assert desk.session.page.place == row


def test_a_click_on_a_special_point_is_that_point(desk, branch):
    (sn,) = branch.points("SN")
    desk.say("pick", panel="diagram", x=sn.value + 0.004, y=float(branch.data["x"].values[sn.place, 0]))
    assert desk.session.page.chosen == f"branch_1.special[{branch.special.index(sn)}]"
    assert f"SN (saddle-node) at {sn.value:.12g}" in desk.sent["facts"]
    assert "locus" in [action["call"] for action in desk.sent["actions"]]


def test_a_click_beside_all_branches_goes_to_that_value(desk):
    desk.say("pick", panel="diagram", x=2.5, y=0.0)
    assert desk.result("scene").amplitude == 2.5
    check_orbit(desk, two_walls().replace(amplitude=2.5))


def test_a_slider_is_one_step_back_however_often_it_moved(desk):
    before = desk.session.page
    for value in (0.051, 0.055, 0.06):
        records = desk.say("set", name="damping", value=value, last=False)
        assert set(pictures(records)) == {"portrait"}
    desk.say("set", name="damping", value=0.07, last=True)
    check_orbit(desk, two_walls().replace(damping=0.07))
    assert desk.sent["numbers"]["damping"] == 0.07
    assert [line.name for line in desk.session.page.lines if line.call == "replace"] == [desk.session.page.scene]
    desk.say("undo")
    assert desk.session.page == before


def test_branches_of_another_scene_are_not_drawn_and_come_back(desk):
    desk.say("set", name="restitution", value=0.5)
    assert desk.sent["points"] == []
    desk.say("set", name="restitution", value=0.7)
    assert [point["kind"] for point in desk.sent["points"]] == ["SN", "GR", "SB"]


def test_a_start_that_settles_on_no_orbit_is_shown_as_a_motion():
    desk = Desk(jv.make_scene(5.8, 2.1, 0.05, 0.7, (-1.0, 1.0)))
    desk.say("start", x=0.3, v=0.1)
    assert "no periodic orbit of up to 32 periods" in desk.sent["facts"]
    assert desk.sent["actions"][0]["call"] == "explore"
    assert "requires a periodic orbit" in complaints(desk.run("ask", call="follow"))[0]


REFERENCES = ["orbit_9", "scene_1.__class__", "scene_1.replace", "scene_1[0]", "branch_1.special[99]", "os", ""]
REFERENCES += ["scene_1; import os"]
IMPOSSIBLE = [
    ({"do": "set", "name": "amplitud", "value": 1.0}, "must be a parameter of the scene"),
    ({"do": "set", "name": "restitution", "value": 1.5}, "restitution"),
    ({"do": "set", "name": "left.position", "value": 2.0}, "position"),
    ({"do": "start", "x": 3.0, "v": 0.0}, "x"),
    *(({"do": "choose", "of": name}, "must refer to the result of an earlier line") for name in REFERENCES),
    ({"do": "zoom", "panel": "diagram", "x": (2.0, 1.0)}, "must be finite and increasing"),
    *(({"do": "zoom", "panel": name, "y": (-1e308, 1e308)}, "must lie between -1e+100 and 1e+100") for name in SIZES),
    ({"do": "zoom", "panel": "trace", "x": (-1e101, 1.0)}, "must lie between -1e+100 and 1e+100"),
    ({"do": "load", "text": "[scene"}, "must be a TOML file"),
    ({"do": "load", "text": "a" * 2_000_000}, "must be at most 1,000,000"),
    ({"do": "ask", "call": "switch"}, "requires a special point"),
]


@pytest.mark.parametrize("message, rule", IMPOSSIBLE, ids=[str(row[0])[:50] for row in IMPOSSIBLE])
def test_an_impossible_message_is_answered_with_one_line_and_changes_nothing(desk, message, rule):
    before = desk.session.page
    records = desk.say(**message, number=7)
    (text,) = complaints(records)
    assert rule in text and "\n" not in text and len(text) <= 300
    assert desk.session.page == before and records[-1] == {"kind": "answer", "number": 7}


@pytest.mark.parametrize(
    "line, rule",
    [
        (("orbit_1", "system", "scene_1", STATE), "view.call: must be one of"),
        (("orbit_1", "__import__", "scene_1", STATE), "view.call: must be one of"),
        (("x = 1; y", "find_orbit", "scene_1", STATE), "view.name: must be a word and a number"),
        (("scene_1", "find_orbit", "scene_1", STATE), "view.name: must differ from earlier names"),
        (("orbit_1", "find_orbit", "scene_1", {"x": 0.0}), "view.arguments: must match those of find_orbit"),
        (("orbit_1", "find_orbit", "scene_1", STATE | {"more": 1}), "view.arguments: must match those of find_orbit"),
        (("orbit_1", "find_orbit", "scene_1.__class__", STATE), "must refer to the result of an earlier line"),
        (("margin_1", "margin", "scene_1", {"free": {"amplitude": 1.0}}), "must be an Orbit"),
        (("branches_1", "switch", "scene_1", {}), "must be a special point"),
    ],
)
def test_a_line_that_no_page_can_have_written_is_refused(line, rule):
    (text,) = complaints(Desk().run("load", text=page_file([line])))
    assert rule in text


def test_parameters_and_ranges_of_the_axes(desk):
    axes = {"parameter": "frequency", "bounds": (2.0, 2.2), "second": "damping", "second_bounds": (0.0, 0.1)}
    desk.say("along", **axes, variable="speed")
    assert desk.sent["points"] == []
    desk.run("ask", call="follow")
    branch = desk.session.results[desk.lines[-1]]
    assert (branch.name, branch.bounds, desk.session.page.variable) == ("frequency", (2.0, 2.2), "speed")


def test_a_result_that_comes_after_undo_has_all_that_it_refers_to(desk):
    desk.say("set", name="damping", value=0.06)
    desk.say("ask", call="follow")
    desk.say("undo")
    desk.run("undo")
    for line in desk.session.page.lines:
        assert line.of.split(".")[0].split("[")[0] in ("scene_1", *desk.lines)
    assert desk.lines[-1].startswith("branch_")


def test_a_grid_is_refined_in_place(desk):
    records = desk.run("ask", call="basins", count=32)
    (grid,) = [line for line in desk.session.page.lines if line.call == "basins"]
    assert grid.arguments["count"] == 32 and desk.session.results[grid.name]["label"].shape == (32, 32)
    assert pictures(records).count("portrait") == 2


def test_a_stopped_task_ends_and_shows_nothing(desk):
    lines = desk.lines
    desk.say("ask", call="explore", max_period=8)
    (task,) = [task for _, task in desk.session.tasks._tasks.values()]
    desk.say("stop")
    task.join(30.0)
    assert not task.is_alive()
    assert desk.session.tasks.labels == {} and desk.lines == lines


def test_a_result_that_was_computed_before_the_stop_is_not_shown_after_it(desk):
    desk.say("set", name="damping", value=0.06)
    lines = desk.lines
    desk.say("ask", call="follow")
    show = desk.turns.get(timeout=PATIENCE)
    desk.say("stop")
    show()
    assert desk.lines == lines


def test_the_page_as_a_file_is_the_page_again(desk):
    desk.say("move", by=3)
    desk.say("set", name="damping", value=0.055)
    other = Desk()
    other.run("hello", text=desk.sent["file"])
    for key in ("python", "facts", "numbers"):
        assert other.sent[key] == desk.sent[key]
    other.say("start", x=0.2, v=0.0)  # the numbers of names go on
    assert len(set(other.lines)) == len(other.lines)


def test_the_limits_of_the_axes_are_those_of_a_message(desk):
    desk.say("stop")
    for panel in SIZES:
        picture, answer = desk.say("zoom", panel=panel, x=(-1.0, 2.0), number=8)
        assert (picture["kind"], picture["x"]) == ("picture", [-1.0, 2.0]) and answer["number"] == 8


def test_the_python_prints_the_tables_of_the_page(desk, capsys):
    desk.say("move", by=3)
    executed(desk)
    printed = capsys.readouterr().out
    point, _, orbit = desk.sent["facts"].partition("\n\n")
    assert point.startswith("point ") and orbit in printed and len(desk.sent["points"]) == 3
    for point in desk.sent["points"]:
        value = re.search(rf"^{point['kind']} +(\S+)", printed, re.MULTILINE)[1]
        assert float(value) == pytest.approx(point["value"], rel=1e-8)


def raising(message):
    """Return a function that raises a RuntimeError."""

    def fail(*arguments):
        raise RuntimeError(message)

    return fail


def test_a_picture_that_cannot_be_drawn_is_one_line_and_the_page_goes_on(desk, monkeypatch, capsys):
    plain = DRAW_FUNCTIONS["trace"]

    def fail_when_narrow(ax, *parts):
        plain(ax, *parts)
        if desk.session.screen.limits.get("trace"):
            raise RuntimeError("no such picture")

    desk.say("stop")
    monkeypatch.setitem(DRAW_FUNCTIONS, "trace", fail_when_narrow)
    records = desk.say("zoom", panel="trace", x=(0.0, 1.0), number=3)
    assert complaints(records) == ["the trace cannot be drawn: no such picture"]
    assert [record["kind"] for record in records] == ["told", "picture", "answer"]  # with the limits of before
    assert "RuntimeError: no such picture" in capsys.readouterr().err
    monkeypatch.setitem(DRAW_FUNCTIONS, "trace", raising("no picture at all"))
    desk.session.screen.invalidate()
    records = desk.say("zoom", panel="plane", number=4)
    assert len(complaints(records)) == 1 and records[-1] == {"kind": "answer", "number": 4}
    assert set(pictures(records)) == {"portrait", "diagram", "plane"}
    assert [record["kind"] for record in desk.say("stop", number=5)] == ["answer"]  # it is not drawn again


def test_an_unexpected_error_is_answered(desk, monkeypatch, capsys):
    for name, message in (("_select", {"do": "choose", "of": "branch_1"}), ("_send_fields", {"do": "stop"})):
        with monkeypatch.context() as patch:
            patch.setattr(type(desk.session), name, raising("a fault\nof ours"))
            records = desk.say(**message, number=3)
        assert complaints(records) == ["a fault of ours"] and records[-1] == {"kind": "answer", "number": 3}
    assert "RuntimeError: a fault" in capsys.readouterr().err
    assert desk.say("stop", number=5)[-1] == {"kind": "answer", "number": 5}


@pytest.mark.parametrize("count, kinds", [(250, CHEAP), (60, tuple(ALL))], ids=["without computation", "all"])
def test_every_message_is_answered(desk, count, kinds):
    """Odd numbers, names and texts, cut messages, wrong kinds."""
    assert check_answers(desk, count, 58, kinds) > 0.4 * count


def test_numbers_that_json_has_not_are_null():
    desk = Desk()
    desk.session.send({"a": [float("inf"), (1.5, float("nan"))], "b": "NaN"})
    assert desk.records == [{"a": [None, [1.5, None]], "b": "NaN"}]
