"""One page without a server: what each message changes, and what can be taken back."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.explorer import messages, page_screen
from jaxvibro.studies import scene_file

from .explorer_fuzz import CHEAP, draw
from .explorer_pages import PATIENCE, SIZES, Desk, complaints, two_walls


@pytest.fixture(scope="module")
def followed():
    """A page on which P111 has been followed along the amplitude, from 0 to 4."""
    desk = Desk()
    for panel, (width, height) in SIZES.items():
        desk.say(messages.ResizePanel(panel=panel, width=width, height=height))
    desk.say(messages.Hello())
    desk.rest()
    return desk


@pytest.fixture
def desk(followed):
    """The same page, as it was when it had been followed."""
    session = followed.session
    before = session.page, list(session.history), dict(session.results), dict(session.screen.limits)
    yield followed
    session.close()
    session.page, session.history, session.results, session.screen.limits = before
    session.drag_start = None


def test_a_page_begins_with_the_orbit_and_its_branch(desk):
    orbit = jv.find_orbit(two_walls(), jv.State(0.0, 0.0))
    (branch,) = (one for one in desk.session.results.values() if isinstance(one, jv.Branch))
    np.testing.assert_allclose(desk.current.multipliers, orbit.multipliers, rtol=1e-9)
    assert (branch.name, branch.bounds) == ("amplitude", (0.0, 4.0))
    assert {record["panel"] for record in desk.told if record["kind"] == "picture"} == set(SIZES)
    assert [one["call"] for one in desk.session.sent_fields["actions"]][:2] == ["follow", "margin"]


def test_a_click_shows_the_nearest_point_of_a_branch(desk):
    (branch,) = (one for one in desk.session.results.values() if isinstance(one, jv.Branch))
    place = len(branch) // 3
    x = float(branch.data["x"].values[place, 0])
    told = desk.say(messages.Click(panel="diagram", x=float(branch.values[place]), y=x))
    assert desk.session.page.place == place
    np.testing.assert_allclose(desk.current.multipliers, branch.multipliers[place], rtol=1e-6)
    assert float(desk.session.results[desk.session.page.scene].amplitude) == branch.values[place]
    assert [record["panel"] for record in told if record["kind"] == "picture"] == ["portrait", "trace"]
    assert desk.session.sent_fields["marks"]["diagram"] == [[branch.values[place], x]]
    desk.say(messages.MoveOnBranch(by=1))
    assert desk.session.page.place == place + 1
    desk.say(messages.Undo())
    assert desk.session.page.place == place


def test_a_click_on_a_special_point_is_that_point(desk):
    (branch,) = (one for one in desk.session.results.values() if isinstance(one, jv.Branch))
    (sn,) = branch.points("SN")
    desk.say(messages.Click(panel="diagram", x=sn.value + 0.004, y=float(branch.data["x"].values[sn.place, 0])))
    assert desk.session.page.chosen == f"branch_1.special[{branch.special.index(sn)}]"
    assert f"SN (saddle-node) at {sn.value:.12g}" in desk.session.sent_fields["facts"]
    assert "locus" in [one["call"] for one in desk.session.sent_fields["actions"]]


def test_a_click_beside_all_branches_goes_to_that_value(desk):
    desk.say(messages.Click(panel="diagram", x=2.5, y=0.0))
    scene = desk.session.results[desk.session.page.scene]
    assert float(scene.amplitude) == 2.5
    there = jv.find_orbit(two_walls().replace(amplitude=2.5), jv.State(0.9, -1.1))
    np.testing.assert_allclose(desk.current.multipliers, there.multipliers, rtol=1e-9)


def test_a_slider_is_one_step_back_however_often_it_moved(desk):
    before = desk.session.page
    for value in (0.051, 0.055, 0.06):
        told = desk.say(messages.SetParameter(name="damping", value=value, last=False))
        assert {record["panel"] for record in told if record["kind"] == "picture"} == {"portrait"}
    desk.say(messages.SetParameter(name="damping", value=0.07, last=True))
    there = jv.find_orbit(two_walls().replace(damping=0.07), jv.State(0.9, -1.1))
    np.testing.assert_allclose(desk.current.multipliers, there.multipliers, rtol=1e-9)
    assert desk.session.sent_fields["numbers"]["damping"] == 0.07
    assert [line.name for line in desk.session.page.lines if line.call == "replace"] == [desk.session.page.scene]
    desk.say(messages.Undo())
    assert desk.session.page == before


def test_branches_of_another_scene_are_not_drawn_and_come_back(desk):
    desk.say(messages.SetParameter(name="restitution", value=0.5))
    assert desk.session.sent_fields["points"] == []
    desk.say(messages.SetParameter(name="restitution", value=0.7))
    assert [one["kind"] for one in desk.session.sent_fields["points"]] == ["SN", "GR", "SB"]


def test_a_start_that_settles_on_no_orbit_is_shown_as_a_motion():
    desk = Desk(jv.make_scene(5.8, 2.1, 0.05, 0.7, (-1.0, 1.0)))
    desk.say(messages.SetStart(x=0.3, v=0.1))
    assert "no periodic orbit of up to 32 periods" in desk.session.sent_fields["facts"]
    assert next(one["call"] for one in desk.session.sent_fields["actions"]) == "explore"
    assert "requires a periodic orbit" in complaints(desk.ask("follow"))[0]


@pytest.mark.parametrize(
    ("message", "rule"),
    [
        (messages.SetParameter(name="amplitud", value=1.0), "must be a parameter of the scene"),
        (messages.SetParameter(name="restitution", value=1.5), "restitution"),
        (messages.SetParameter(name="left.position", value=2.0), "position"),
        (messages.SetStart(x=3.0, v=0.0), "x"),
        (messages.Select(of="branch_1.special[77]"), "must refer to the result of an earlier line"),
        (messages.ZoomPanel(panel="diagram", x=(2.0, 1.0)), "must be finite and increasing"),
        (messages.ZoomPanel(panel="portrait", y=(-1e308, 1e308)), "must lie between -1e+100 and 1e+100"),
        (messages.LoadSceneFile(text="[scene"), "must be a TOML file"),
        (messages.LoadSceneFile(text="a" * 2_000_000), "must be at most 1,000,000"),
        (messages.RunAction(call="switch"), "requires a special point"),
    ],
)
def test_what_cannot_be_is_one_line_and_changes_nothing(desk, message, rule):
    before = desk.session.page
    (text,) = complaints(desk.say(message))
    assert rule in text and "\n" not in text and len(text) <= 300
    assert desk.session.page == before


def test_parameters_and_ranges_of_the_axes(desk):
    given = {"parameter": "frequency", "bounds": (2.0, 2.2), "second": "damping", "second_bounds": (0.0, 0.1)}
    desk.say(messages.SetAxes(**given, variable="speed"))
    assert desk.session.sent_fields["points"] == []
    desk.ask("follow")
    branch = desk.session.results[desk.lines[-1]]
    assert (branch.name, branch.bounds) == ("frequency", (2.0, 2.2))
    assert desk.session.page.variable == "speed"


def test_what_is_found_after_it_was_undone_has_all_that_it_refers_to(desk):
    desk.say(messages.SetParameter(name="damping", value=0.06))
    desk.say(messages.RunAction(call="follow"))
    desk.say(messages.Undo())
    desk.say(messages.Undo())
    desk.rest()
    names = desk.lines
    for line in desk.session.page.lines:
        assert line.of.split(".")[0].split("[")[0] in ("scene_1", *names)
    assert names[-1].startswith("branch_")


def test_a_grid_is_refined_in_place(desk):
    told = desk.ask("basins", count=32)
    grids = [line for line in desk.session.page.lines if line.call == "basins"]
    assert [line.arguments["count"] for line in grids] == [32]
    assert desk.session.results[grids[0].name]["label"].shape == (32, 32)
    assert sum(record["kind"] == "picture" and record["panel"] == "portrait" for record in told) == 2


def test_work_that_is_stopped_ends_and_finds_nothing(desk):
    lines = desk.lines
    desk.say(messages.RunAction(call="explore", max_period=8))
    (work,) = [work for _, work in desk.session.tasks._tasks.values()]
    desk.say(messages.StopTasks())
    work.join(30.0)
    assert not work.is_alive()
    assert desk.session.tasks.labels == {} and desk.lines == lines


def test_what_was_found_but_not_shown_before_it_was_stopped_is_not_shown(desk):
    desk.say(messages.SetParameter(name="damping", value=0.06))
    lines = desk.lines
    desk.say(messages.RunAction(call="follow"))
    found = desk.turns.get(timeout=PATIENCE)
    desk.say(messages.StopTasks())
    found()
    assert desk.lines == lines


def test_the_page_as_a_file_is_the_page_again(desk):
    desk.say(messages.MoveOnBranch(by=3))
    desk.say(messages.SetParameter(name="damping", value=0.055))
    text, python = desk.session.sent_fields["file"], desk.session.sent_fields["python"]
    other = Desk(file=scene_file.parse_scene_file("page", text.encode()))
    other.say(messages.Hello())
    other.rest()
    assert other.session.sent_fields["python"] == python
    assert other.session.sent_fields["facts"] == desk.session.sent_fields["facts"]
    assert other.session.sent_fields["numbers"] == desk.session.sent_fields["numbers"]
    other.say(messages.SetStart(x=0.2, v=0.0))  # names go on where they were
    assert len(set(other.lines)) == len(other.lines)


@pytest.mark.parametrize("panel", SIZES)
def test_axes_without_sensible_limits_are_refused_and_the_page_goes_on(desk, panel):
    for pair in ((-1e308, 1e308), (-1.7e308, 0.0), (0.0, 1e308), (-1e101, 1.0)):
        told = desk.say(messages.ZoomPanel(panel=panel, x=pair, y=pair, number=7))
        assert len(complaints(told)) == 1 and told[-1] == {"kind": "answer", "number": 7}
    told = desk.say(messages.ZoomPanel(panel=panel, x=(-1.0, 2.0), number=8))
    assert [one["kind"] for one in told] == ["picture", "answer"] and told[0]["x"] == [-1.0, 2.0]


def test_a_picture_that_cannot_be_drawn_is_one_line_and_the_page_goes_on(desk, monkeypatch, capsys):
    plain = page_screen.DRAW_FUNCTIONS["trace"]

    def fails_when_narrow(ax, *parts):
        plain(ax, *parts)
        if desk.session.screen.limits.get("trace"):
            raise RuntimeError("no such picture")

    monkeypatch.setitem(page_screen.DRAW_FUNCTIONS, "trace", fails_when_narrow)
    told = desk.say(messages.ZoomPanel(panel="trace", x=(0.0, 1.0), number=3))
    assert complaints(told) == ["the trace cannot be drawn: no such picture"]
    assert [one["kind"] for one in told] == ["told", "picture", "answer"]  # with the limits that it had at first
    assert "RuntimeError: no such picture" in capsys.readouterr().err

    def fails(ax, *parts):
        raise ValueError("no picture at all")

    monkeypatch.setitem(page_screen.DRAW_FUNCTIONS, "trace", fails)
    desk.session.screen.invalidate()
    told = desk.say(messages.ZoomPanel(panel="plane", number=4))
    assert len(complaints(told)) == 1 and told[-1] == {"kind": "answer", "number": 4}
    assert {one["panel"] for one in told if one["kind"] == "picture"} == {"portrait", "diagram", "plane"}
    assert [one["kind"] for one in desk.say(messages.StopTasks(number=5))] == [
        "answer"
    ]  # it is not tried again and again


def test_an_error_that_nobody_expects_is_answered(desk, monkeypatch, capsys):
    def fails(*given):
        raise RuntimeError("a fault\nof ours")

    with monkeypatch.context() as patch:
        patch.setattr(type(desk.session), "_select", fails)
        told = desk.say(messages.Select(of="branch_1", number=3))
        assert complaints(told) == ["a fault of ours"] and told[-1] == {"kind": "answer", "number": 3}
        patch.setattr(type(desk.session), "_send_fields", fails)
        told = desk.say(messages.StopTasks(number=4))
        assert complaints(told) == ["a fault of ours"] and told[-1] == {"kind": "answer", "number": 4}
    assert "RuntimeError: a fault" in capsys.readouterr().err
    assert desk.say(messages.StopTasks(number=5))[-1] == {"kind": "answer", "number": 5}


def test_every_message_is_answered(desk):
    """A small draw of `python -m tests.explorer_fuzz`: odd numbers, names and texts, cut messages, wrong kinds."""
    assert draw(desk, 250, 58, CHEAP) > 100


def test_numbers_that_json_has_not_are_null():
    assert messages.encode_record({"a": [float("inf"), (1.5, float("nan"))], "b": "NaN"}) == (
        '{"a": [null, [1.5, null]], "b": "NaN"}'
    )
