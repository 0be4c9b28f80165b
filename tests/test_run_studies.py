"""Runs of scene files with the tables [branch], [explore], [locus] and [orbits]: numbers, texts, data and pictures."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import mpmath
import msgspec
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci.loci_of_branches import contains_point, count_points_to_follow, follow_loci
from jaxvibro.studies.result_pictures import describe_scene, draw_loci_picture, draw_main_picture
from jaxvibro.studies.scene_file import read_scene_file
from tests.reference import closed
from tests.scene_files import SCENE, SCENES, refusal

RUN = sys.modules[jv.run.__module__]
FOLD, GRAZING, BREAKING = 0.508057896812, 3.416460156361, 3.543892249375
PAIR, LOW, HIGH = ("amplitude", "frequency"), 2.0, 2.3
BRANCH = "branch={parameter='amplitude', bounds=[0.0, 4.0], start={x=0.9, v=-1.1}, at={amplitude=2.0}}\n"
EXPLORE = "explore={parameter='amplitude', bounds=[0.0, 4.0], at={damping=0.06}, max_period=2, seed=3, budget=7}\n"
ORBITS = "orbits={max_period=1, starts=20}\n"
LOCI = (SCENES / "loci.toml").read_text()
FEW_BRANCHES = ["branch.bounds=[0.0, 4.0]", "branch.max_period=1"]
SMALL_LOCI = [f"locus.bounds={{amplitude=[0.0, 12.0], frequency=[{LOW}, {HIGH}]}}", "locus.kinds=['SN', 'GR']"]
STUDY = "jaxvibro.studies.scene_file_studies."  # its functions have tests of their own


def run(folder, text, changes=()):
    """Run a scene file; return its folder, summary, table and data, and the `StudyResults`."""
    (folder / "study.toml").write_text(text)
    results, run_studies = [], RUN.run_studies
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RUN, "run_studies", lambda *given: results.append(run_studies(*given)) or results[0])
        done = jv.run(folder / "study.toml", folder / "out", changes)
    data = jv.load_data(folder / "out" / "study.nc")
    files = {path.name.removeprefix("study.") for path in (folder / "out").iterdir()}
    lines = [" ".join(line.split()) for line in done.table.splitlines()]
    return SimpleNamespace(summary=done.summary, lines=lines, data=data, files=files, results=results[0])


@pytest.fixture(scope="module")
def branches(tmp_path_factory):
    return run(tmp_path_factory.mktemp("branch"), BRANCH + SCENE)


@pytest.fixture(scope="module")
def loci(tmp_path_factory):
    return run(tmp_path_factory.mktemp("loci"), LOCI, FEW_BRANCHES + SMALL_LOCI)


@pytest.fixture(scope="module")
def orbits(tmp_path_factory):
    return run(tmp_path_factory.mktemp("orbits"), ORBITS + SCENE)


def test_special_points_of_branches(branches):
    main, *others = branches.summary["branches"]
    kinds = [("EP", "P100"), ("GR", "P111"), ("SN", "P111"), ("SB", "P111"), ("EP", "P111")]
    assert [(point["kind"], point["label"]) for point in main["special"]] == kinds
    values = [point["value"] for point in main["special"]]
    np.testing.assert_allclose(values, [0.0, GRAZING, FOLD, BREAKING, 4.0], atol=1e-11)
    assert [segment["label"] for segment in main["segments"]] == ["P100", "P111"]
    assert (main["parameter"], main["from"], main["to"]) == ("amplitude", 0.0, 4.0)
    assert main["special"][1]["meets"] == ["P100<", "P111<"]
    fold = main["special"][2]
    assert fold["residual"] < 1e-13 and fold["itinerary"] == ["RL"]
    np.testing.assert_allclose(fold["multipliers"][0], [1.0, 0.0], atol=1e-9)
    assert [branch["label"] for branch in others] == ["P111", "P111"]
    for branch in others:
        np.testing.assert_allclose([branch["from"], branch["to"]], [BREAKING, 4.0], atol=1e-11)
        assert [point["kind"] for point in branch["special"]] == ["EP", "EP"]
    starts = f"SN {FOLD:.12g} P111 saddle to stable RL 1, 0.178013 -", "1: P100 from 0 to 4, ", "2: P111 from 3.543892"
    assert all(any(line.startswith(start) for line in branches.lines) for start in starts)
    assert sum(line.startswith("GR 3.4164601563") for line in branches.lines) == 1
    assert "last point: the parameter reached its bound 4" in branches.lines


def test_data_of_branches(branches):
    summary, data = branches.summary["branches"], branches.data
    assert branches.files == {"png", "nc", "txt"} and data.sizes["branch_period"] == 1
    assert np.bincount(data["branch_number"]).tolist() == [branch["points"] for branch in summary]
    values, points = data["special_value"].values, [point for branch in summary for point in branch["special"]]
    assert data["special_kind"].values.tolist() == [point["kind"] for point in points]
    assert values.tolist() == [point["value"] for point in points]
    np.testing.assert_array_equal(data["branch_value"][data["special_point"].values], values)
    np.testing.assert_array_equal(data["branch_number"][data["special_point"].values], data["special_branch"])
    assert data["branch_value"].attrs["parameter"] == "amplitude" and data["branch_x"].attrs["units"] == "length"
    first = data.isel(branch_point=data["branch_number"].values == 0)
    np.testing.assert_array_equal(first["branch_x"], branches.results.branches[0].data["x"])
    assert data["branch_last_reason"].values.tolist() == 3 * ["the parameter reached its bound 4"]


def test_the_heading_of_a_picture_names_the_drive_and_then_the_walls():
    scene = jv.make_scene(0.5, 2.0, 0.1, 0.7, (-1.0, 1.5))
    drive, walls = describe_scene(scene, ["amplitude"], "scene").split("\n")
    assert (drive, walls) == (r"$\omega$ = 2,  $\gamma$ = 0.1,  $R$ = 0.7", "left wall at -1,  right wall at 1.5")
    free = describe_scene(jv.make_scene(0.5, 2.0, 0.1, 0.7, (None, None)), [], "scene").split("\n")
    assert free == [r"$A$ = 0.5,  $\omega$ = 2,  $\gamma$ = 0.1", "no walls"]


@pytest.mark.filterwarnings("ignore:No artists with labels")
def test_branches_are_drawn_alone_or_over_a_sweep_along_their_parameter(branches, monkeypatch):
    drawn, results = [], branches.results
    monkeypatch.setattr(jv.plot, "branch", lambda branch, variable, ax, units: drawn.append(variable))
    monkeypatch.setattr(jv.plot, "diagram", lambda swept, variable, ax, faint, units: drawn.append((variable, faint)))
    draw_main_picture(results)
    assert drawn == 3 * ["x"] + 3 * ["v"]
    moved = ["sweep.parameter='right.position'", "sweep.legs.0.to=2", "sweep.legs.1.from=2"]
    over, alone = [("x", True), *3 * ["x"], ("v", True), *3 * ["v"]], [("x", False), ("v", False)]
    for changes, expected in (([], over), (["branch.at.damping=0.06"], alone), (moved, alone)):
        drawn.clear()
        file = read_scene_file(SCENES / "branches.toml", ["branch.bounds=[0.0, 4.0]", *changes])
        draw_main_picture(replace(results, file=msgspec.structs.replace(file, attractors=None)))
        assert drawn == expected


def test_a_start_that_settles_on_no_orbit_is_refused(tmp_path):
    (tmp_path / "lost.toml").write_text(BRANCH + SCENE)
    changes = ["branch.at.amplitude=5.26", "branch.bounds=[0.0,6.0]", "branch.settle=100"]
    line = refusal(jv.run, tmp_path / "lost.toml", tmp_path / "out", changes)
    assert line.startswith("branch.start: must lead to an orbit that can be followed (no orbit: th")
    assert not (tmp_path / "out").exists()


def test_symmetric_orbits_that_cross_a_loop_of_asymmetric_ones_are_followed(tmp_path):
    """The loop, P101 and P111 and their mirror images, goes through an SB, where the symmetric P111 crosses it."""
    numbers = {"amplitude": 0.6871, "frequency": 0.8333, "damping": 0.015, "restitution": 0.6}
    text = SCENE + '[branch]\nparameter = "frequency"\nbounds = [0.5, 3.0]\n'
    loop, *crossing = run(tmp_path, text, [f"{key}={value}" for key, value in numbers.items()]).results.branches
    (breaking,) = [point.value for point in loop.points("SB")]
    assert "closed" in repr(loop) and breaking == pytest.approx(0.914752380254, abs=1e-9)
    for branch, value in zip(crossing, (0.5, 3.0), strict=True):
        assert branch.values[-1] == value and branch.special[0].label == "P111"
        assert branch.values[0] == pytest.approx(breaking, abs=1e-9)
    points = [(point.kind, point.value) for point in crossing[1].special[1:-1]]
    assert [kind for kind, _ in points] == ["SN", "GR"]
    np.testing.assert_allclose([value for _, value in points], [2.372, 1.2985], atol=6e-5)


def test_an_explored_diagram_is_reported_and_drawn_as_branches(branches, tmp_path, monkeypatch):
    calls, branch = [], branches.results.branches[0]
    orbit = jv.find_orbit(branch.scene.replace(amplitude=0.1), jv.State(0.0, 0.0), settle=100)
    without_impacts = jv.follow(orbit, "amplitude", (0.05, 0.25))

    def explore(scene, name, bounds, **settings):
        settings.pop("progress")(1)
        calls.append((scene, name, bounds, settings))
        return jv.Diagram(name, bounds, scene, (branch, without_impacts), (), True, "all was followed", {})

    monkeypatch.setattr(STUDY + "explore", explore)
    study = run(tmp_path, EXPLORE + SCENE)
    ((scene, name, bounds, settings),) = calls
    assert (name, bounds) == ("amplitude", (0.0, 4.0))
    assert settings == {"max_period": 2, "seed": 3, "budget": 7, "max_seconds": None}
    assert [float(scene.parameter(key)) for key in ("amplitude", "frequency", "damping")] == [4.65, 2.1, 0.06]
    assert (
        study.results.diagram_branches == (branch, without_impacts)
        and float(study.results.diagram_scene.damping) == 0.06
    )
    summary, _ = study.summary["branches"]
    assert [point["kind"] for point in summary["special"]] == [point.kind for point in branch.special]
    assert study.summary["explored"] == {"complete": True, "reason": "all was followed"}
    start = "from many starts at damping = 0.06, max_period 2 (seed 3): 2"
    place = study.lines.index(f"branches of periodic orbits for amplitude from 0 to 4, {start}")
    assert study.lines[place + 1] == "all was followed"
    for point in branch.special:
        row = f"{point.kind} {point.value:.12g} {point.label}"
        assert sum(line.startswith(row) for line in study.lines) == 1
    np.testing.assert_array_equal(study.data["branch_value"], [*branch.values, *without_impacts.values])
    assert without_impacts.data.sizes["impact"] == 0 and study.data.sizes["branch_impact"] == 2
    np.testing.assert_array_equal(study.data["branch_side"] == 0, np.isnan(study.data["branch_time"]))


def test_a_refusal_of_explore_names_the_key_of_the_file(tmp_path, monkeypatch):
    def explore(*given, **settings):
        raise jv.ArgumentError("bounds", "must hold some value", [0.0, 4.0])

    monkeypatch.setattr(STUDY + "explore", explore)
    assert refusal(run, tmp_path, EXPLORE + SCENE) == "explore.bounds: must hold some value; got [0.0, 4.0]"
    assert not (tmp_path / "out").exists()


def fold_amplitude(gamma, frequency, wall):
    return closed.fold(gamma, frequency, 0.7, wall, symmetric=True).amplitude


def test_ends_of_loci(loci):
    summary = loci.summary["loci"]
    assert [(locus["kind"], locus["label"], locus["parameters"]) for locus in summary] == [
        ("GR", "P111", list(PAIR)),
        ("SN", "P111", list(PAIR)),
    ]
    assert loci.summary["not_followed"] == [] and not any("not followed" in line for line in loci.lines)
    assert "loci of special points in amplitude from 0 to 12 and frequency from 2 to 2.3: 2" in loci.lines
    for place, (locus, expected) in enumerate(zip(summary, (closed.grazing, fold_amplitude), strict=True), 1):
        frequencies = [point["values"]["frequency"] for point in locus["special"]]
        assert sorted(frequencies) == [LOW, HIGH]
        assert locus["reasons"] == [f"frequency reached its bound {value:g}" for value in frequencies]
        assert f"{place}: {locus['kind']} of P111, {locus['points']} points" in loci.lines
        for point in locus["special"]:
            amplitude, frequency = point["values"].values()
            with mpmath.workdps(30):
                assert abs(amplitude - float(expected(0.05, frequency, 1.0))) < 1e-12
            assert point["residual"] < 1e-12 and point["itinerary"] == ["RL"] and len(point["multipliers"]) == 2
            assert point["kind"] == "EP" and f"EP {amplitude:.12g} {frequency:.12g} P111 RL" in loci.lines
    assert any(line.startswith("CP cusp, ") for line in loci.lines)


def test_data_of_loci(loci):
    data, curves = loci.data, loci.results.loci
    assert loci.files == {"png", "loci.png", "nc", "txt"} and loci.summary["files"]["loci"].endswith("study.loci.png")
    assert np.bincount(data["locus_number"]).tolist() == [len(curve) for curve in curves]
    for column, name in enumerate(PAIR):
        expected = np.concatenate([curve.values[:, column] for curve in curves])
        np.testing.assert_array_equal(data[f"locus_{name}"], expected)
    assert data["locus_kind"].values.tolist() == ["GR", "SN"]
    assert data["locus_first_reason"].values.tolist() == [curve.reasons[0] for curve in curves]
    ends = data["locus_frequency"].values[data["codim2_point"].values]
    assert sorted(ends) == [LOW, LOW, HIGH, HIGH] and data["codim2_locus"].values.tolist() == [0, 0, 1, 1]
    assert data["codim2_kind"].values.tolist() == 4 * ["EP"]


class MirrorLocus(jv.Locus):
    """The points of a locus, with another label."""

    label = values = None

    def __init__(self, label, locus):
        special = 2 * (SimpleNamespace(kind="EP", itinerary=({"P112": "RLR", "P121": "LRL", "P111": "RL"}[label],)),)
        fields = {key: getattr(locus, key) for key in ("kind", "names", "bounds", "values")}
        vars(self).update(fields, label=label, special=special)

    def __len__(self):
        return len(self.values)


def test_the_picture_of_loci_has_their_bounds_and_draws_mirror_images_once(loci, monkeypatch):
    results, labels, regions, figures = loci.results, [], [], []
    draw = jv.plot.locus
    monkeypatch.setattr(
        jv.plot, "locus", lambda curve, ax, **more: labels.append(curve.label) or draw(curve, ax, **more)
    )
    monkeypatch.setattr(
        jv.plot, "region", lambda one, two, text, ax, **more: regions.append(({one.kind, two.kind}, text))
    )
    monkeypatch.setattr("jaxvibro.studies.result_pictures.png_bytes", figures.append)
    for curves in ([MirrorLocus(label, results.loci[1]) for label in ("P112", "P121", "P111")], ()):
        draw_loci_picture(replace(results, branches=(), loci=curves))
    assert labels == ["P112", "P111"] and regions == []
    assert figures[0].axes[0].get_ylim() == (LOW, HIGH)
    texts = [text.get_text() for text in figures[0].legends[0].get_texts()]
    assert texts == ["SN of P112 and mirror image", "SN of P111"]
    assert "0.05" in figures[0].get_suptitle() and "2.1" not in figures[0].get_suptitle()
    assert figures[1].axes[0].get_xlim() == (0.0, 12.0) and not figures[1].legends
    draw_loci_picture(replace(results, loci=results.loci[:1]))
    unstable = [replace(one, data=one.data.assign(stable=0 * one.data["stable"])) for one in results.branches]
    draw_loci_picture(replace(results, branches=unstable))
    assert regions == []
    draw_loci_picture(results)  # the region of the two stable motions
    assert regions == [({"SN", "GR"}, "P100 and P111")]


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, np.pi / 2, 2.5])
def test_a_point_between_the_rows_of_a_locus_is_on_it_and_one_beside_it_is_not(angle):
    """The locus is a parabola, turned by an angle, whose rows are as far apart as those of a locus are."""
    cos, sin, rows = np.cos(angle), np.sin(angle), np.linspace(-2.0, 2.0, 41)

    def parabola(t):
        return 5.0 + np.stack([cos * t - sin * t * t, sin * t + cos * t * t], axis=-1)

    bounds = dict.fromkeys(PAIR, (0.0, 10.0))
    curve = SimpleNamespace(kind="SN", label="P111", names=PAIR, values=parabola(rows), bounds=bounds)
    for t in np.linspace(-1.99, 1.99, 77):
        assert contains_point(curve, parabola(t)), t
    for t in rows[1:-1]:
        for offset in (1e-4, -1e-4, 0.1):
            assert not contains_point(curve, parabola(t) + offset * np.array([-sin, cos])), (t, offset)
    assert not contains_point(curve, parabola(2.05)) and not contains_point(curve, [0.0, 0.0])


def test_special_points_on_one_locus_are_followed_once(monkeypatch):
    """At A = 2 both symmetry breakings along the frequency are on one curve."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "frequency", (1.0, 3.0))
    first, second = branch.points("SB")
    bounds, counts, followed = {"amplitude": (1.0, 2.5), "frequency": (1.05, 1.7)}, [], []
    curves, refused = follow_loci([branch], PAIR, bounds, progress=counts.append)
    assert [curve.kind for curve in curves] == ["SB"] and refused == () and counts == [1, 2]
    narrow = bounds | {"frequency": (1.3, 1.7)}
    assert [count_points_to_follow([branch], given) for given in (bounds, narrow)] == [2, 1]
    assert all(contains_point(curves[0], [2.0, point.value]) for point in (first, second))
    assert not contains_point(curves[0], [2.0, first.value + 1e-5])
    monkeypatch.setattr(
        "jaxvibro.loci.loci_of_branches.locus", lambda point, *given, **more: followed.append(point) or curves[0]
    )
    follow_loci([branch, branch], PAIR, bounds, ("SN", "SB"))
    follow_loci([branch], PAIR, bounds, ("SN", "PD"))
    follow_loci([branch], PAIR, {"amplitude": (2.1, 2.5), "frequency": (1.05, 1.7)})
    assert followed == [first]


def test_a_point_that_cannot_be_followed_is_reported(tmp_path):
    """A symmetry breaking does not persist in a scene whose walls differ."""
    bounds = "{amplitude=[0.0, 9.0], 'right.position'=[0.5, 2.0]}"
    locus = f"locus={{parameters=['amplitude', 'right.position'], kinds=['SB'], bounds={bounds}}}"
    study = run(tmp_path, LOCI[: LOCI.index("[locus]")], [*FEW_BRANCHES, locus])
    (row,) = study.summary["not_followed"]
    assert study.results.loci == () and (row["kind"], row["label"]) == ("SB", "P111")
    assert row["reason"].startswith("must keep the scene symmetric")
    assert row["value"] == pytest.approx(BREAKING, abs=1e-7)
    assert f"not followed: SB of P111 at amplitude = {row['value']:.12g}: {row['reason']}" in study.lines


def test_orbits_are_reported_with_their_multipliers(orbits):
    summary = orbits.summary["orbits"]
    assert "stretches" not in orbits.summary and "attractors" not in orbits.summary
    assert [orbit["label"] for orbit in summary] == 3 * ["P111"] + 2 * ["P112"] + 2 * ["P121"]
    assert [orbit["mirror_of"] for orbit in summary] == [1, 0, 2, 5, 6, 3, 4]
    multipliers = {(orbit["label"], orbit["stable"]): orbit["multipliers"] for orbit in summary}
    expected = {
        ("P111", True): [[-0.111244, 0.406986], [-0.111244, -0.406986]],
        ("P111", False): [[2.333002, 0.0], [0.076302, 0.0]],
    }
    for label in ("P112", "P121"):
        expected[label, True] = [[-0.400941, 0.0], [-0.217554, 0.0]]
        expected[label, False] = [[4.759687, 0.0], [0.018326, 0.0]]
    for key, pair in expected.items():
        np.testing.assert_allclose(multipliers[key], pair, atol=1e-6)
    assert all(orbit["residual"] < 1e-13 and orbit["least_speed"] > 0.5 for orbit in summary)
    assert summary[2]["least_clearance"] is None and summary[2]["itinerary"] == ["RL"]
    assert any(line.startswith("1 P111 stable -0.1112439 +- 0.4069862i") for line in orbits.lines)
    (line,) = (line for line in orbits.lines if line.startswith("3 P111"))
    assert line.startswith("3 P111 unstable 2.333002, 0.0763021 0.738379306639 2.619343180748 RL 2.94569 inf ")
    assert line.endswith(" itself") and any("x and v at phase 0;" in line for line in orbits.lines)


def test_data_of_orbits(orbits):
    data, summary = orbits.data, orbits.summary["orbits"]
    assert orbits.files == {"png", "nc", "txt"} and dict(data.sizes) == {"orbit": 7, "multiplier": 2}
    for column, key in (("label", "label"), ("mirror", "mirror_of"), ("stable", "stable")):
        assert data[f"orbit_{column}"].values.tolist() == [orbit[key] for orbit in summary]
    multipliers = np.stack([data["orbit_multiplier_real"], data["orbit_multiplier_imag"]], -1)
    np.testing.assert_array_equal(multipliers, [orbit["multipliers"] for orbit in summary])
    for key in ("x", "v", "phase"):
        np.testing.assert_array_equal(data[f"orbit_{key}"], [orbit["state"][key] for orbit in summary])
    units = [data[f"orbit_{key}"].attrs["units"] for key in ("x", "v", "phase", "multiplier_real", "least_speed")]
    assert units == ["length", "length w0", "rad", "1", "length w0"]


def test_orbits_that_are_attractors_are_marked_once(tmp_path, monkeypatch):
    marked, drawn = [], []
    for name in ("mark", "mark_orbits"):
        monkeypatch.setattr(jv.plot, name, lambda some, value, variable, ax, units: marked.append((len(some), value)))
    monkeypatch.setattr(jv.plot, "orbit", lambda orbit, ax, units: drawn.append(orbit.label))
    changes = [f"sweep.{key}=5" for key in ("count", "settle", "keep")] + ["attractors.starts=50"]
    changes += ["orbits={max_period=1, starts=20, at={amplitude=4.65}}"]
    text = (SCENES / "branches.toml").read_text()
    results = run(tmp_path, text[: text.index("[branch]")], changes).results
    assert [attractor.kind for attractor in results.attractors] == 4 * ["periodic"] and len(results.orbits) == 7
    others = [(orbit.label, orbit.stable, orbit.mirror_of) for orbit in results.other_orbits]
    assert others == [("P111", False, 0), ("P112", False, 2), ("P121", False, 1)]
    assert marked == 2 * [(4, 4.65), (3, 4.65)] and drawn == []
    file = msgspec.structs.replace(results.file, sweep=None, attractors=None)
    draw_main_picture(replace(results, file=file, swept=None, attractors=None, orbits=2 * results.orbits))
    assert drawn == 3 * ["P111"] + 2 * ["P112"] + 2 * ["P121"] + 2 * ["P111"]  # nine portraits at most


def test_orbits_of_another_scene_or_phase_and_none(orbits, tmp_path, monkeypatch):
    """Orbits of another scene stay out of the diagram; a phase other than 0 is reported; so is that there are none."""
    first, *_, other = orbits.results.orbits
    moved, marked = replace(other, state=jv.State(0.2, -0.4, 1.8, 0.0)), []
    monkeypatch.setattr(jv.plot, "mark_orbits", lambda *given: marked.append(given))
    sweep = (
        "sweep={parameter='amplitude', count=3, settle=5, keep=5, legs=[{name='a', from=1, to=2, start={x=0, v=0}}]}"
    )
    for name, found, changes in (("moved", (first, moved), [sweep, "orbits.at.damping=0.1"]), ("none", (), [])):
        (tmp_path / name).mkdir()
        monkeypatch.setattr(STUDY + "find_orbits", lambda *given, found=found, **settings: found)
        study = run(tmp_path / name, ORBITS + SCENE, changes)
        table = " ".join(study.lines)
        assert len(study.summary["orbits"]) == len(found) and study.files == {"png", "nc", "txt"}
        assert ("20 starts (seed 0): none found" in table) == (not found)
        assert ("x and v at the phase (rad) given" in table) == bool(found)
        assert (" 0.200000000000 -0.400000000000 1.800000000000 " in table) == bool(found)
    assert marked == []
