"""`jaxvibro run` of a [map], gone on with, and `jaxvibro show`."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.output.label_codes import label_of
from jaxvibro.studies.command import main

from .scene_files import SCENE

FILE = f"""{SCENE}
[map]
parameters = ["amplitude", "frequency"]
bounds = {{amplitude = [1.0, 6.0], frequency = [2.2, 3.4]}}
count = [3, 4]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    (folder / "map.toml").write_text(FILE)
    return folder


@pytest.fixture(scope="module")
def done(folder):
    return jv.run(folder / "map.toml", folder / "out")


def test_what_is_written(folder, done):
    assert sorted(one.name for one in (folder / "out").iterdir()) == ["map.map.png", "map.txt", "map.zarr"]
    assert set(done.summary["files"]) == {"table", "map", "store"}
    found = jv.load_store(folder / "out" / "map.zarr")
    codes, counts = np.unique(found["label"], return_counts=True)
    assert done.summary["map"] == {label_of(code): count for code, count in zip(codes, counts, strict=True)}
    assert "map over amplitude and frequency: 3 x 4 cells" in done.table
    lines = {line.split()[0]: line.split()[1:] for line in done.table.splitlines() if line.startswith("P")}
    assert {name: int(row[0]) for name, row in lines.items()} == done.summary["map"]
    assert "largest exponent: " in done.table
    assert found.attrs["chunks"] == found.attrs["chunks_done"] == 1
    scene = jv.load_scene(folder / "map.toml")
    direct = jv.map_parameters(scene, {name: found[name].values for name in ("amplitude", "frequency")})
    np.testing.assert_array_equal(direct["label"], found["label"])


def test_a_run_that_was_killed_goes_on(folder, done):
    with pytest.raises(FileExistsError, match=r"map\.map\.png already exists|map\.txt already exists"):
        jv.run(folder / "map.toml", folder / "out")
    for name in ("map.map.png", "map.txt"):  # they are written at the end
        (folder / "out" / name).unlink()
    before = (folder / "out" / "map.zarr" / "done" / "c" / "0").stat().st_mtime_ns
    assert jv.run(folder / "map.toml", folder / "out").table == done.table
    assert (folder / "out" / "map.zarr" / "done" / "c" / "0").stat().st_mtime_ns == before
    with pytest.raises(jv.ArgumentError, match="differs"):
        jv.run(folder / "map.toml", folder / "out", ["damping=0.1"], force=True)


def test_show(folder, done, capsys):
    store = str(folder / "out" / "map.zarr")
    assert main(["show", store, "--data", str(folder / "all.nc")]) == 0
    told = capsys.readouterr().out
    assert "1 of 1 chunks are done" in told and "P111" in told
    assert (folder / "out" / "map.png").read_bytes().startswith(b"\x89PNG")
    kept, plain = jv.load_data(folder / "all.nc"), jv.load_store(store)
    for name in plain.variables:
        np.testing.assert_array_equal(kept[name], plain[name])
    assert main(["show", store]) == 2
    assert capsys.readouterr().err == f"jaxvibro: {folder / 'out' / 'map.png'} already exists; force overwrites it\n"
    assert main(["show", store, "--force", "--picture", str(folder / "other.png")]) == 0
    assert main(["show", str(folder / "missing.zarr")]) == 2
    assert capsys.readouterr().err == f"jaxvibro: {folder / 'missing.zarr'}: Not a directory\n"
    assert main(["show", store, "--units", "physical", "--force"]) == 2
    assert "scales" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ('map.parameters=["amplitude", "amplitude"]', "map.parameters: must be two different parameters"),
        ('map.parameters=["amplitude", "omega"]', "map.parameters[1]: must be a parameter of the scene, perhaps freq"),
        ("map.bounds.frequency=[3.0, 2.0]", "map.bounds.frequency: must be [low, high]"),
        (
            "map.bounds.damping=[0.1, 0.2]",
            "map.bounds: must give [low, high] for amplitude and for frequency only",
        ),
        ("map.count=[3, 0]", "map.count[1]: must be a whole number >= 1"),
        ('map.quantities=["speed"]', "map.quantities: must be some of label, period"),
        ('map.along="damping"', "map.along: must be a parameter of the grid (amplitude, frequency), or None"),
        ("map.start={x=2.0, v=0.0}", "map.start.x: must lie between the walls"),
        ("map.at={damp=1.0}", "map.at.damp: is not a parameter"),
        ("map.colour=1", "map.colour: is not a key here"),
    ],
)
def test_what_cannot_be_asked(folder, tmp_path, capsys, change, told):
    assert main(["run", str(folder / "map.toml"), "--set", change, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxvibro: {told}"), error
    assert error.count("\n") == 1 and list(tmp_path.iterdir()) == []


def test_engines_that_cannot_be(folder, tmp_path, capsys):
    asked = ["run", str(folder / "map.toml"), "--out", str(tmp_path)]
    assert main([*asked, "--engine", "local", "--scheduler", "tcp://there:1"]) == 2
    assert "scheduler: must not be given with the engine local" in capsys.readouterr().err
    assert main([*asked, "--workers", "0"]) == 2
    assert "workers: must be a whole number from 1 on" in capsys.readouterr().err
    assert main([*asked, "--engine", "slurm"]) == 2


def test_other_kinds_of_maps(folder, tmp_path):
    changes = ['map.along="amplitude"', 'map.quantities=["label", "loads"]', "map.count=[5, 2]"]
    table = jv.run(folder / "map.toml", tmp_path, changes).table
    assert "each going up and down" in table and "work rate of the walls: " in table
    changes = ["map.starts=12", 'map.quantities=["attractors"]', "map.count=[2, 2]"]
    table = jv.run(folder / "map.toml", tmp_path / "many", changes).table
    assert "of their attractors" in table and "attractors of a cell: " in table
    one = jv.run(folder / "map.toml", tmp_path / "dask", engine=jv.DaskEngine(workers=1))
    assert one.summary["map"]["P111"] > 0
    more = ["map.count=[2, 2]", 'sweep.parameter="amplitude"', "sweep.count=5", "sweep.settle=10", "sweep.keep=5"]
    leg = 'sweep.legs=[{name="up", from=1.0, to=2.0, start={x=0.0, v=0.0}}]'
    jv.run(folder / "map.toml", tmp_path / "both", [*more, leg])
    names = {one.name for one in (tmp_path / "both").iterdir()}
    assert names == {"map.png", "map.nc", "map.txt", "map.map.png", "map.zarr"}
