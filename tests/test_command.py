"""The command line: what it writes, what it refuses, and that it leaves nothing half-written."""

import io
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.output import atomic_write
from jaxvibro.studies import command, jax_settings, scene_file, scene_template, schema
from jaxvibro.studies.run import SUFFIXES

ROOT = Path(__file__).parents[1]
SCENE_FILE = ROOT / "scenes" / "branches.toml"
QUICK = [f"sweep.{key}=5" for key in ("count", "settle", "keep")] + ["attractors.starts=5"]
QUICK += ["branch.bounds=[1.9, 2.1]", "branch.settle=30"]


def called(*arguments):
    """The exit code of a command line."""
    return command.main([str(one) for one in arguments])


def quick(out, *arguments, scene=SCENE_FILE):
    """The same for a small run of a scene file."""
    changes = [word for change in QUICK for word in ("--set", change)] if scene == SCENE_FILE else []
    return called("run", scene, "--out", out, *changes, *arguments)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of a small run of figure 4, and its summary."""
    out = tmp_path_factory.mktemp("out")
    return out, jv.run(SCENE_FILE, out, QUICK, force=True)


def test_a_run_writes_picture_data_and_table(done):
    out, (summary, table) = done[0], (done[1].summary, done[1].table)
    assert {one.name for one in out.iterdir()} == {"branches.png", "branches.nc", "branches.txt"}
    assert summary["files"] == {kind: str(out / f"branches{end}") for kind, end in SUFFIXES.items()}
    assert (out / "branches.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "branches.txt").read_text() == table
    assert all(word in table for word in ("sweep of amplitude", "down", "up", "attractors at amplitude = 4.65", "P111"))


def test_the_data_hold_sweep_attractors_and_job(done):
    out, told = done[0], done[1].summary
    with xr.open_dataset(out / "branches.nc", engine="scipy") as data:
        sizes = {"step": 5, "leg": 2, "period": 5, "attractor": len(told["attractors"])}
        assert {key: data.sizes[key] for key in sizes} == sizes
        assert data["leg"].values.tolist() == ["down", "up"]
        np.testing.assert_array_equal(data["amplitude"].sel(leg="down"), np.linspace(6.0, 0.0, 5))
        assert (data["status"].values == 0).all()
        assert data["attractor_label"].values.tolist() == [one["label"] for one in told["attractors"]]
        job = tomllib.loads(data.attrs["job"])
    assert scene_file.parse_tables(job) == scene_file.read_scene_file(SCENE_FILE, QUICK)


def test_legs_side_by_side_are_the_sweeps_they_stand_for(done):
    file = scene_file.read_scene_file(SCENE_FILE, QUICK)
    with xr.open_dataset(done[0] / "branches.nc", engine="scipy") as data:
        for leg in file.sweep.legs:
            start = jv.State(leg.start.x, leg.start.v)
            alone = jv.sweep(file.scene.make(), "amplitude", file.sweep.values(leg), start, settle=5, keep=5)
            np.testing.assert_allclose(data["x"].sel(leg=leg.name), alone["x"], atol=1e-9)


def test_json_is_all_that_stdout_gets_and_gives_the_job_back(tmp_path, capsys):
    assert quick(tmp_path, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert msgspec.convert(told["job"], schema.SceneFile) == scene_file.read_scene_file(SCENE_FILE, QUICK)
    assert all(Path(path).exists() for path in told["files"].values())
    assert {one["leg"] for one in told["stretches"]} == {"down", "up"}
    assert sum(one["count"] for one in told["stretches"]) == 10
    assert abs(sum(one["share"] for one in told["attractors"]) - 1) < 1e-12
    assert told["seconds"] > 0 and told["version"] == jv.__version__


def test_set_changes_the_job(tmp_path, capsys):
    assert quick(tmp_path, "--json", "--set", "restitution=0.6", "--set", "scene.damping = 0.07") == 0
    scene = json.loads(capsys.readouterr().out)["job"]["scene"]
    assert (scene["restitution"], scene["damping"], scene["frequency"]) == (0.6, 0.07, 2.1)


def test_a_run_says_where_and_shows_progress_on_stderr(tmp_path, capsys):
    assert quick(tmp_path) == 0
    out, err = capsys.readouterr()
    assert str(tmp_path / "branches.png") in out and "P111" in out
    assert "sweep: 100%" in err and "attractors: 100%" in err


def test_nothing_is_overwritten_without_force(tmp_path, capsys):
    (tmp_path / "branches.nc").write_text("mine")
    assert quick(tmp_path) == 2
    assert "branches.nc already exists; --force overwrites it" in capsys.readouterr().err
    assert (tmp_path / "branches.nc").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1
    assert quick(tmp_path, "--force") == 0
    assert (tmp_path / "branches.nc").read_bytes().startswith(b"CDF")


def test_a_run_never_overwrites_its_own_scene(tmp_path, capsys):
    scene = tmp_path / "mine.txt"
    scene.write_bytes(SCENE_FILE.read_bytes())
    assert called("run", scene, "--out", tmp_path, "--force") == 2
    assert "mine.txt is a folder or the scene file" in capsys.readouterr().err
    assert scene.read_bytes() == SCENE_FILE.read_bytes()


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (OSError(28, "No space left"), 2)])
@pytest.mark.parametrize("where", ["write", "replace"])
def test_an_interrupted_write_leaves_all_as_it_was(tmp_path, monkeypatch, capsys, error, code, where):
    before = {name: (tmp_path / name).write_text("mine") for name in ("branches.png", "branches.nc", "branches.txt")}
    opened = []

    class Halfway(io.FileIO):
        def write(self, content):
            super().write(content[: len(content) // 2])
            if len(opened) == 2:
                raise error

    def halfway(*given):
        if where == "replace":
            raise error
        opened.append(given)
        return Halfway(*given)

    monkeypatch.setattr(*((atomic_write, "open") if where == "write" else (os, "replace")), halfway, raising=False)
    assert quick(tmp_path, "--force") == code
    line = capsys.readouterr().err.splitlines()[-1]
    assert len(line) < 300 and (code == 130 or re.search(r"/branches\.\w+: No space left", line))
    assert {one.name for one in tmp_path.iterdir()} == set(before)
    assert all((tmp_path / name).read_text() == "mine" for name in before)


def test_a_scene_that_asks_nothing_is_followed_from_rest(tmp_path, capsys):
    scene = tmp_path / "plain.toml"
    scene.write_text("[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\n")
    assert quick(tmp_path / "out", "--json", scene=scene) == 0
    (one,) = json.loads(capsys.readouterr().out)["stretches"]
    assert (one["leg"], one["periods"]) == ("rest", 1)


def test_init_writes_a_scene_that_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert called("init") == 0
    assert scene_file.read_scene_file("scene.toml") == msgspec.structs.replace(
        scene_file.read_scene_file(SCENE_FILE, TO_STARTER), branch=None
    )
    assert called("init") == 2
    assert "scene.toml already exists" in capsys.readouterr().err
    assert called("init", "--force", "scene.toml") == 0
    assert scene_template.SCENE_TEMPLATE.count("#") > 20


TO_STARTER = [
    "scene.amplitude=3.0",
    *("sweep.count=301", "sweep.settle=200", "sweep.keep=50"),
    *("attractors.starts=50", "attractors.at.amplitude=3.0"),
]

# Arguments after `run SCENE` (or, beginning with a command, all of them), and what the one line must name.
BAD = [
    (["--set", "scene.amplitud=3"], "scene.amplitud: is not a key here"),
    (["--set", "amplitud=3"], "amplitud: is not a key here"),
    (["--set", "amplitude"], "amplitude: must be KEY=VALUE"),
    (["--set", "amplitude=three"], "scene.amplitude: must be KEY=VALUE"),
    (["--set", "amplitude='3'"], "scene.amplitude: must be a number"),
    (["--set", "amplitude=nan"], "scene.amplitude: must be finite"),
    (["--set", "frequency=0"], "scene.frequency: must be greater than 0"),
    (["--set", "damping=-1"], "scene.damping: must not be negative"),
    (["--set", "left.restitution=1.5"], "scene.left.restitution: must lie between 0 and 1"),
    (["--set", "right.position=-2"], "scene.right.position: must lie to the right of left.position"),
    (["--set", "right.motion.amplitude=3"], "scene.right.motion: walls must not touch"),
    (["--set", "sweep.count=0"], "sweep.count: must be a whole number"),
    (["--set", "sweep.count=1000000", "--set", "sweep.keep=1000000"], "sweep.keep: "),
    (["--set", "sweep.parameter='force'"], "sweep.parameter: must be a parameter of the scene"),
    (["--set", "sweep.legs.0.start.x=1.5"], "sweep.legs[0].start.x: must lie between the walls"),
    (["--set", "sweep.legs.5.name='a'"], "sweep.legs"),
    (["--set", "attractors.at.mass=1"], "attractors.at.mass: is not a parameter"),
    (["--set", "orbits.max_period=33"], "orbits.max_period: must be a whole number <= 32; got 33"),
    (["--set", "orbits.at.mass=1"], "orbits.at.mass: is not a parameter"),
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
    (["init", "FILE/below"], "taken is not a folder"),
    (["init", "no/where.toml"], "no is not a folder"),
    (["init", "FILE"], "already exists"),
]


@pytest.mark.parametrize(("arguments", "says"), BAD, ids=lambda one: " ".join(one) if isinstance(one, list) else "")
def test_bad_command_lines_get_one_line(tmp_path, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("= no TOML")
    whole = not arguments or arguments[0] in ("run", "walk", "init")
    words = [word.replace("FILE", "taken") for word in arguments]
    assert called(*([] if whole else ["run", SCENE_FILE]), *words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert says in err
    assert [one.name for one in tmp_path.iterdir()] == ["taken"]


def test_a_folder_that_cannot_be_written_to_is_refused_before_any_work(tmp_path, capsys, monkeypatch):
    # root may write everywhere, so the system's answer is given here
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert quick(tmp_path / "out") == 2
    assert "cannot be written to" in capsys.readouterr().err


def started(*arguments, **environment):
    """A fresh process of the command, jax's settings being its own."""
    words = [sys.executable, "-m", "jaxvibro", *map(str, arguments)]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    return subprocess.run(words, cwd=ROOT, env=plain | environment, capture_output=True, text=True, timeout=300)


def test_help_and_version_load_nothing_heavy():
    code = (
        "import sys; from jaxvibro.studies import command; command.main(['run', '--help']); print(sorted(sys.modules))"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "--force" in shown
    assert not {"jax", "numpy", "matplotlib", "xarray", "msgspec"} & set(re.findall(r"'(\w+)'", shown))
    assert started("--version").stdout.strip() == jv.__version__


def test_the_command_itself_turns_double_precision_on_and_keeps_compiled_code(tmp_path):
    scene = tmp_path / "plain.toml"
    scene.write_text("[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\n")
    ended = started("run", scene, "--out", tmp_path / "out", "--json", XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["stretches"][0]["periods"] == 1
    (place,) = (tmp_path / "cache" / "jaxvibro").iterdir()
    assert place.stat().st_mode & 0o777 == 0o700 and any(place.iterdir())


def test_a_cache_that_cannot_be_made_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert jax_settings.user_cache_folder() is None
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert jax_settings.user_cache_folder() == tmp_path / ".cache" / "jaxvibro" / jax_settings.processor_fingerprint()
    assert jax_settings.user_cache_folder().stat().st_mode & 0o777 == 0o700
    for mode, found in ((0o777, None), (0o1777, jax_settings.user_cache_folder())):
        tmp_path.chmod(mode)
        assert jax_settings.user_cache_folder() == found
    tmp_path.chmod(0o700)
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    assert jax_settings.user_cache_folder() is None and not (tmp_path / "nobody").exists()


def test_the_explorers_token_stays_and_is_made_anew_where_it_is_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = jax_settings.load_page_token()
    assert re.fullmatch(r"[\w-]{43}", first) and jax_settings.load_page_token() == first
    (file,) = (tmp_path / "jaxvibro").glob("*token*")
    assert file.stat().st_mode & 0o777 == 0o600
    for damage in (b"", b"half", b"\xff" * 43):  # as a process that was killed while it wrote would leave it
        file.write_bytes(damage)
        again = jax_settings.load_page_token()
        assert again not in (first, None) and jax_settings.load_page_token() == again
    assert list((tmp_path / "jaxvibro").glob("*token*")) == [file]


def test_of_two_processes_that_make_a_token_the_first_wins(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plain, others = os.link, []

    def late(part, place):
        monkeypatch.setattr(os, "link", plain)
        others.append(jax_settings.load_page_token())
        plain(part, place)

    monkeypatch.setattr(os, "link", late)
    assert [jax_settings.load_page_token()] == others and others[0] is not None
