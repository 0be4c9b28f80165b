"""Properties of scene files: of each table of a study, and of hostile texts of many kinds."""

import io
import json
import time
import tomllib
from contextlib import redirect_stderr
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.studies.scene_file import parse_tables, read_scene_file, write_scene_file
from tests.kinds import KINDS
from tests.mutations import CHANGES, mutate
from tests.mutations import KINDS as MUTATIONS
from tests.scene_files import SCENES, call_command
from tests.tiers import generator, of_numbers

SCENE = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
SLOWEST = 2.0  # seconds of processor time
PLANE = {"parameters": ["amplitude", "frequency"], "bounds": {"amplitude": [0.1, 9.0], "frequency": [0.5, 9.0]}}
START = {"x": 0.0, "v": 0.0}


@dataclass(frozen=True)
class StudyKind:
    """A table of a scene file, with all its keys; others: tables that it needs."""

    name: str
    table: dict
    others: dict = field(default_factory=dict)


@dataclass(frozen=True)
class TextKind:
    """A kind of mutated text."""

    name: str


BRANCH = {"parameter": "amplitude", "bounds": [0.1, 9.0], "start": START, "at": {"damping": 0.06}}
BRANCH |= {"settle": 200, "max_period": 1, "largest_step": 0.1, "max_seconds": 9999.0}
LEGS = [
    {"name": name, "from": low, "to": high, "start": START} for name, low, high in (("up", 2.0, 3.0), ("b", 3.0, 2.0))
]
STUDIES = {
    "scene": {},
    "sweep": {"parameter": "amplitude", "count": 5, "settle": 5, "keep": 5, "legs": LEGS, "max_seconds": 9999.0},
    "attractors": {"starts": 5, "seed": 1, "at": {"damping": 0.06}, "max_seconds": 9999.0},
    "orbits": {"max_period": 1, "starts": 20, "seed": 1, "at": {"damping": 0.06}},
    "branch": BRANCH,
    "explore": {"parameter": "amplitude", "bounds": [0.1, 9.0], "at": {"damping": 0.06}, "max_period": 1, "seed": 1}
    | {"budget": 1, "max_seconds": 9999.0},
    "locus": PLANE
    | {"bounds": {"amplitude": [0.1, 9.0], "frequency": [2.05, 2.15]}, "kinds": ["SN", "GR"], "largest_step": 0.1}
    | {"max_seconds": 9999.0},
    "margin": {"free": {"amplitude": 0.1}, "bounds": {"amplitude": [0.1, 9.0]}, "kinds": ["SN"], "start": START}
    | {"at": {"damping": 0.06}, "settle": 200, "directions": 8, "seed": 1, "max_seconds": 9999.0},
    "fit": {"record": "fit.csv", "sigma": 1e-3, "free": {"damping": 0.01}, "bounds": {"damping": [0.01, 0.2]}}
    | {"sigma_v": 1e-3, "flawed": True},
    "map": PLANE
    | {"count": [2, 3], "quantities": ["label"], "starts": 2, "seed": 1, "settle": 30, "patience": 500}
    | {"at": {"damping": 0.06}, "max_seconds": 9999.0},
    "spectrum": {"parameter": "amplitude", "from": 2.0, "to": 3.0, "count": 3, "start": START, "settle": 9}
    | {"error": 1e-2},
    "basins": {"x": [-0.5, 0.5], "v": [-1.0, 1.0], "count": 9, "phase": 0.5, "starts": 9, "seed": 1}
    | {"at": {"damping": 0.06}},
    "panels": {"amplitude": [2.0, 3.0], "damping": [0.1, 0.2]},
}
OWN_KINDS = {name: StudyKind(name, table) for name, table in STUDIES.items()}
OWN_KINDS["locus"] = StudyKind("locus", STUDIES["locus"], {"branch": BRANCH | {"bounds": [0.1, 4.0]}})
OWN_KINDS |= {name: TextKind(name) for name in MUTATIONS}


def write_tables(kind, path, scene=SCENE):
    """Write the scene file of a study; return its tables."""
    jv.save_scene(scene, path, force=True)
    tables = tomllib.loads(path.read_text()) | kind.others | ({kind.name: kind.table} if kind.table else {})
    path.write_bytes(msgspec.toml.encode(tables))
    return tables


def read_or_refuse(path, changes=()):
    """Return the tables of a scene file and None, or None and the error, which is one line."""
    try:
        return read_scene_file(path, changes), None
    except jv.ArgumentError as error:
        line = str(error)
        assert 0 < len(line) <= 300 and "\n" not in line, line
        return None, error


def entries(value, path):
    """Yield (path, value) of a value and of all values within it, but not of the free names in a table."""
    yield path, value
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from entries(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from entries(inner, f"{path}.{place}")


WRONG = {
    bool: ("'text'", "3.5", "[]", "{}"),
    int: ("'text'", "3.5", "true", "[]", "{}", "-1", f"{2**70}", "nan"),
    float: ("'text'", "true", "[]", "{}", "nan", "inf", "-inf", "[1.0, 2.0]"),
    str: ("3.5", "true", "[]", "{}", "'no such name'"),
    list: ("3.5", "'text'", "true", "{a = 1.0}", "[[]]", "[true]"),
    dict: ("3.5", "'text'", "true", "[]", "{'no such name' = 1.0}"),
}


@of_numbers
def test_wrong_values(kind, number):
    """Each value of a wrong type, and each number that is not finite, is refused with its key; so is an unknown key."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        table = write_tables(kind, path)[kind.name]
        free_texts = {"fit.record", *(f"sweep.legs.{place}.name" for place in (0, 1))}
        for key, value in entries(table, kind.name):
            for wrong in WRONG[type(value)]:
                unbounded = kind.name in ("margin", "fit") and "inf" in wrong
                if unbounded or (key in free_texts and wrong == "'no such name'"):
                    continue
                read, error = read_or_refuse(path, [f"{key} = {wrong}"])
                assert error is not None, (key, wrong, read)
                assert error.key.startswith(kind.name), (key, error)
                assert "must " in error.rule or "is not" in error.rule, (key, error)


@of_numbers
def test_writing(kind, number):
    """A scene file that is written and read again is the same."""
    with TemporaryDirectory() as folder:
        path, again = Path(folder) / "study.toml", Path(folder) / "again.toml"
        tables = write_tables(kind, path)
        file = read_scene_file(path)
        read = json.loads(msgspec.json.encode(file)).get(kind.name, {})  # without the values that are defaults
        assert all(read[key] == value for key, value in kind.table.items() if key in read)
        write_scene_file(file, again)
        assert read_scene_file(again) == file and tables["scene"]["frequency"] == file.scene.frequency


def scene_of(number):
    """Return the scene of a draw: the symmetric one for number 0, else one of a random kind."""
    return SCENE if number == 0 else list(KINDS.values())[number % len(KINDS)].draw_single(number)[0]


@of_numbers
def test_runs(kind, number):
    """The job that a run leaves with its data gives the same data once more; the files are those of the summary.

    The data are the same to rounding: the first evaluations of a program are by NumPy, later ones compiled.
    """
    with TemporaryDirectory() as folder:
        path, out = Path(folder) / "study.toml", Path(folder) / "out"
        write_tables(kind, path, scene_of(number))
        try:
            done = jv.run(path, out, csv=True)
        except jv.SceneError as error:
            # e.g. no orbit to start from, walls in other places
            assert number and error.key.startswith(kind.name), error
            assert not out.exists()
            return
        files = {Path(name).name: Path(name) for name in done.summary["files"].values()}
        assert set(files) == {file.name for file in out.iterdir()}
        assert files["study.png"].read_bytes().startswith(b"\x89PNG") and files["study.txt"].read_text() == done.table
        with pytest.raises(FileExistsError):
            jv.run(path, out, csv=True)
        data = jv.load_data(files["study.nc"])
        job = msgspec.convert(done.summary["job"], type(read_scene_file(path)))
        assert job == read_scene_file(path) == parse_tables(tomllib.loads(data.attrs["job"]))
        (Path(folder) / "again.toml").write_text(data.attrs["job"])
        jv.run(Path(folder) / "again.toml", out)
        again = jv.load_data(out / "again.nc")
        xr.testing.assert_allclose(again, data, rtol=1e-6, atol=1e-9)
        assert again.attrs.keys() == data.attrs.keys() and again.attrs["job"] == data.attrs["job"]


@of_numbers
def test_hostile_texts(kind, number):
    """A mutated scene file, or a change, is read or refused in one line within 2 s, also by the command."""
    draw, files = generator(kind, number), [path.read_bytes() for path in sorted(SCENES.glob("*.toml"))]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "mutated.toml"
        for _ in range(8):
            content, changes = mutate(kind.name, files[draw.integers(len(files))], draw, CHANGES)
            path.write_bytes(content)
            began = time.process_time()
            is_refused = read_or_refuse(path, changes)[0] is None
            assert time.process_time() - began < SLOWEST, (content[:200], changes)
            if is_refused:
                words = [word for change in changes for word in ("--set", change)]
                with redirect_stderr(io.StringIO()) as stderr:
                    assert call_command("run", path, "--out", f"{folder}/out", *words) == 2
                (line,) = stderr.getvalue().splitlines()
                assert len(line) <= 300 + len("jaxvibro: "), line
