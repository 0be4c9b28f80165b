"""The command line: what it writes, what it refuses, and that it leaves nothing half-written."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.studies.jax_settings import load_page_token, user_cache_folder
from tests.properties.test_output import StopAt
from tests.scene_files import SCENES, call_command

ROOT = Path(__file__).parents[1]
SCENE_FILE = SCENES / "branches.toml"
PLAIN = "[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\n"
QUICK = [f"sweep.{key}=5" for key in ("count", "settle", "keep")] + ["attractors.starts=5"]
LEGS = ["down", "up"]
QUICK += ["branch.bounds=[1.9, 2.1]", "branch.settle=30"]


def quick(out, *arguments, scene=SCENE_FILE):
    """Return the exit code of a small run of a scene file."""
    changes = [word for change in QUICK for word in ("--set", change)] if scene == SCENE_FILE else []
    return call_command("run", scene, "--out", out, *changes, *arguments)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of a small run of figure 4, and its summary."""
    out = tmp_path_factory.mktemp("out")
    return out, jv.run(SCENE_FILE, out, QUICK, force=True)


def test_a_run_writes_picture_data_and_table(done):
    out, summary, table = done[0], done[1].summary, done[1].table
    assert summary["files"] == {
        kind: str(out / f"branches.{end}") for kind, end in (("picture", "png"), ("data", "nc"), ("table", "txt"))
    }
    words = "sweep of amplitude", "down", "up", "attractors at amplitude = 4.65", "P111"
    assert (out / "branches.txt").read_text() == table and all(word in table for word in words)
    data, labels = jv.load_data(out / "branches.nc"), [attractor["label"] for attractor in summary["attractors"]]
    sizes = {"step": 5, "leg": 2, "period": 5, "attractor": len(labels)}
    assert {key: data.sizes[key] for key in sizes} == sizes and data["leg"].values.tolist() == ["down", "up"]
    np.testing.assert_array_equal(data["amplitude"].sel(leg="down"), np.linspace(6.0, 0.0, 5))
    assert (data["status"].values == 0).all() and data["attractor_label"].values.tolist() == labels


def test_legs_side_by_side_are_the_sweeps_they_stand_for(done):
    data, scene = jv.load_data(done[0] / "branches.nc"), jv.load_scene(SCENE_FILE)
    for leg, start in (("down", jv.State(0.9, -1.1)), ("up", jv.State(0.0, 0.0))):
        alone = jv.sweep(scene, "amplitude", data["amplitude"].sel(leg=leg).values, start, settle=5, keep=5)
        np.testing.assert_allclose(data["x"].sel(leg=leg), alone["x"], atol=1e-9)


def test_json_is_all_that_stdout_gets(tmp_path, capsys):
    assert quick(tmp_path, "--json", "--set", "restitution=0.6", "--set", "scene.damping = 0.07") == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert all(Path(path).exists() for path in summary["files"].values())
    assert {stretch["leg"] for stretch in summary["stretches"]} == {"down", "up"}
    assert sum(stretch["count"] for stretch in summary["stretches"]) == 10
    assert abs(sum(attractor["share"] for attractor in summary["attractors"]) - 1) < 1e-12
    assert summary["seconds"] > 0 and summary["version"] == jv.__version__
    scene = summary["job"]["scene"]
    assert (scene["restitution"], scene["damping"], scene["frequency"]) == (0.6, 0.07, 2.1)
    assert "sweep: 100%" in err and "attractors: 100%" in err
    (tmp_path / "plain.toml").write_text(PLAIN)
    assert quick(tmp_path, "--json", scene=tmp_path / "plain.toml") == 0
    (stretch,) = json.loads(capsys.readouterr().out)["stretches"]  # without a study, the motion from rest
    assert (stretch["leg"], stretch["periods"]) == ("rest", 1)


def test_nothing_is_overwritten_without_force_and_the_scene_never_is(tmp_path, capsys):
    (tmp_path / "branches.nc").write_text("mine")
    assert quick(tmp_path) == 2
    assert "branches.nc already exists; --force overwrites it" in capsys.readouterr().err
    assert (tmp_path / "branches.nc").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1
    assert quick(tmp_path, "--force") == 0
    out, scene = capsys.readouterr().out, tmp_path / "mine.txt"
    assert (tmp_path / "branches.nc").read_bytes().startswith(b"CDF")
    assert str(tmp_path / "branches.png") in out and "P111" in out
    scene.write_text(PLAIN)
    assert call_command("run", scene, "--out", tmp_path, "--force") == 2
    assert "mine.txt is a folder or the scene file" in capsys.readouterr().err and scene.read_text() == PLAIN


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (OSError(28, "No space left"), 2)])
@pytest.mark.parametrize("calls", [1, 3], ids=["second write", "first renaming"])
def test_an_interrupted_write_leaves_all_as_it_was(tmp_path, capsys, error, code, calls):
    before = {name: (tmp_path / name).write_text("mine") for name in ("branches.png", "branches.nc", "branches.txt")}
    with StopAt(calls, error).patch():
        assert quick(tmp_path, "--force") == code
    line = capsys.readouterr().err.splitlines()[-1]
    assert len(line) < 300 and (code == 130 or re.search(r"/branches\.\w+: No space left", line))
    assert {one.name for one in tmp_path.iterdir()} == set(before)
    assert all((tmp_path / name).read_text() == "mine" for name in before)


def test_init_writes_a_scene_that_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call_command("init") == 0
    assert jv.load_scene("scene.toml").numbers == jv.load_scene(SCENE_FILE).replace(amplitude=3.0).numbers
    assert call_command("init") == 2
    assert "scene.toml already exists" in capsys.readouterr().err
    assert call_command("init", "--force", "scene.toml") == 0
    assert Path("scene.toml").read_text().count("#") > 20
    small = [word for change in QUICK[:4] for word in ("--set", change)]
    assert call_command("run", "scene.toml", "--out", tmp_path / "out", *small, "--json") == 0
    job = json.loads(capsys.readouterr().out.split("\n", 1)[1])["job"]
    assert job["attractors"]["at"] == {"amplitude": 3.0} and [leg["name"] for leg in job["sweep"]["legs"]] == LEGS


# Arguments after `run SCENE` (or, beginning with a command, all of them), and what the one line must name.
BAD = [
    (["--set", "scene.amplitud=3"], "scene.amplitud: is not a key here"),
    (["--set", "amplitud=3"], "amplitud: is not a key here"),
    (["--set", "amplitude"], "amplitude: must be KEY=VALUE"),
    (["--set", "amplitude=three"], "scene.amplitude: must be KEY=VALUE"),
    (["--set", "right.position=-2"], "scene.right.position: must lie to the right of left.position"),
    (["--set", "sweep.count=1000000", "--set", "sweep.keep=1000000"], "sweep.keep: "),
    (["--set", "sweep.legs.5.name='a'"], "sweep.legs"),
    (["--set", "attractors.at.mass=1"], "attractors.at.mass: is not a parameter"),
    (["--set", ""], "must be KEY=VALUE"),
    (["--set"], "--set: expected one argument"),
    (["--st", "amplitude=3"], "unrecognized arguments: --st"),
    (["another.toml"], "unrecognized arguments: another.toml"),
    (["--out", "FILE"], "is not a folder"),
    (["--out", "FILE/below"], "cannot be written to"),
    (["--json=yes"], "--json: ignored explicit argument"),
    (["run"], "required: SCENE"),
    (["run", "missing.toml"], "missing.toml: No such file or directory"),
    (["run", "."], ".: Is a directory"),
    (["run", "FILE"], "taken: must be a TOML file"),
    (["walk"], "invalid choice: 'walk'"),
    ([], "required: COMMAND"),
    (["--" + 2000 * "c"], "unrecognized arguments: --ccc"),
    (["init", "FILE/below"], "taken is not a folder"),
    (["init", "no/where.toml"], "no is not a folder"),
    (["init", "FILE"], "already exists"),
]


@pytest.mark.parametrize(
    ("arguments", "says"), BAD, ids=lambda one: " ".join(one)[:60] if isinstance(one, list) else ""
)
def test_bad_command_lines_get_one_line(tmp_path, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("= no TOML")
    whole = not arguments or arguments[0] in ("run", "walk", "init")
    words = [word.replace("FILE", "taken") for word in arguments]
    assert call_command(*([] if whole else ["run", SCENE_FILE]), *words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and len(err) < 320
    assert says in err
    assert [one.name for one in tmp_path.iterdir()] == ["taken"]


def started(*arguments, **environment):
    """A fresh process of the command, jax's settings being its own."""
    words = [sys.executable, "-m", "jaxvibro", *map(str, arguments)]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    return subprocess.run(words, cwd=ROOT, env=plain | environment, capture_output=True, text=True, timeout=300)


def test_help_and_version_load_nothing_heavy():
    code = "import sys, jaxvibro; dir(jaxvibro); from jaxvibro.studies import command; "
    code += "command.main(['run', '--help']); print(sorted(sys.modules))"
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "--force" in shown
    assert not {"jax", "numpy", "matplotlib", "xarray", "msgspec"} & set(re.findall(r"'(\w+)'", shown))
    assert started("--version").stdout.strip() == jv.__version__


def test_the_command_itself_turns_double_precision_on_and_keeps_compiled_code(tmp_path):
    scene = tmp_path / "plain.toml"
    scene.write_text(PLAIN)
    ended = started("run", scene, "--out", tmp_path / "out", "--json", XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["stretches"][0]["periods"] == 1
    (place,) = (tmp_path / "cache" / "jaxvibro").iterdir()
    assert place.stat().st_mode & 0o777 == 0o700 and any(place.iterdir())


def test_a_cache_folder_that_cannot_be_made_is_left_out(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert user_cache_folder() is None
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    folder = user_cache_folder()
    assert folder.parent == tmp_path / ".cache" / "jaxvibro" and folder.stat().st_mode & 0o777 == 0o700
    for mode, expected in ((0o777, None), (0o1777, folder), (0o700, folder)):
        tmp_path.chmod(mode)
        assert user_cache_folder() == expected
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    assert user_cache_folder() is None and not (tmp_path / "nobody").exists()


def test_the_token_of_the_explorer_persists_and_is_replaced_if_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = load_page_token()
    assert re.fullmatch(r"[\w-]{43}", first) and load_page_token() == first
    (file,) = (tmp_path / "jaxvibro").glob("*token*")
    assert file.stat().st_mode & 0o777 == 0o600
    for damage in (b"", b"half", b"\xff" * 43):  # as a process that was killed while it wrote would leave it
        file.write_bytes(damage)
        again = load_page_token()
        assert again not in (first, None) and load_page_token() == again
    assert list((tmp_path / "jaxvibro").glob("*token*")) == [file]


def test_the_first_of_two_processes_that_make_a_token_wins(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    link, others = os.link, []

    def late(part, place):
        monkeypatch.setattr(os, "link", link)
        others.append(load_page_token())
        link(part, place)

    monkeypatch.setattr(os, "link", late)
    assert [load_page_token()] == others and others[0] is not None
