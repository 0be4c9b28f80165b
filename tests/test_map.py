"""Maps over parameters: each cell against a single run of it, by other routes; the same however it is cut."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.output import label_codes
from jaxvibro.output.label_codes import CHAOTIC, UNDECIDED, code_of, label_code_from_counts, label_of, period_of
from jaxvibro.plot.map import label_colour

REST = jv.State(0.0, 0.0)


def walls(distance=1.0):
    return jv.Wall(-distance), jv.Wall(distance)


def figure_4():
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, walls())


def single(scene, state=REST):
    """(label's code, exponent, error) of one cell by `spectrum`: copies of the motion, impacts counted, of a motion
    that rests without them."""
    found = jv.spectrum(scene, "amplitude", [float(scene.amplitude)], state, error=1e-2, most=2**17)
    n, rate, error = int(found["periods"][0]), float(found["exponent"][0, 0]), float(found["error"][0, 0])
    if n:
        hits = found["impacts_on"].values[0] * (found["rests"].values[0] == 0)
        return int(label_code_from_counts(n, *np.rint(n * hits).astype(int))), rate, error
    return (CHAOTIC if rate - 3.0 * error > 0.01 else UNDECIDED), rate, error


def agree(found, cells):
    """Holds every cell of a map against a single run of its scene; how many labels there are."""
    seen = set()
    for place, scene in cells.items():
        mine, rate, error = (found[name].values[place] for name in ("label", "exponent", "exponent_error"))
        code, known, unsure = single(scene)
        if UNDECIDED not in (mine, code):
            if code % label_codes.PERIODS_FACTOR == 0 and np.isneginf(known):
                mine = label_codes.PERIODS_FACTOR * period_of(mine)
            assert label_of(mine) == label_of(code), place
            apart = abs(rate - known) if np.isfinite(known) or np.isfinite(rate) else 0.0
            assert apart <= (1e-7 if code != CHAOTIC else 5.0 * (error + unsure)), place
            seen.add(int(mine))
    return len(seen)


def test_codes_and_labels():
    for label in ("P100", "P111", "P8-8-16", "P1-0-inf", "P32-998-0", "chaotic", "undecided", "not done"):
        assert label_of(code_of(label)) == label
    assert label_code_from_counts(3, 2, 998) == code_of("P3-2-998")
    np.testing.assert_array_equal(period_of(np.array([code_of("P464"), CHAOTIC, UNDECIDED, -1])), [4, 0, 0, 0])
    assert code_of("unresolved") == UNDECIDED


def test_cells_are_what_single_runs_find():
    scene, amplitude, frequency = figure_4(), np.linspace(2.0, 6.0, 4), np.array([1.6, 2.0, 2.3, 3.5])
    found = jv.map_parameters(scene, {"amplitude": amplitude, "frequency": frequency})
    assert found["label"].dims == ("amplitude", "frequency")
    cells = {
        (i, j): scene.replace(amplitude=a, frequency=w)
        for i, a in enumerate(amplitude)
        for j, w in enumerate(frequency)
    }
    assert agree(found, cells) >= 4
    assert found.attrs["damping"] == 0.05 and "amplitude" not in found.attrs
    told = dict(zip(found["label"].attrs["flag_values"], found["label"].attrs["flag_meanings"].split(), strict=True))
    assert told[code_of("P100")] == "P100" and set(told) == set(np.unique(found["label"]))
    assert (found["status"] == 0).all()


def scenes(seed):
    """Random scenes: one wall or two, anywhere, each with its own R, moving or soft; damping past critical too."""
    rng = np.random.default_rng(seed)
    kinds = rng.permutation(["one", "two", "moving", "soft", "damped", "mixed"])
    for kind in kinds:
        left = jv.Wall(-rng.uniform(0.5, 1.5), rng.uniform(0.3, 0.9))
        right = jv.Wall(rng.uniform(0.5, 1.5), rng.uniform(0.3, 0.9))
        if kind in ("moving", "mixed"):
            right = replace(right, motion=jv.Motion(rng.uniform(0.05, 0.3), rng.uniform(0, 6)))
        if kind in ("soft", "mixed"):
            left = jv.Wall(left.position, stiffness=rng.uniform(20, 500), damping=rng.uniform(0.1, 1.0))
        damping = rng.uniform(1.1, 2.0) if kind == "damped" else rng.uniform(0.02, 0.3)
        pair = (None, right) if kind == "one" else (left, right)
        yield jv.make_scene(rng.uniform(1, 5), rng.uniform(1, 3), damping, 0.7, pair)


def test_cells_of_random_scenes_are_what_single_runs_find():
    seen = 0
    for scene in scenes(25):
        amplitude = np.sort(np.random.default_rng(1).uniform(0.5, 6.0, 4))
        found = jv.map_parameters(scene, {"amplitude": amplitude})
        seen += agree(found, {(k,): scene.replace(amplitude=a) for k, a in enumerate(amplitude)})
    assert seen >= 8


def test_complete_chatter_has_its_label():
    scene = jv.make_scene(1.0, 0.2, 0.05, 0.6, (None, jv.Wall(0.2)))
    found = jv.map_parameters(scene, {"frequency": [0.2, 0.22]}, quantities=("label", "period"))
    known = [jv.find_attractors(scene.replace(frequency=w), 20)[0].label for w in (0.2, 0.22)]
    assert [label_of(int(code)) for code in found["label"]] == known == ["P1-0-inf"] * 2
    assert found["period"].values.tolist() == [1, 1]


def test_any_cut_gives_the_same_bits():
    grid = {"frequency": np.linspace(1.6, 3.0, 7), "amplitude": np.linspace(4.0, 6.0, 5)}
    one = jv.map_parameters(figure_4(), grid, quantities=("exponent", "state"))
    for chunk in (1, 3, 12):
        other = jv.map_parameters(figure_4(), grid, quantities=("exponent", "state"), chunk=chunk)
        xr.testing.assert_identical(other, one)


def test_a_carried_motion_is_the_sweeps():
    scene, values = figure_4().replace(frequency=2.8), np.linspace(3.0, 6.0, 13)
    grid = {"damping": [0.03, 0.05], "amplitude": values}
    found = jv.map_parameters(scene, grid, along="amplitude", quantities=("label", "state"))
    assert found["label"].dims == ("damping", "amplitude", "way")
    apart = 0
    for row, damping in enumerate(grid["damping"]):
        for way in (1, -1):
            mine = found.isel(damping=row).sel(way=way)
            swept = jv.sweep(scene.replace(damping=damping), "amplitude", values[::way], REST, 400, 64)
            last = swept["x"].values[::way, -1]
            single_period = period_of(mine["label"].values) == 1
            np.testing.assert_allclose(mine["x"].values[single_period], last[single_period], rtol=0, atol=1e-6)
            apart += single_period.sum()
    assert apart > 40
    assert (found["label"].sel(way=1) != found["label"].sel(way=-1)).any()  # hysteresis
    first = jv.map_parameters(scene, {"amplitude": values, "damping": [0.03]}, along="amplitude")
    np.testing.assert_array_equal(first["label"].values[:, 0], found["label"].values[0])


def test_random_starts_are_those_of_find_attractors():
    scene = figure_4()
    grid = {"amplitude": [4.65, 5.0]}
    asked = ("label", "period", "exponent", "attractors", "loads")
    found = jv.map_parameters(scene, grid, 60, asked, seed=3)
    for k, amplitude in enumerate(grid["amplitude"]):
        known = [one for one in jv.find_attractors(scene.replace(amplitude=amplitude), 60, 3) if one.share > 0]
        mine = found.isel(amplitude=k, attractor=slice(len(known)))
        assert sorted(map(label_of, mine["label"].values.tolist())) == sorted(one.label for one in known)
        np.testing.assert_array_equal(np.sort(mine["share"]), np.sort([one.share for one in known]))
        by_share = sorted(known, key=lambda one: (-one.share, code_of(one.label)))
        off = abs(mine["exponent"].values - [one.exponent for one in by_share])
        assert (off <= np.where(mine["period"].values > 0, 1e-8, 5.0 * mine["exponent_error"].values)).all()
        here = scene.replace(amplitude=amplitude)
        for place, one in enumerate(by_share):
            if one.periods:
                loads = jv.wall_loads(here, one.state, one.periods)
                for name in ("largest_speed", "work_rate"):
                    np.testing.assert_allclose(mine[name].values[place], loads[name], rtol=1e-6)
        assert int(found["attractors"][k]) == len(known)
        assert float(found["unresolved"][k]) == 0.0
        assert found["share"].values[k, len(known) :].tolist() == [0.0] * (8 - len(known))


def test_chaotic_starts_on_one_set_are_one_attractor():
    found = jv.map_parameters(figure_4(), {"frequency": [1.6]}, 12, ("attractors",))
    assert int(found["attractors"][0]) == 1
    assert int(found["label"][0, 0]) == CHAOTIC and float(found["share"][0, 0]) == 1.0


def test_a_store_is_gone_on_with(tmp_path):
    grid, seen = {"frequency": np.linspace(1.6, 3.0, 6)}, []
    whole = jv.map_parameters(figure_4(), grid, chunk=2)
    kept = jv.map_parameters(figure_4(), grid, chunk=2, store=jv.Store(tmp_path / "map"), progress=seen.append)
    xr.testing.assert_identical(kept, whole)
    assert [one.done for one in seen] == [0, 2, 4, 6]
    again = jv.map_parameters(figure_4(), grid, chunk=2, store=jv.Store(tmp_path / "map"), progress=seen.append)
    xr.testing.assert_identical(again, whole)
    assert seen[4:] == [seen[4]] and seen[4].done == 6
    other = figure_4().replace(frequency=1.0)  # which the grid gives anyway
    assert jv.map_parameters(other, grid, chunk=2, store=jv.Store(tmp_path / "map")).identical(whole)
    with pytest.raises(jv.ArgumentError, match=r"scene differs; got 'damping = 0.05 stored, damping = 0.06"):
        jv.map_parameters(figure_4().replace(damping=0.06), grid, chunk=2, store=jv.Store(tmp_path / "map"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"grid": {}}, "grid: must be a mapping {name: values}"),
        ({"grid": {"omega": [1.0]}}, "omega: is not a parameter of this scene, perhaps frequency"),
        ({"grid": {"frequency": [2.0, 1.0]}}, "frequency: must be one or more numbers in increasing order"),
        ({"grid": {"frequency": [1.0, np.nan]}}, "frequency.*: must be finite"),
        ({"grid": {"restitution": [0.5, 1.5]}}, "restitution"),
        ({"start": 0}, "start: must be a whole number from 1 on"),
        ({"start": jv.State(3.0, 0.0)}, "state.x.*: must lie between the walls at each cell"),
        ({"start": 5, "along": "frequency"}, "start: must be a State if the motion is carried along a parameter"),
        ({"along": "amplitude"}, r"along: must be a parameter of the grid \(frequency\)"),
        ({"quantities": ("speed",)}, "quantities: must be some of label, period"),
        ({"quantities": ("attractors",)}, "quantities: must not contain attractors if a cell has one initial state"),
        ({"settle": -1}, "settle: must be a whole number"),
        ({"chunk": 0}, "chunk: must be a whole number"),
    ],
)
def test_what_cannot_be_is_refused(change, told):
    with pytest.raises(jv.ArgumentError, match=told):
        jv.map_parameters(figure_4(), **{"grid": {"frequency": [1.0, 2.0]}} | change)


def drawn():
    grid = {"amplitude": [1.0, 2.0, 3.0], "frequency": [1.5, 2.0]}
    label = np.array([[code_of("P100"), code_of("P111")], [CHAOTIC, UNDECIDED], [code_of("P111"), -1]], np.int32)
    data = {"label": (tuple(grid), label), "exponent": (tuple(grid), np.linspace(-1, 2, 6).reshape(3, 2))}
    return xr.Dataset(data, grid, {"scene_file": ""})


def test_picture_of_a_map():
    ax = jv.plot.map(drawn(), Figure().subplots())
    assert ax.get_xlabel().startswith("drive frequency") and ax.get_ylabel().startswith("drive amplitude")
    assert ax.get_xlim() == (1.25, 2.25) and ax.get_ylim() == (0.5, 3.5)
    shown = ax.images[0].to_rgba(ax.images[0].get_array())
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told == ["P111", "not done", "undecided", "chaotic", "P100"]
    assert len(np.unique(shown.reshape(-1, 4), axis=0)) == 5
    assert len({label_colour(code_of(f"P{n}{p}{q}")) for n in (1, 2, 3) for p in (0, 1, 2) for q in (0, 1)}) >= 12
    assert len({label_colour(code_of(f"P22{q}")) for q in range(2, 7)}) == 5
    other = jv.plot.map(drawn(), Figure().subplots(), "exponent")
    assert len(other.figure.axes) == 2
    with pytest.raises(jv.ArgumentError, match="must be one of label, exponent"):
        jv.plot.map(drawn(), quantity="period")
    with pytest.raises(jv.ArgumentError, match="select from the others first"):
        jv.plot.map(drawn().expand_dims(way=[1, -1]))
    with pytest.raises(jv.ArgumentError, match="must be given a Dataset of map_parameters"):
        jv.plot.map(xr.Dataset())
    assert label_codes.CODE_RULE.startswith("1000000 n")
