"""Saved files: any damage is told in one line, what was saved before checksums is read, nonsense is not."""

import json
import warnings
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.branches import diagram as diagrams
from jaxvibro.loci.locus import build_codim2
from jaxvibro.loci.locus_file import DIMENSIONS
from jaxvibro.output.checksums import FORMAT_NUMBER, HEADER_ATTRIBUTES, fill_in_checksum, netcdf_bytes

MARKED = set(HEADER_ATTRIBUTES)


@pytest.fixture(scope="module")
def branch():
    """A branch with a grazing and a saddle-node."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (1.5, 4.0))


@pytest.fixture(scope="module")
def diagram(branch):
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    return jv.Diagram("amplitude", (1.5, 4.0), branch.scene, (branch, branch), ((0, 1),), True, "all done", settings)


PLANE = {"frequency": (1.5, 3.0), "amplitude": (1.5, 4.0)}


@pytest.fixture(scope="module")
def held(branch):
    """The rows of a branch as those of a curve along two parameters."""
    data = branch.data.assign(frequency=("point", np.linspace(2.0, 2.2, len(branch))))
    data.attrs = {}
    return jv.HeldBranch(tuple(PLANE), "least_speed", 1.25, PLANE, branch.scene, data, ("the start", "the end"))


@pytest.fixture(scope="module")
def locus(held):
    """The same rows as those of a locus, with a cusp in the middle."""
    data = held.data[["frequency", "amplitude", *DIMENSIONS]].assign_attrs(periods=1)
    marks = (0, "EP"), (9, "CP"), (len(held) - 1, "EP")
    special = tuple(build_codim2(held.scene, "SN", PLANE, data, place, kind, 1e-16) for place, kind in marks)
    return jv.Locus("SN", tuple(PLANE), PLANE, held.scene, data, special, held.reasons)


@pytest.fixture(scope="module")
def files(branch, diagram, held, locus, tmp_path_factory):
    """{kind: (file, how it is read)} of every kind of file that is read again."""
    out = tmp_path_factory.mktemp("saved")
    branch.save(out / "branch.nc")
    held.save(out / "held.nc")
    locus.save(out / "locus.nc")
    diagram.save(out / "diagram")
    one = min((out / "diagram").glob("*.nc"))
    (out / "data.nc").write_bytes(netcdf_bytes(branch.data.assign(word=("point", ["a", "bb"] * (len(branch) // 2)))))
    return {
        "branch": (out / "branch.nc", jv.load_branch),
        "held": (out / "held.nc", jv.load_held_branch),
        "locus": (out / "locus.nc", jv.load_locus),
        "data": (out / "data.nc", jv.load_data),
        "index": (out / "diagram" / "diagram.json", lambda path: jv.load_diagram(path.parent)),
        "of a diagram": (one, lambda path: jv.load_diagram(path.parent)),
    }


def refused(path, read, content):
    """A file with this content is refused in one clear line; it is then as it was."""
    before = path.read_bytes()
    path.write_bytes(content)
    try:
        with warnings.catch_warnings(), pytest.raises(jv.ArgumentError) as error:
            warnings.simplefilter("error")
            read(path)
    finally:
        path.write_bytes(before)
    line = str(error.value)
    assert "\n" not in line and len(line) <= 300 and "must be" in line


def kinds(test):
    return pytest.mark.parametrize("kind", ["branch", "held", "locus", "data", "index", "of a diagram"])(test)


@kinds
def test_a_flipped_bit_is_told(files, kind):
    path, read = files[kind]
    whole, draw = path.read_bytes(), np.random.default_rng(1)
    marks = [whole.index(b"checksum") + k for k in range(80)]
    for place in [*marks, *draw.integers(0, len(whole), 40)]:
        content = bytearray(whole)
        content[place] ^= 1 << draw.integers(8)
        refused(path, read, bytes(content))


@kinds
def test_a_cut_is_told(files, kind):
    path, read = files[kind]
    whole, draw = path.read_bytes(), np.random.default_rng(2)
    for size in [0, 1, 4, 60, len(whole) - 1, *draw.integers(0, len(whole), 15)]:
        refused(path, read, whole[:size])


def test_a_branch_without_impacts_is_read(tmp_path):
    scene = jv.make_scene(0.3, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.1, 0.5))
    assert branch.data.sizes["impact"] == 0
    branch.save(tmp_path / "free.nc")
    found = jv.load_branch(tmp_path / "free.nc")
    np.testing.assert_array_equal(found.values, branch.values)
    assert len(found.orbit(3).impacts.time) == 0
    assert found.table() == branch.table() and found.to_frame().equals(branch.to_frame())


def before(path, attrs=None):
    """A NetCDF file's content without format number and checksum, attributes changed."""
    data = xr.load_dataset(path, engine="scipy")
    data.attrs = {key: each for key, each in data.attrs.items() if key not in MARKED} | (attrs or {})
    return bytes(data.to_netcdf(engine="scipy"))


def test_a_branch_of_before_is_read_with_one_warning(branch, files, tmp_path):
    (tmp_path / "old.nc").write_bytes(before(files["branch"][0]))
    with pytest.warns(UserWarning, match=r"old\.nc: has no checksum") as told:
        found = jv.load_branch(tmp_path / "old.nc")
    assert len(told) == 1 and told[0].filename == __file__
    assert found.table() == branch.table()
    found.save(tmp_path / "new.nc")
    assert jv.load_branch(tmp_path / "new.nc").table() == branch.table()
    (tmp_path / "data.nc").write_bytes(before(files["data"][0]))
    with pytest.warns(UserWarning, match="has no checksum"):
        assert jv.load_data(tmp_path / "data.nc").sizes["point"] == len(branch)


def test_a_diagram_of_before_is_read_with_one_warning(diagram, files, tmp_path):
    told = {key: getattr(diagram, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
    for place in (0, 1):
        (tmp_path / f"branch_00{place}.nc").write_bytes(before(files["branch"][0]))
    names = [f"branch_00{place}.nc" for place in (0, 1)]
    (tmp_path / "diagram.json").write_text(json.dumps(told | {"branches": names}, indent=1))
    with pytest.warns(UserWarning, match="has no checksum") as seen:
        found = jv.load_diagram(tmp_path)
    assert len(seen) == 1 and found.table() == diagram.table()
    (tmp_path / "mine.nc").write_text("not a branch's file")
    found.save(tmp_path, force=True)
    names = sorted(one.name for one in tmp_path.iterdir())
    assert names[-2:] == ["diagram.json", "mine.nc"] and not {"branch_000.nc", "branch_001.nc"} & set(names)
    assert jv.load_diagram(tmp_path).table() == diagram.table()


def test_damage_to_a_file_of_before_is_no_crash(files, tmp_path):
    """Without a checksum what is read may be wrong, but nothing else than a refusal comes out."""
    whole, path, draw = before(files["branch"][0]), tmp_path / "old.nc", np.random.default_rng(3)
    head = whole.index(b"multiplier_real")
    for _ in range(200):
        content = bytearray(whole)
        for place in draw.integers(0, head, draw.integers(1, 4)):
            content[place] = draw.integers(256)
        path.write_bytes(bytes(content[: draw.choice([len(whole), draw.integers(len(whole))])]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                jv.load_branch(path)
            except jv.ArgumentError as error:
                assert "\n" not in str(error) and len(str(error)) <= 300


def test_curves_in_two_parameters_are_read_as_they_were(held, locus, files):
    for one, kind in ((held, "held"), (locus, "locus")):
        path, read = files[kind]
        found = read(path)
        assert found.data.identical(one.data) and repr(found) == repr(one) and found.table() == one.table()
        assert (found.names, found.bounds, found.reasons) == (one.names, one.bounds, one.reasons)
        assert found.to_frame().equals(one.to_frame()) and found.orbit(3).label == one.orbit(3).label == "P111"
        with pytest.raises(FileExistsError):
            one.save(path)
    assert [each.values for each in found.special] == [each.values for each in locus.special]


PLANES = [
    *({"bounds": each} for each in ("{}", '{"amplitude": [0, 1]}', '{"amplitude": [1, 0], "frequency": [1, 2]}')),
    *({"scene": each} for each in ("", "amplitude = 1", 3.0)),
    {"bounds": '{"amplitude": [0, 1], "mass": [1, 2]}'},
    {"reasons": "[1, 2]"},
]


@pytest.mark.parametrize(
    ("kind", "attrs"),
    [
        *((kind, attrs) for kind in ("held", "locus") for attrs in PLANES),
        *(("held", attrs) for attrs in ({"held": "speed"}, {"value": np.nan})),
        *(("locus", {"special": each}) for each in ("[]", '[["CP", 1000000, 0.0]]', '[["", 1, 0.0]]')),
        *(("locus", attrs) for attrs in ({"kind": "EP"}, {"periods": 0})),
    ],
)
def test_fields_that_no_curve_has_are_refused(files, kind, attrs):
    path, read = files[kind]
    data = xr.load_dataset(path, engine="scipy")
    data.attrs = {key: each for key, each in data.attrs.items() if key not in MARKED} | attrs
    refused(path, read, netcdf_bytes(data))


def test_rows_that_no_curve_has_are_refused(files):
    for kind in ("held", "locus"):
        path, read = files[kind]
        data = xr.load_dataset(path, engine="scipy")
        for change in (
            data.drop_vars("side"),
            data.isel(point=slice(0, 0)),
            data.assign(amplitude=data.residual * np.inf),
        ):
            refused(path, read, netcdf_bytes(change))


def test_what_is_held_is_told_and_drawn(branch, held):
    lines = held.table().splitlines()
    assert lines[0] == "least_speed held at 1.25" and lines[-2:] == ["first point: the start", "last point: the end"]
    spans = [tuple(map(int, (line.split()[0], line.split()[2]))) for line in lines[2:-2]]
    words = branch.to_frame()["stability"].values
    assert [len(set(words[first : last + 1])) for first, last in spans] == [1] * len(spans)
    assert spans[0][0] == 0 and spans[-1][1] == len(held) - 1 and len(spans) > 1
    table = held.to_frame()
    assert list(table.columns[:3]) == ["frequency", "amplitude", "least_speed"] and (table["least_speed"] == 1.25).all()
    ax = plot.held(held)
    drawn = [line for line in ax.lines if (line.get_gid() or "").startswith("held") and len(line.get_xdata())]
    assert {line.get_linestyle() for line in drawn} == {"-", "--"}
    ends = [(line.get_xdata()[0], line.get_ydata()[-1]) for line in (drawn[0], drawn[-1])]
    assert ends[0][0] == held.values[0, 0] and ends[1][1] == held.values[-1, 1]
    assert plot.held(held, ax) is ax and len(ax.get_legend().get_texts()) == 3
    plt.close(ax.figure)
    turned = replace(held, names=held.names[::-1])
    with pytest.raises(jv.ArgumentError, match="must have the parameters of the curves that these Axes hold"):
        plot.held(turned, ax)
    with pytest.raises(jv.ArgumentError, match=r"plot\.held: must be given a HeldBranch"):
        plot.held(branch)
    with pytest.raises(jv.ArgumentError, match="units: physical units need scales"):
        held.table("physical")


DEEP = 5000 * "[" + 5000 * "]"
NONSENSE = [
    *({"parameter": each} for each in ("mass", "", 3.0)),
    *({"bounds": each} for each in ([4.0, 1.5], [1.5], [1.5, np.inf], "ab", [1.5, 2.0, 3.0])),
    *({"scene": each} for each in ("", "amplitude = 1", "a = " + DEEP, "\x00", 3.0)),
    *({"special": each} for each in ("", "{}", "[1]", DEEP, '[["SN", 10000000, 0.0, [], []]]')),
    *(
        {"special": each}
        for each in ('[["SN", -1, 0.0, [], []]]', '[["", 1, 0.0, [], []]]', '[["SN", 1e400, 0, [], []]]')
    ),
    *({"special": f'[["GR", 1, 0.0, [{join}], [false]]]'} for join in ("[1.0]", "[2.0, [1.0], [], [1], 1, 0, 0, 0]")),
    *({"segments": each} for each in ("[]", '[[0, 3, "P111", ["RL"]]]', '[[5, 1, "P111", ["RL"]]]', "[[0]]", "nan")),
    *({"reasons": each} for each in ("[]", '["one"]', "[1, 2]", '["a", "b", "c"]')),
    *({"settings": each} for each in ("{}", "[]", '{"first_step": 1}', '{"first_step": NaN}')),
    {"settings": '{"first_step": 0.05, "largest_step": -1.0, "tolerance": 1e-10}'},
    {"format": FORMAT_NUMBER + 1},
    {"format": "new"},
    {"format": [1, 2]},
]


@pytest.mark.parametrize("attrs", NONSENSE, ids=lambda one: str(one)[:40])
def test_fields_that_are_nonsense_are_refused(files, attrs):
    """Whether there is no checksum, or one that fits."""
    path = files["branch"][0]
    data = xr.load_dataset(path, engine="scipy")
    data.attrs = HEADER_ATTRIBUTES | {key: each for key, each in data.attrs.items() if key not in MARKED} | attrs
    refused(path, jv.load_branch, fill_in_checksum(bytes(data.to_netcdf(engine="scipy"))))


def columns(data):
    yield data.drop_vars("side")
    yield data.assign(side=data["side"] + 5)
    yield data.assign(time=data["time"] * np.inf)
    yield data.assign(speed=data["speed"].T)
    yield data.assign(x=data["x"].astype(str))
    yield data.assign(x=data["x"] * np.nan)
    yield data.assign(stable=data["stable"] + 7)
    yield data.assign(amplitude=data["amplitude"] * np.nan)
    yield data.isel(point=slice(0, 0))
    yield data.isel(multiplier=slice(0, 1))


def test_columns_that_no_branch_has_are_refused(files):
    path = files["branch"][0]
    for data in columns(xr.load_dataset(path, engine="scipy")):
        refused(path, jv.load_branch, netcdf_bytes(data))


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "mass"},
        {"bounds": [1.0]},
        {"left": [[0, 99]]},
        {"left": [[-1, 0]]},
        {"left": [[0.5, 1]]},
        {"complete": "yes"},
        {"settings": []},
        {"branches": []},
        {"branches": {}},
        {"branches": [3]},
        {"branches": {"../branch_000.nc": ""}},
        {"branches": {"branch_000.nc\x00": ""}},
        {"scene": "amplitude = 1"},
        {"scene": None, "branches": {}},
        {"format": 3},
        {"reason": None},
    ],
)
def test_an_index_that_is_nonsense_is_refused(files, changes):
    path, read = files["index"]
    told = json.loads(path.read_bytes()) | changes | {"checksum": HEADER_ATTRIBUTES["checksum"]}
    refused(path, read, fill_in_checksum(json.dumps(told).encode()))


@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_diagram_saved_anew_is_whole_or_the_old_one(diagram, tmp_path, monkeypatch, after):
    """Interrupted after so many files, each of which may be a branch's or the index."""
    other = replace(diagram, branches=diagram.branches[:1], reason="another")
    other.save(tmp_path)
    plain, count = diagrams.atomic_file, []

    def stopped(*given):
        count.append(1)
        if len(count) > after:
            raise KeyboardInterrupt
        return plain(*given)

    monkeypatch.setattr(diagrams, "atomic_file", stopped)
    with pytest.raises(KeyboardInterrupt):
        diagram.save(tmp_path, force=True)
    assert jv.load_diagram(tmp_path).reason == "another"
    monkeypatch.undo()
    diagram.save(tmp_path, force=True)
    assert jv.load_diagram(tmp_path).table() == diagram.table()


def test_a_branch_of_another_diagram_is_refused(diagram, branch, tmp_path):
    diagram.save(tmp_path)
    place = next(tmp_path.glob("branch_000*.nc"))
    replace(branch, reasons=("one", "two")).save(place, force=True)
    with pytest.raises(jv.ArgumentError, match="must be the file that the diagram was saved with"):
        jv.load_diagram(tmp_path)
