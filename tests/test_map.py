"""Maps over parameters: labels, carried motions, full size, pictures, `jaxvibro run` of a [map], `jaxvibro show`."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.output.label_codes import CHAOTIC, CODE_WORDS, INFINITE_COUNT, UNDECIDED, label_of
from jaxvibro.plot.map import label_colour
from jaxvibro.studies.command import main

from .scene_files import SCENE

FILE = f"""{SCENE}
[map]
parameters = ["amplitude", "frequency"]
bounds = {{amplitude = [1.0, 6.0], frequency = [2.2, 3.4]}}
count = [3, 4]
"""


def code_of(label):
    """Return the code of a label, from its counts alone."""
    words = {word: code for code, word in CODE_WORDS.items()}
    if label in words:
        return words[label]
    counts = label[1:].split("-") if "-" in label else label[1:]
    periods, left, right = (INFINITE_COUNT if count == "inf" else int(count) for count in counts)
    return 1_000_000 * periods + 1_000 * left + right


def figure_4(**changes):
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (jv.Wall(-1.0), jv.Wall(1.0))).replace(**changes)


def test_codes_and_labels():
    for label in ("P100", "P111", "P8-8-16", "P1-0-inf", "P32-998-0", "chaotic", "undecided", "not done"):
        assert label_of(code_of(label)) == label
    assert (label_of(UNDECIDED), label_of(CHAOTIC)) == ("undecided", "chaotic")


def test_labels_and_attributes_of_a_map():
    grid = {"amplitude": np.linspace(2.0, 6.0, 4), "frequency": np.array([1.6, 2.0, 2.3, 3.5])}
    data = jv.map_parameters(figure_4(), grid)
    assert data["label"].dims == ("amplitude", "frequency") and len(np.unique(data["label"])) >= 4
    assert data.attrs["damping"] == 0.05 and "amplitude" not in data.attrs
    attributes = data["label"].attrs
    meanings = dict(zip(attributes["flag_values"], attributes["flag_meanings"].split(), strict=True))
    assert meanings[code_of("P100")] == "P100" and set(meanings) == set(np.unique(data["label"]))
    assert (data["status"] == 0).all()


def test_complete_chatter_has_its_label():
    scene = jv.make_scene(1.0, 0.2, 0.05, 0.6, (None, jv.Wall(0.2)))
    data = jv.map_parameters(scene, {"frequency": [0.2, 0.22]}, quantities=("label", "period"))
    expected = [jv.find_attractors(scene.replace(frequency=w), 24)[0].label for w in (0.2, 0.22)]
    assert [label_of(int(code)) for code in data["label"]] == expected == ["P1-0-inf"] * 2
    assert data["period"].values.tolist() == [1, 1]


def test_attractors_and_loads_of_random_starts():
    asked = ("label", "period", "exponent", "attractors", "loads")
    data = jv.map_parameters(figure_4(), {"amplitude": [4.65]}, 60, asked, seed=3).isel(amplitude=0)
    attractors = [one for one in jv.find_attractors(figure_4(), 60, 3) if one.share > 0]
    for place, one in enumerate(sorted(attractors, key=lambda one: (-one.share, code_of(one.label)))):
        assert label_of(int(data["label"][place])) == one.label and abs(data["exponent"][place] - one.exponent) < 1e-8
        loads = jv.wall_loads(figure_4(), one.state, one.periods)
        for name in ("largest_speed", "work_rate"):
            np.testing.assert_allclose(data[name].values[place], loads[name], rtol=1e-6)
    assert data["share"].values[len(attractors) :].tolist() == [0.0] * (8 - len(attractors))
    chaotic = jv.map_parameters(figure_4(), {"frequency": [1.6]}, 12, ("attractors",))  # all starts on one set
    assert int(chaotic["attractors"][0]) == 1 and float(chaotic["share"][0, 0]) == 1.0
    assert label_of(int(chaotic["label"][0, 0])) == "chaotic"


def test_a_store_of_another_scene_is_refused(tmp_path):
    grid, reports, store = {"frequency": np.linspace(1.6, 3.0, 6)}, [], jv.Store(tmp_path / "map")
    kept = jv.map_parameters(figure_4(), grid, chunk=2, store=store, progress=reports.append)
    assert [report.done for report in reports] == [0, 2, 4, 6]
    other = figure_4(frequency=1.0)  # which the grid gives anyway
    assert jv.map_parameters(other, grid, chunk=2, store=store).identical(kept)
    with pytest.raises(jv.ArgumentError, match=r"scene differs; got 'damping = 0.05 stored, damping = 0.06"):
        jv.map_parameters(figure_4(damping=0.06), grid, chunk=2, store=store)
    with pytest.raises(jv.ArgumentError, match=r"frequency differs; got '6, 1.6 to 3.0, .* stored, 6, 1.6 to 3.2, "):
        jv.map_parameters(figure_4(), {"frequency": np.linspace(1.6, 3.2, 6)}, chunk=2, store=store)


@pytest.mark.parametrize("side", [8, 1000])
def test_a_map_over_the_plane_of_figure_4(side, tmp_path):
    """Hardly a cell is undecided; some are those of maps of one cell."""
    grid = {"amplitude": np.linspace(0.5, 6.0, side), "frequency": np.linspace(1.5, 4.0, side)}
    data = jv.map_parameters(figure_4(), grid, store=jv.Store(tmp_path / "map"))
    assert (data["label"] == UNDECIDED).mean() < 0.02
    for row, column in np.random.default_rng(25).integers(side, size=(8, 2)):
        cell = {"amplitude": grid["amplitude"][[row]], "frequency": grid["frequency"][[column]]}
        assert int(jv.map_parameters(figure_4(), cell)["label"][0, 0]) == int(data["label"][row, column])


@pytest.mark.parametrize("side", [20, 10_000])
def test_basins_of_very_many_starts(side, tmp_path):
    attractors = jv.find_attractors(figure_4())
    axes = np.linspace(-1.0, 1.0, side), np.linspace(-3.0, 3.0, side)
    data = jv.basins(figure_4(), *axes, 0.0, attractors, store=jv.Store(tmp_path / "basins"))
    assert (data["label"] == -1).mean() < 1e-3
    few = jv.basins(figure_4(), *(axis[:: side // 20] for axis in axes), 0.0, attractors)
    np.testing.assert_array_equal(few["label"], data["label"][:: side // 20, :: side // 20])
    assert abs(data["fraction"] - few["fraction"]).max() < 0.1


def test_picture_of_a_map():
    grid = {"amplitude": [1.0, 2.0, 3.0], "frequency": [1.5, 2.0]}
    names = [["P100", "P111"], ["chaotic", "undecided"], ["P111", "not done"]]
    label = np.array([[code_of(name) for name in row] for row in names], np.int32)
    values = {"label": (tuple(grid), label), "exponent": (tuple(grid), np.linspace(-1, 2, 6).reshape(3, 2))}
    data = xr.Dataset(values, grid, {"scene_file": ""})
    ax = jv.plot.map(data, Figure().subplots())
    assert ax.get_xlabel().startswith("drive frequency") and ax.get_ylabel().startswith("drive amplitude")
    assert ax.get_xlim() == (1.25, 2.25) and ax.get_ylim() == (0.5, 3.5)
    shown = ax.images[0].to_rgba(ax.images[0].get_array())
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["P111", "not done", "undecided", "chaotic", "P100"]
    assert len(np.unique(shown.reshape(-1, 4), axis=0)) == 5
    assert len({label_colour(code_of(f"P{n}{p}{q}")) for n in (1, 2, 3) for p in (0, 1, 2) for q in (0, 1)}) >= 12
    assert len({label_colour(code_of(f"P22{q}")) for q in range(2, 7)}) == 5
    assert len(jv.plot.map(data, Figure().subplots(), "exponent").figure.axes) == 2
    for wrong, quantity, rule in (
        (data, "period", "must be one of label, exponent"),
        (data.expand_dims(way=[1, -1]), "label", "select from the others first"),
        (xr.Dataset(), "label", "must be given a Dataset of map_parameters"),
    ):
        with pytest.raises(jv.ArgumentError, match=rule):
            jv.plot.map(wrong, quantity=quantity)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("map")
    (folder / "map.toml").write_text(FILE)
    return folder


@pytest.fixture(scope="module")
def result(folder):
    return jv.run(folder / "map.toml", folder / "out")


def test_files_of_a_run_and_a_second_run(folder, result):
    out = folder / "out"
    assert {file.name for file in out.iterdir()} - {"map.png"} == {"map.map.png", "map.txt", "map.zarr"}
    assert set(result.summary["files"]) == {"table", "map", "store"}
    data = jv.load_store(out / "map.zarr")
    codes, counts = np.unique(data["label"], return_counts=True)
    assert result.summary["map"] == {label_of(code): count for code, count in zip(codes, counts, strict=True)}
    assert "map over amplitude and frequency: 3 x 4 cells" in result.table and "largest exponent: " in result.table
    lines = {line.split()[0]: line.split()[1:] for line in result.table.splitlines() if line.startswith("P")}
    assert {name: int(row[0]) for name, row in lines.items()} == result.summary["map"]
    assert data.attrs["chunks"] == data.attrs["chunks_done"] == 1
    grid = {name: data[name].values for name in ("amplitude", "frequency")}
    np.testing.assert_array_equal(jv.map_parameters(jv.load_scene(folder / "map.toml"), grid)["label"], data["label"])
    with pytest.raises(FileExistsError, match=r"map\.map\.png already exists|map\.txt already exists"):
        jv.run(folder / "map.toml", out)
    for name in ("map.map.png", "map.txt"):  # a run that was killed has not written them
        (out / name).unlink()
    mark = out / "map.zarr" / "done" / "c" / "0"
    before = mark.stat().st_mtime_ns
    assert jv.run(folder / "map.toml", out).table == result.table
    assert mark.stat().st_mtime_ns == before
    with pytest.raises(jv.ArgumentError, match="differs"):
        jv.run(folder / "map.toml", out, ["damping=0.1"], force=True)


def test_show(folder, result, capsys):
    store, picture = str(folder / "out" / "map.zarr"), folder / "out" / "map.png"
    assert main(["show", store, "--data", str(folder / "all.nc")]) == 0
    text = capsys.readouterr().out
    assert "1 of 1 chunks are done" in text and "P111" in text and picture.read_bytes().startswith(b"\x89PNG")
    kept, plain = jv.load_data(folder / "all.nc"), jv.load_store(store)
    for name in plain.variables:
        np.testing.assert_array_equal(kept[name], plain[name])
    for more, error in (
        ([store], f"jaxvibro: {picture} already exists; force overwrites it\n"),
        ([str(folder / "missing.zarr")], f"jaxvibro: {folder / 'missing.zarr'}: Not a directory\n"),
        ([store, "--units", "physical", "--force"], "scales"),
    ):
        assert main(["show", *more]) == 2
        assert error in capsys.readouterr().err
    assert main(["show", store, "--force", "--picture", str(folder / "other.png")]) == 0


@pytest.mark.parametrize(
    ("change", "key", "rule"),
    [
        ('map.parameters=["amplitude", "amplitude"]', "map.parameters", "must be two different parameters"),
        (
            'map.parameters=["amplitude", "omega"]',
            "map.parameters[1]",
            "must be a parameter of the scene, perhaps",
        ),
        ("map.bounds.frequency=[3.0, 2.0]", "map.bounds.frequency", "must be [low, high]"),
        ("map.bounds.damping=[0.1, 0.2]", "map.bounds", "must give [low, high] for amplitude and for frequency only"),
        ("map.count=[3, 0]", "map.count[1]", "must be a whole number >= 1"),
        ('map.quantities=["speed"]', "map.quantities", "must be some of label, period"),
        ('map.along="damping"', "map.along", "must be a parameter of the grid (amplitude, frequency), or None"),
        ("map.start={x=2.0, v=0.0}", "map.start.x", "must lie between the walls"),
        ("map.at={damp=1.0}", "map.at.damp", "is not a parameter"),
    ],
)
def test_invalid_keys_of_a_file_are_refused(folder, change, key, rule):
    with pytest.raises(jv.ArgumentError) as caught:
        jv.run(folder / "map.toml", "nowhere", [change])
    assert caught.value.key == key and rule in str(caught.value) and not Path("nowhere").exists()


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        (["--engine", "local", "--scheduler", "tcp://there:1"], "scheduler: must not be given with the engine local"),
        (["--workers", "0"], "workers: must be a whole number from 1 on"),
        (["--engine", "slurm"], ""),
    ],
)
def test_invalid_engines_of_a_run_are_refused(folder, tmp_path, capsys, more, rule):
    assert main(["run", str(folder / "map.toml"), "--out", str(tmp_path), *more]) == 2
    assert rule in capsys.readouterr().err


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
    names = {file.name for file in (tmp_path / "both").iterdir()}
    assert names == {"map.png", "map.nc", "map.txt", "map.map.png", "map.zarr"}
