"""The benchmarks: rows and their page, the yardstick's trial, and all of `make bench` in small."""

import os
import re
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import jaxvibro as jv
from benchmarks import (
    harness,
    heyoka_batch,
    heyoka_scalar,
    kernel,
    limit,
    ours,
    own_force,
    page,
    pictures,
    scenes,
    scipy_ivp,
    truth,
)
from benchmarks.rows import Row, Size, Topic
from benchmarks.sides import OURS
from benchmarks.work import CUBIC, draw
from continuation.hostcall import compile_at_once, host_jit

from .sources import ROOT

PAGE = ROOT / "docs" / "benchmarks.md"
PICTURE = re.compile(r"^!\[[^\]]+\]\((.+)\)$", re.MULTILINE)
YARDSTICK = '''"""A stand-in for a yardstick."""
import numpy as np


def load():
    return lambda states, periods=1: np.full((len(states), 2), {value})
'''


def test_a_reduced_measurement_has_less_of_everything():
    small, whole, lists = Size(True), Size(False), [{1: np.zeros(2)}, {2: np.zeros(2)}, {3: np.zeros(2)}]
    assert [small.states(n) for n in (16, 1024)] == [4, 64] and small.rounds(9) == 2
    assert small.few(lists) == [lists[0], lists[2]] and whole.few(lists) == lists
    assert whole.states(1024) == 1024 and whole.rounds(9) == 9


def test_a_missed_goal_is_bold():
    rows = [
        Row("fast", "s", 2.0).of([1.0, 1.5, 2.0], "as it is"),
        Row("late", "s", 2.0).of([2, 3, 4]),
        Row("slow", "over ours", 8000, least=True).of(7000.0),
        Row("most", "over ours", 30, least=True).of([29, 30, 31]),
        Row("none", "s", 1),
        Row("free", "s").of(0.25),
    ]
    assert [row.kept for row in rows] == [True, False, False, True, None, None]
    assert page.asked_table(rows).splitlines()[2:] == [
        "| fast | s | at most 2 | 1.5 (1.25 to 1.75), as it is |",
        "| late | s | at most 2 | **3 (2.5 to 3.5)** |",
        "| slow | over ours | at least 8,000 | **7,000** |",
        "| most | over ours | at least 30 | 30 (29.5 to 30.5) |",
        "| none | s | at most 1 | not measured |",
        "| free | s | none | 0.25 |",
    ]


def test_only_the_text_between_the_marks_is_written(tmp_path):
    path = tmp_path / "page.md"
    page.write(path, {})
    path.write_text(path.read_text().replace("## Orbits\n", "## Orbits\n\nWords of ours.\n"))
    before = path.read_text()
    page.write(path, {"orbits": "first", "loci": "other"})
    page.write(path, {"orbits": "second"})
    begin, end = page.marks("orbits")
    assert path.read_text() == before.replace(f"{begin}\n{end}", f"{begin}\n\nsecond\n\n{end}").replace(
        "\n".join(page.marks("loci")), "\n\nother\n\n".join(page.marks("loci"))
    )
    path.write_text(before.replace(end, ""))
    with pytest.raises(ValueError, match="must each be there once"):
        page.write(path, {"orbits": "third"})
    assert "third" not in path.read_text()


def test_the_page_has_all_parts_and_pictures_and_names_no_folder():
    text = PAGE.read_text()
    assert {text.count(mark) for part in page.PARTS for mark in page.marks(part)} == {1}
    drawn = PICTURE.findall(text)
    assert len(drawn) == len(set(drawn)) >= 8
    assert [file for file in drawn if not (PAGE.parent / file).is_file()] == []
    assert re.findall(r"(?:^|[\s`(])/(?:home|tmp|work|root|usr|var)/\S*", text) == []


@pytest.mark.parametrize(
    "body, error",
    [
        (YARDSTICK.format(value="0.5"), None),
        (YARDSTICK.format(value="np.nan"), "it returned no finite numbers"),
        ("import os\nos.kill(os.getpid(), 4)\n", "stopped by SIGILL"),
    ],
)
def test_a_yardstick_is_tried_in_a_process_of_its_own(tmp_path, monkeypatch, body, error):
    monkeypatch.setattr(limit.shutil, "which", lambda name: name)
    (tmp_path / "limit.py").write_text(body)
    strobe, line = limit.found(str(tmp_path))
    assert str(tmp_path) not in line
    if error:
        assert strobe is None and error in line
    else:
        assert line == "its only kernel. A stand-in for a yardstick." and np.all(strobe(np.zeros((3, 3))) == 0.5)


def test_without_a_yardstick_nothing_is_compared():
    assert limit.found(None) == (None, limit.UNSET)
    assert limit.found("nowhere")[0] is None
    row = Row("nothing recorded", kernel.YARD, 3.5)
    assert kernel.compared(row, kernel.Work(), None, None, Size(True)).found is None


def test_calls_in_turn_are_measured_separately(monkeypatch):
    """The clock advances only in the calls."""
    now = [0.0]
    monkeypatch.setattr(harness.time, "process_time", lambda: now[0])

    def lasting(seconds):
        return lambda: now.__setitem__(0, now[0] + seconds)

    spent, ratios = harness.in_turn(lasting(0.5), harness.repeated(lasting(0.25), 6), 4)
    np.testing.assert_allclose(spent, [1.5] * 4)
    np.testing.assert_allclose(ratios, [3.0] * 4)
    np.testing.assert_allclose(harness.alone(lasting(2.0), 3), [2.0] * 3)


def test_functions_are_compiled_within_a_context_only():
    before = host_jit.max_evaluations
    with pytest.raises(KeyError), compile_at_once():
        assert host_jit.max_evaluations == 0
        raise KeyError
    assert host_jit.max_evaluations == before > 0


def test_our_maps_are_those_of_the_reference():
    states = draw(32)
    true = truth.find(states)
    for call, has_sides in (
        (ours.prepare_batch(states), True),
        (ours.prepare_batch(states, slots=0), False),
        (ours.prepare_vmap(states), False),
    ):
        ends, sides = ours.read(call())
        assert (sides is not None) == has_sides
        verdict = truth.judge(ends, sides, true)
        assert verdict.wrong == 0 and verdict.worst < 1e-11 and verdict.judged > 16


def test_all_methods_map_duffings_oscillator_as_the_reference_does():
    states = draw(16)  # a multiple of heyoka's lanes
    true = truth.duffing(states)
    assert true.judged.sum() > 8
    answers = [ours.read(ours.prepare_duffing(states, 1e-13)())]
    for strobe in (heyoka_batch.strobe, heyoka_scalar.strobe, scipy_ivp.strobe):
        answer = strobe(states, 1e-12, cubic=CUBIC)
        answers.append((answer.ends, answer.sides))
    for answer in answers:
        verdict = truth.judge(*answer, true)
        assert verdict.wrong == 0 and verdict.worst < 1e-9


def test_methods_are_compared_with_the_cheapest_of_ours_of_at_most_their_error():
    def judged(method, setting, own, error):
        timing = harness.Timing(np.array([own, own]), np.array([10.0, 10.0]), 0.0, None, None)
        side = harness.Side(method, setting, 4, None, None)
        return side, timing, truth.Verdict(4, 0, error, error, error)

    mine = [judged(OURS, "tol 1e-13", 10.0, 1e-13), judged(OURS, "tol 1e-06", 5.0, 1e-7)]
    others = [judged("SciPy DOP853", "a", 5000.0, 1e-6), judged("SciPy DOP853", "b", 9000.0, 1e-9)]
    more = [judged("heyoka, batch", "c", 30.0, 1e-15), judged("diffrax Dopri8", "d", 100.0, 1e-13)]
    diffrax, scipy, heyoka = own_force.rows(mine + others + more)
    assert (diffrax.found[0], scipy.found[0], heyoka.found) == (10.0, 900.0, None)
    assert scipy.kept and not diffrax.kept and heyoka.remark == own_force.UNLIKE


def test_the_share_of_full_steps_is_that_of_all_periods(monkeypatch):
    given_up, starts = iter([[0, 0, 0, 1], [0, 1, 1, 1], [0, 0, 0, 0]]), []

    def lean(scene, state):
        starts.append(np.asarray(state.x))
        return None, np.array(next(given_up), bool)

    monkeypatch.setattr(kernel, "fast", lean)
    work = kernel.Work(4, periods=3)
    assert kernel.in_full(work) == pytest.approx(4 / 12)
    last, _ = jv.strobe(*work.given, periods=2)
    np.testing.assert_array_equal(starts[2], last.x)


def test_the_scenes_and_the_work_are_of_their_kinds():
    for walls, moving, soft, force in scenes.KINDS:
        scene, state = scenes.given(walls, moving, soft, force, 8)
        assert (scene.force is not None) == bool(force)
        present = list(scene.walls.values())
        assert len(present) == walls and all(wall.soft == bool(soft) for wall in present)
        assert all((wall.motion is not None) == bool(moving) for wall in present)
        assert np.all(np.abs(state.x) <= (0.8 if moving else 1.0))
    for work in (kernel.Work(8), kernel.Work(8, walls=1), kernel.Work(8, moving=True)):
        scene, state = work.given
        assert (scene.left is None) == (work.walls == 1) and (scene.right.motion is not None) == work.moving
        assert state.x.shape == (8,) and np.all(np.isfinite(jv.strobe(scene, state)[0].x))


def test_pictures_are_drawn(tmp_path):
    rows = [Row("one", "s", 2.0).of([1.0, 1.5, 2.0]), Row("other", "s").of(3.0), Row("none", "s", 1)]
    pictures.bars(tmp_path / "bars.png", {"cold": rows, "warm": rows[:1]}, "time (s)", "title")
    panel = pictures.Panel("n", "ns", {"ours": [(1, (3.0, 2.0, 4.0)), (10, (1.0, 1.0, 1.0))]}, {"asked": 2.0})
    pictures.curves(tmp_path / "curves.png", [panel, panel._replace(scale="linear")], "title")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bars.png", "curves.png"]
    topic = Topic("orbits", rows, ("| a |",), ("said",), {"bars.png": ("what", partial(print))})
    text = page.body(topic)
    assert text.startswith("![what](bars.png)\n\n| quantity |") and text.endswith("| a |\n\n- said")


@pytest.mark.parametrize("parts", [("loci",), page.PARTS], ids=["one part", "all parts"])
def test_a_reduced_measurement_runs(tmp_path, parts):
    (tmp_path / "limit.py").write_text(YARDSTICK.format(value="0.5"))
    plain = {name: text for name, text in os.environ.items() if not name.startswith("JAX_")}
    words = ["-m", "benchmarks.run", "--quick", "--limit", str(tmp_path), "--out", str(tmp_path / "out")]
    words += ["--part", *parts] if len(parts) == 1 else []
    done = subprocess.run([sys.executable, *words], cwd=ROOT, env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "out" / "benchmarks.md").read_text()
    for part in parts:
        begin, end = page.marks(part)
        assert len(text.split(begin)[1].split(end)[0]) > 100, part
    drawn, stored = PICTURE.findall(text), PICTURE.findall(PAGE.read_text())
    assert set(drawn) <= set(stored) and all((tmp_path / "out" / file).stat().st_size > 10_000 for file in drawn)
    assert str(tmp_path) not in text
    if len(parts) > 1:
        assert drawn == stored
        assert "not measured" not in text.replace("not measured, no other method is as accurate", "")
        assert set(re.findall(r"^\| ([^|]+) \|", text, re.M)) >= {row.what for row in kernel.ASKED}
