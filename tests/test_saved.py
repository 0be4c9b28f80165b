"""Saved files: files of earlier versions are read, and invalid fields and columns are refused in one line.

Properties in tests/properties/test_output.py check that records are read as saved, and that damage is detected.
"""

import json
import warnings
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.output.checksums import HEADER_ATTRIBUTES, fill_in_checksum
from tests.properties.test_output import OWN_KINDS, branch_of, check_refusal, make_diagram, make_held
from tests.scene_files import refusal


@pytest.fixture(scope="module")
def branch():
    """A branch with a grazing and a saddle-node."""
    return branch_of(0)


@pytest.fixture(scope="module")
def files(branch, tmp_path_factory):
    """Return {kind: file} of every kind of file that is read again."""
    out = tmp_path_factory.mktemp("saved")
    for kind in OWN_KINDS.values():
        kind.make(branch).save(out / kind.name)
    return {name: out / name for name in OWN_KINDS} | {"diagram": out / "diagram" / "diagram.json"}


def refused(path, kind, content):
    """Check that a file with this content is refused; then restore the file."""
    before = path.read_bytes()
    try:
        check_refusal(OWN_KINDS[kind].load, path.parent if kind == "diagram" else path, path, content)
    finally:
        path.write_bytes(before)


def content_of(path, change=lambda data: data, header=HEADER_ATTRIBUTES, **attributes):
    """Return the content of a NetCDF file with changed data and attributes, with a header in place of its own."""
    data = change(xr.load_dataset(path, engine="scipy"))
    old = {key: value for key, value in data.attrs.items() if key not in HEADER_ATTRIBUTES}
    data.attrs = header | old | attributes
    return fill_in_checksum(bytes(data.to_netcdf(engine="scipy")))


def test_a_branch_without_impacts_is_read(tmp_path):
    scene = jv.make_scene(0.3, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.1, 0.5))
    assert branch.data.sizes["impact"] == 0
    branch.save(tmp_path / "free.nc")
    loaded = jv.load_branch(tmp_path / "free.nc")
    np.testing.assert_array_equal(loaded.values, branch.values)
    assert len(loaded.orbit(3).impacts.time) == 0
    assert loaded.table() == branch.table() and loaded.to_frame().equals(branch.to_frame())


def test_files_of_format_1_are_read_with_one_warning(branch, files, tmp_path):
    """They have neither a format number nor a checksum."""
    content = content_of(files["branch"], header={})
    (tmp_path / "old.nc").write_bytes(content)
    with pytest.warns(UserWarning, match=r"old\.nc: has no checksum") as caught:
        loaded = jv.load_branch(tmp_path / "old.nc")
    assert len(caught) == 1 and caught[0].filename == __file__ and loaded.table() == branch.table()
    loaded.save(tmp_path / "new.nc")
    assert jv.load_branch(tmp_path / "new.nc").table() == branch.table()
    (tmp_path / "data.nc").write_bytes(content_of(files["data"], header={}))
    with pytest.warns(UserWarning, match="has no checksum"):
        assert jv.load_data(tmp_path / "data.nc").sizes["point"] == len(branch)
    diagram, names = replace(make_diagram(branch), branches=(branch, branch)), ["branch_000.nc", "branch_001.nc"]
    for name in names:
        (tmp_path / name).write_bytes(content)
    fields = {key: getattr(diagram, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
    (tmp_path / "diagram.json").write_text(json.dumps(fields | {"branches": names}, indent=1))
    with pytest.warns(UserWarning, match="has no checksum") as caught:
        loaded = jv.load_diagram(tmp_path)
    assert len(caught) == 1 and loaded.table() == diagram.table()
    loaded.save(tmp_path, force=True)
    left = {path.name for path in tmp_path.iterdir()}
    assert {"old.nc", "data.nc", "diagram.json"} < left and not set(names) & left
    assert jv.load_diagram(tmp_path).table() == diagram.table()


def test_a_damaged_file_of_format_1_causes_no_other_error_than_a_refusal(files, tmp_path):
    whole, path = content_of(files["branch"], header={}), tmp_path / "old.nc"
    head, draw = whole.index(b"multiplier_real"), np.random.default_rng(3)
    for _ in range(100):
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


DEEP = 5000 * "[" + 5000 * "]"
STEPS, NO_NAME = '{"first_step": 0.05, "largest_step": 0.1, "tolerance": 1e-10}', '[0, 1], "mass": [1, 2]'
SPECIAL = ["", "{}", "[1]", DEEP, '[["SN", 10000000, 0.0, [], []]]', '[["SN", -1, 0.0, [], []]]']
SPECIAL += ['[["", 1, 0.0, [], []]]', '[["SN", 1e400, 0, [], []]]', '[["GR", 1, 0.0, [[1.0]], [false]]]']
SPECIAL += ['[["GR", 1, 0.0, [[2.0, [1.0], [], [1], 1, 0, 0, 0]], [false]]]']
WRONG = {
    "branch": {
        "parameter": ("mass", "", 3.0),
        "bounds": ([4.0, 1.5], [1.5], [1.5, np.inf], "ab", [1.5, 2.0, 3.0]),
        "scene": ("", "amplitude = 1", "a = " + DEEP, "\x00", 3.0),
        "special": SPECIAL,
        "segments": ("[]", '[[0, 3, "P111", ["RL"]]]', '[[5, 1, "P111", ["RL"]]]', "[[0]]", "nan"),
        "reasons": ("[]", '["one"]', "[1, 2]", '["a", "b", "c"]'),
        "settings": ("{}", "[]", '{"first_step": 1}', '{"first_step": NaN}', STEPS.replace("0.1", "-1.0")),
        "format": (3, "new", [1, 2]),
    },
    "held_branch": {"held": ("speed",), "value": (np.nan,)},
    "locus": {
        "special": ("[]", '[["CP", 1000000, 0.0]]', '[["", 1, 0.0]]'),
        "kind": ("EP",),
        "periods": (0,),
    },
    "diagram": {
        "name": ("mass",),
        "bounds": ([1.0],),
        "left": ([[0, 99]], [[-1, 0]], [[0.5, 1]]),
        "complete": ("yes",),
        "settings": ([],),
        "branches": ([], {}, [3], {"../branch_000.nc": ""}, {"branch_000.nc\x00": ""}),
        "scene": ("amplitude = 1", None),
        "format": (3,),
        "reason": (None,),
    },
}
PLANE = {
    "bounds": ("{}", *(f'{{"amplitude": {rest}}}' for rest in ("[0, 1]", '[1, 0], "frequency": [1, 2]', NO_NAME))),
    "scene": ("", "amplitude = 1", 3.0),
    "reasons": ("[1, 2]",),
}
WRONG["held_branch"] |= PLANE
WRONG["locus"] |= PLANE
FIELDS = [(kind, {key: value}) for kind, row in WRONG.items() for key, values in row.items() for value in values]


@pytest.mark.parametrize(("kind", "fields"), FIELDS, ids=lambda value: str(value)[:40])
def test_invalid_fields_are_refused_though_the_checksum_fits(files, kind, fields):
    if kind == "diagram":
        index = json.loads(files[kind].read_bytes()) | fields | {"checksum": HEADER_ATTRIBUTES["checksum"]}
        content = fill_in_checksum(json.dumps(index | ({"branches": {}} if fields == {"scene": None} else {})).encode())
    else:
        content = content_of(files[kind], **fields)
    refused(files[kind], kind, content)


COLUMNS = {
    "missing": lambda data: data.drop_vars("side"),
    "empty": lambda data: data.isel(point=slice(0, 0)),
    "infinite": lambda data: data.assign(amplitude=data["residual"] * np.inf),
    "infinite times": lambda data: data.assign(time=data["time"] * np.inf),
    "sides": lambda data: data.assign(side=data["side"] + 5),
    "shape": lambda data: data.assign(speed=data["speed"].T),
    "one multiplier": lambda data: data.isel(multiplier=slice(0, 1)),
    "text": lambda data: data.assign(x=data["x"].astype(str)),
    "nan": lambda data: data.assign(x=data["x"] * np.nan),
    "stable": lambda data: data.assign(stable=data["stable"] + 7),
}


@pytest.mark.parametrize("kind", ["branch", "held_branch", "locus"])
def test_invalid_columns_are_refused(files, kind):
    files[kind].write_bytes(content_of(files[kind]))
    OWN_KINDS[kind].load(files[kind])  # the checksum fits
    for name, change in COLUMNS.items():
        if kind != "locus" or name not in ("text", "nan", "stable"):
            refused(files[kind], kind, content_of(files[kind], change))


def test_a_branch_of_another_diagram_is_refused(branch, tmp_path):
    make_diagram(branch).save(tmp_path)
    replace(branch, reasons=("another", "end")).save(next(tmp_path.glob("branch_000*.nc")), force=True)
    assert "must be the file that the diagram was saved with" in refusal(jv.load_diagram, tmp_path)


def test_a_held_branch_is_reported_and_drawn(branch):
    held = make_held(branch)
    lines = held.table().splitlines()
    assert lines[0] == "least_speed held at 1.25" and lines[-2].startswith("first point: the parameter reached")
    spans = [tuple(map(int, (line.split()[0], line.split()[2]))) for line in lines[2:-2]]
    words, frame = branch.to_frame()["stability"].values, held.to_frame()
    assert [len(set(words[first : last + 1])) for first, last in spans] == [1] * len(spans)
    assert spans[0][0] == 0 and spans[-1][1] == len(held) - 1 and len(spans) > 1
    assert list(frame.columns[:3]) == ["frequency", "amplitude", "least_speed"]
    assert (frame["least_speed"] == 1.25).all() and held.orbit(3).label == "P111"
    ax = jv.plot.held(held)
    drawn = [line for line in ax.lines if (line.get_gid() or "").startswith("held") and len(line.get_xdata())]
    assert {line.get_linestyle() for line in drawn} == {"-", "--"}
    assert drawn[0].get_xdata()[0] == held.values[0, 0] and drawn[-1].get_ydata()[-1] == held.values[-1, 1]
    assert jv.plot.held(held, ax) is ax and len(ax.get_legend().get_texts()) == 3
    plt.close(ax.figure)
    other = replace(held, names=held.names[::-1])
    assert "must have the parameters of the curves that these Axes hold" in refusal(jv.plot.held, other, ax)
    assert refusal(held.table, "physical").startswith("units: physical units need scales")
