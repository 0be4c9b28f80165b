"""The table [explore] of a scene file: what a run of it asks for, tells, writes and draws."""

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.branches.diagram import Diagram
from jaxvibro.studies import command, scene_file, scene_file_studies
from tests.scene_files import SCENE, check_refusal, each_of

SCENES = Path(__file__).parents[1] / "scenes"
EXPLORE = """
[explore]
parameter = "amplitude"
bounds = [0.0, 4.0]
at = {damping = 0.06}
max_period = 2
seed = 3
budget = 7
"""
REASON = "all that was found has been followed"


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(2.0, 2.1, 0.06, 0.7, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 4.0))


@pytest.fixture
def explored(branch, tmp_path, monkeypatch):
    """What a file that asks to explore gives: its folder and its summary, what was `Found`, what `explore` was asked.

    `explore` itself is left out: it has tests of its own, which take longer.
    """
    asked, found, plain = [], [], scene_file_studies.run_studies

    def explore(scene, name, bounds, **given):
        given.pop("progress")(1)
        asked.append((scene, name, bounds, given))
        return Diagram(name, bounds, scene, (branch,), (), True, REASON, {})

    monkeypatch.setattr(scene_file_studies, "explore", explore)
    monkeypatch.setattr(
        sys.modules[jv.run.__module__], "run_studies", lambda *each: found.append(plain(*each)) or found[0]
    )
    (tmp_path / "all.toml").write_text(SCENE + EXPLORE)
    done = jv.run(tmp_path / "all.toml", tmp_path / "out")
    return tmp_path / "out", done, found[0], asked


def test_what_is_asked_goes_to_explore(explored):
    ((scene, name, bounds, given),) = explored[3]
    assert (name, bounds, given) == (
        "amplitude",
        (0.0, 4.0),
        {"max_period": 2, "seed": 3, "budget": 7, "max_seconds": None},
    )
    assert [float(scene.parameter(key)) for key in ("amplitude", "frequency", "damping")] == [4.65, 2.1, 0.06]


def test_branches_are_told_and_drawn_as_those_of_a_branch(explored, branch):
    out, done, found, _ = explored
    assert (found.branches, found.diagram_branches, found.diagram_parameter) == ((branch,), (branch,), "amplitude")
    assert float(found.diagram_scene.damping) == 0.06
    (told,) = done.summary["branches"]
    assert [each["kind"] for each in told["special"]] == [each.kind for each in branch.special]
    assert done.summary["explored"] == {"complete": True, "reason": REASON}
    lines = [" ".join(line.split()) for line in done.table.splitlines()]
    start = "from many starts at damping = 0.06, max_period 2 (seed 3): 1"
    place = lines.index(f"branches of periodic orbits for amplitude from 0 to 4, {start}")
    assert lines[place + 1] == REASON
    for one in branch.special:
        assert sum(line.startswith(f"{one.kind} {one.value:.12g} {one.label}") for line in lines) == 1
    assert {one.name for one in out.iterdir()} == {"all.png", "all.nc", "all.txt"}
    with xr.open_dataset(out / "all.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data["branch_value"], branch.values)


def test_what_explore_refuses_is_told_with_the_files_key(tmp_path, monkeypatch, capsys):
    def explore(*given, **settings):
        raise jv.ArgumentError("bounds", "must hold some value", [0.0, 4.0])

    monkeypatch.setattr(scene_file_studies, "explore", explore)
    (tmp_path / "all.toml").write_text(SCENE + EXPLORE)
    assert command.main(["run", str(tmp_path / "all.toml"), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "jaxvibro: explore.bounds: must hold some value; got [0.0, 4.0]"
    assert not (tmp_path / "out").exists()


@pytest.fixture
def file(tmp_path):
    (tmp_path / "all.toml").write_text(SCENE + EXPLORE)
    return tmp_path / "all.toml"


def test_an_explore_has_defaults_and_survives_writing(file, tmp_path):
    asked = scene_file.read_scene_file(file)
    assert asked.branch_table is asked.explore and asked.explore.budget == 7
    scene_file.write_scene_file(asked, tmp_path / "copy.toml")
    assert scene_file.read_scene_file(tmp_path / "copy.toml") == asked
    text = SCENE + EXPLORE[: EXPLORE.index("at = {")]
    file.write_text(text)
    asked = scene_file.read_scene_file(file).explore
    assert (asked.parameter, asked.bounds, asked.at) == ("amplitude", (0.0, 4.0), {})
    assert (asked.max_period, asked.seed, asked.budget) == (8, 0, None)


def test_a_locus_may_follow_what_was_explored(file):
    changes = ["locus.parameters=['amplitude', 'damping']", "locus.bounds={amplitude=[0, 9], damping=[0.01, 0.2]}"]
    asked = scene_file.read_scene_file(file, changes)
    assert asked.locus.bounds["damping"] == (0.01, 0.2) and asked.branch is None
    with pytest.raises(
        jv.ArgumentError, match=r"^locus\.bounds\.damping: must contain the damping of \[explore\], 0\.06; got"
    ):
        scene_file.read_scene_file(file, [*changes, "locus.bounds.damping=[0.01, 0.055]"])


ALLOWED = "(parameter, bounds, at, max_period, seed, budget, max_seconds)"
# The change to the file, the key that the error names, and what it says.
BAD = [
    ("explore = 3", "explore", "must be a table; got 3"),
    ("explore.starts = 3", "explore.starts", f"is not a key here {ALLOWED}; got 3"),
    (
        "branch = {parameter='amplitude', bounds=[0, 6]}",
        "explore",
        "must not be given together with [branch]; got 'amplitude'",
    ),
    ("explore.parameter = 'force'", "explore.parameter", "must be a parameter of the scene"),
    ("explore.bounds = [4, 0]", "explore.bounds", "two finite numbers, the first smaller; got [4.0, 0.0]"),
    ("explore.bounds = [0, nan]", "explore.bounds", "two finite numbers, the first smaller; got [0.0, nan]"),
    ("explore.bounds = 4", "explore.bounds", "must be a list; got 4"),
    ("explore.at.force = 1", "explore.at.force", "is not a parameter of this scene, perhaps amplitude ("),
    ("explore.at.damping = -1", "explore.at.damping", "must not be negative; got -1.0"),
    ("explore.max_period = 0", "explore.max_period", "must be a whole number >= 1; got 0"),
    ("explore.max_period = 33", "explore.max_period", "must be a whole number <= 32; got 33"),
    ("explore.seed = -1", "explore.seed", "must be a whole number >= 0; got -1"),
    ("explore.budget = 0", "explore.budget", "must be a whole number >= 1; got 0"),
    ("explore.budget = 'all'", "explore.budget", "must be a whole number; got 'all'"),
]


@each_of(BAD)
def test_a_bad_explore_is_one_clear_line(file, change, key, said):
    check_refusal(file, change, key, said)
