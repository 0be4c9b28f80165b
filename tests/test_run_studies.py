"""Runs of scene files with the tables [branch], [explore], [locus] and [orbits]: numbers, texts, data and pictures."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import mpmath
import msgspec
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci import loci_of_branches
from jaxvibro.loci.bistability import find_coexistence_loci
from jaxvibro.studies import result_pictures, results_report
from jaxvibro.studies.scene_file import read_scene_file
from jaxvibro.studies.scene_file_studies import StudyResults
from tests.reference import closed
from tests.scene_files import SCENE, SCENES

RUN = sys.modules[jv.run.__module__]
FOLD, GRAZING, BREAKING = 0.508057896812, 3.416460156361, 3.543892249375
PAIR, LOW, HIGH = ("amplitude", "frequency"), 2.0, 2.3
BRANCH = """
[branch]
parameter = "amplitude"
bounds = [0.0, 4.0]
start = {x = 0.9, v = -1.1}
at = {amplitude = 2.0}
"""
EXPLORE = """
[explore]
parameter = "amplitude"
bounds = [0.0, 4.0]
at = {damping = 0.06}
max_period = 2
seed = 3
budget = 7
"""
LOCI = (SCENES / "loci.toml").read_text()
SMALL_LOCI = [
    "branch.bounds = [0.0, 4.0]",
    "branch.max_period = 1",
    f"locus.bounds = {{amplitude = [0.0, 12.0], frequency = [{LOW}, {HIGH}]}}",
    "locus.kinds = ['SN', 'GR']",
]
ORBITS = "orbits = {max_period = 1, starts = 20}\n"


def run(folder, text, changes=()):
    """Run a scene file; return its folder, summary, table and data, and the `StudyResults`."""
    (folder / "study.toml").write_text(text)
    results, run_studies = [], RUN.run_studies
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RUN, "run_studies", lambda *given: results.append(run_studies(*given)) or results[0])
        done = jv.run(folder / "study.toml", folder / "out", changes)
    data = jv.load_data(folder / "out" / "study.nc")
    lines = [" ".join(line.split()) for line in done.table.splitlines()]
    return SimpleNamespace(out=folder / "out", summary=done.summary, lines=lines, data=data, results=results[0])


@pytest.fixture(scope="module")
def branches(tmp_path_factory):
    return run(tmp_path_factory.mktemp("branch"), SCENE + BRANCH)


@pytest.fixture(scope="module")
def loci(tmp_path_factory):
    return run(tmp_path_factory.mktemp("loci"), LOCI, SMALL_LOCI)


@pytest.fixture(scope="module")
def orbits(tmp_path_factory):
    return run(tmp_path_factory.mktemp("orbits"), ORBITS + SCENE)


def files(study):
    return {path.name.removeprefix("study.") for path in study.out.iterdir()}


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
    sizes = [branch["points"] for branch in summary]
    assert files(branches) == {"png", "nc", "txt"} and data.sizes["branch_period"] == 1
    assert np.bincount(data["branch_number"]).tolist() == sizes
    kinds, values = data["special_kind"].values, data["special_value"].values
    assert kinds.tolist() == [point["kind"] for branch in summary for point in branch["special"]]
    for kind, value in (("SN", FOLD), ("GR", GRAZING), ("SB", BREAKING)):
        np.testing.assert_allclose(values[kinds == kind], [value], atol=1e-11)
    np.testing.assert_array_equal(data["branch_value"][data["special_point"].values], values)
    np.testing.assert_array_equal(data["branch_number"][data["special_point"].values], data["special_branch"])
    assert data["branch_value"].attrs["parameter"] == "amplitude" and data["branch_x"].attrs["units"] == "length"
    first = data.isel(branch_point=data["branch_number"].values == 0)
    np.testing.assert_array_equal(first["branch_x"], branches.results.branches[0].data["x"])
    assert data["branch_last_reason"].values.tolist() == 3 * ["the parameter reached its bound 4"]


@pytest.mark.filterwarnings("ignore:No artists with labels")
def test_branches_are_drawn_alone_or_over_a_sweep_along_their_parameter(branches, monkeypatch):
    drawn, results = [], branches.results
    monkeypatch.setattr(jv.plot, "branch", lambda branch, variable, ax, units: drawn.append(variable))
    monkeypatch.setattr(jv.plot, "diagram", lambda swept, variable, ax, faint, units: drawn.append((variable, faint)))

    def drawn_with(*changes):
        drawn.clear()
        file = read_scene_file(SCENES / "branches.toml", ["branch.bounds=[0.0, 4.0]", *changes])
        result_pictures.draw_main_picture(replace(results, file=msgspec.structs.replace(file, attractors=None)))
        return list(drawn)

    result_pictures.draw_main_picture(results)
    assert drawn == 3 * ["x"] + 3 * ["v"]
    assert drawn_with() == [("x", True), *3 * ["x"], ("v", True), *3 * ["v"]]
    assert drawn_with("branch.at.damping=0.06") == [("x", False), ("v", False)]
    moved = ["sweep.parameter='right.position'", "sweep.legs.0.to=2", "sweep.legs.1.from=2"]
    assert drawn_with(*moved) == [("x", False), ("v", False)]


def test_a_diagram_takes_what_belongs_to_the_same_scene(branches):
    results = branches.results
    assert (results.diagram_parameter, results.diagram_value(results.file.branch)) == ("amplitude", 2.0)
    tables = [
        read_scene_file(SCENES / "branches.toml", [f"orbits.at={at}"]).orbits
        for at in ("{amplitude=3}", "{damping=0.1}", "{}")
    ]
    assert [results.diagram_value(table) for table in tables] == [3.0, None, 4.65]


def test_a_start_that_settles_on_no_orbit_is_one_clear_line(tmp_path):
    (tmp_path / "lost.toml").write_text(SCENE + BRANCH)
    changes = ["branch.at.amplitude=5.26", "branch.bounds=[0.0,6.0]", "branch.settle=100"]
    with pytest.raises(
        jv.SceneError, match=r"^branch.start: must lead to an orbit that can be followed \(no orbit: th"
    ):
        jv.run(tmp_path / "lost.toml", tmp_path / "out", changes)
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
    """`explore` itself is replaced: it has tests of its own."""
    asked, branch = [], branches.results.branches[0]

    def explore(scene, name, bounds, **settings):
        settings.pop("progress")(1)
        asked.append((scene, name, bounds, settings))
        return jv.Diagram(name, bounds, scene, (branch,), (), True, "all was followed", {})

    monkeypatch.setattr(sys.modules[StudyResults.__module__], "explore", explore)
    study = run(tmp_path, SCENE + EXPLORE)
    ((scene, name, bounds, settings),) = asked
    assert (name, bounds) == ("amplitude", (0.0, 4.0))
    assert settings == {"max_period": 2, "seed": 3, "budget": 7, "max_seconds": None}
    assert [float(scene.parameter(key)) for key in ("amplitude", "frequency", "damping")] == [4.65, 2.1, 0.06]
    results = study.results
    assert (results.branches, results.diagram_branches, results.diagram_parameter) == ((branch,), (branch,), name)
    assert float(results.diagram_scene.damping) == 0.06
    (summary,) = study.summary["branches"]
    assert [point["kind"] for point in summary["special"]] == [point.kind for point in branch.special]
    assert study.summary["explored"] == {"complete": True, "reason": "all was followed"}
    start = "from many starts at damping = 0.06, max_period 2 (seed 3): 1"
    place = study.lines.index(f"branches of periodic orbits for amplitude from 0 to 4, {start}")
    assert study.lines[place + 1] == "all was followed"
    for point in branch.special:
        row = f"{point.kind} {point.value:.12g} {point.label}"
        assert sum(line.startswith(row) for line in study.lines) == 1
    assert files(study) == {"png", "nc", "txt"}
    np.testing.assert_array_equal(study.data["branch_value"], branch.values)


def test_a_refusal_of_explore_names_the_key_of_the_file(tmp_path, monkeypatch):
    def explore(*given, **settings):
        raise jv.ArgumentError("bounds", "must hold some value", [0.0, 4.0])

    monkeypatch.setattr(sys.modules[StudyResults.__module__], "explore", explore)
    with pytest.raises(jv.SceneError, match=r"^explore\.bounds: must hold some value; got \[0.0, 4.0\]$"):
        run(tmp_path, SCENE + EXPLORE)
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
    assert files(loci) == {"png", "loci.png", "nc", "txt"}
    assert loci.summary["files"]["loci"] == str(loci.out / "study.loci.png")
    assert np.bincount(data["locus_number"]).tolist() == [len(curve) for curve in curves]
    for column, name in enumerate(PAIR):
        expected = np.concatenate([curve.values[:, column] for curve in curves])
        np.testing.assert_array_equal(data[f"locus_{name}"], expected)
    assert data["locus_kind"].values.tolist() == ["GR", "SN"]
    assert data["locus_first_reason"].values.tolist() == [curve.reasons[0] for curve in curves]
    ends = data["locus_frequency"].values[data["codim2_point"].values]
    assert sorted(ends) == [LOW, LOW, HIGH, HIGH] and data["codim2_locus"].values.tolist() == [0, 0, 1, 1]
    assert data["codim2_kind"].values.tolist() == 4 * ["EP"]


def test_the_picture_of_loci_has_their_bounds_and_draws_mirror_images_once(loci, monkeypatch):
    results, labels, figures = loci.results, [], []
    walls = {"P112": ("RLR",), "P121": ("LRL",), "P111": ("RL",)}

    class Curve(jv.Locus):
        label = values = None

        def __init__(self, label):
            special = tuple(SimpleNamespace(kind="EP", itinerary=walls[label]) for _ in range(2))
            fields = {key: getattr(results.loci[1], key) for key in ("kind", "names", "bounds", "values")}
            vars(self).update(fields, label=label, special=special)

        def __len__(self):
            return len(self.values)

    draw = jv.plot.locus
    monkeypatch.setattr(
        jv.plot, "locus", lambda curve, ax, **more: labels.append(curve.label) or draw(curve, ax, **more)
    )
    monkeypatch.setattr(result_pictures, "png_bytes", figures.append)
    for curves in ([Curve(label) for label in ("P112", "P121", "P111")], ()):
        result_pictures.draw_loci_picture(replace(results, branches=(), loci=curves))
    assert labels == ["P112", "P111"]
    assert figures[0].axes[0].get_ylim() == (LOW, HIGH)
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == [
        "SN of P112 and mirror image",
        "SN of P111",
    ]
    assert "0.05" in figures[0].get_suptitle() and "2.1" not in figures[0].get_suptitle()
    assert figures[1].axes[0].get_xlim() == (0.0, 12.0) and not figures[1].legends


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, np.pi / 2, 2.5])
def test_a_point_between_the_rows_of_a_locus_is_on_it_and_one_beside_it_is_not(turn):
    """The locus is a parabola, turned by an angle, whose rows are as far apart as those of a locus are."""
    cos, sin, rows = np.cos(turn), np.sin(turn), np.linspace(-2.0, 2.0, 41)

    def parabola(t):
        return 5.0 + np.stack([cos * t - sin * t * t, sin * t + cos * t * t], axis=-1)

    bounds = dict.fromkeys(PAIR, (0.0, 10.0))
    curve = SimpleNamespace(kind="SN", label="P111", names=PAIR, values=parabola(rows), bounds=bounds)
    for t in np.linspace(-1.99, 1.99, 77):
        assert loci_of_branches.contains_point(curve, parabola(t)), t
    for t in rows[1:-1]:
        for aside in (1e-4, -1e-4, 0.1):
            assert not loci_of_branches.contains_point(curve, parabola(t) + aside * np.array([-sin, cos])), (t, aside)
    assert not loci_of_branches.contains_point(curve, parabola(2.05))
    assert not loci_of_branches.contains_point(curve, [0.0, 0.0])


def test_special_points_on_one_locus_are_followed_once(monkeypatch):
    """At A = 2 both symmetry breakings along the frequency are on one curve."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "frequency", (1.0, 3.0))
    first, second = branch.points("SB")
    bounds, counts, followed = {"amplitude": (1.0, 2.5), "frequency": (1.05, 1.7)}, [], []
    curves, refused = loci_of_branches.follow_loci([branch], PAIR, bounds, progress=counts.append)
    assert [curve.kind for curve in curves] == ["SB"] and refused == () and counts == [1, 2]
    narrow = bounds | {"frequency": (1.3, 1.7)}
    assert [loci_of_branches.count_points_to_follow([branch], given) for given in (bounds, narrow)] == [2, 1]
    assert all(loci_of_branches.contains_point(curves[0], [2.0, point.value]) for point in (first, second))
    assert not loci_of_branches.contains_point(curves[0], [2.0, first.value + 1e-5])
    monkeypatch.setattr(loci_of_branches, "locus", lambda point, *given, **more: followed.append(point) or curves[0])
    loci_of_branches.follow_loci([branch, branch], PAIR, bounds, ("SN", "SB"))
    loci_of_branches.follow_loci([branch], PAIR, bounds, ("SN", "PD"))
    loci_of_branches.follow_loci([branch], PAIR, {"amplitude": (2.1, 2.5), "frequency": (1.05, 1.7)})
    assert followed == [first]


def test_a_point_that_cannot_be_followed_is_reported(loci):
    """A symmetry breaking does not persist in a scene whose walls differ."""
    results = loci.results
    names, bounds = ("amplitude", "right.position"), {"amplitude": (0.0, 9.0), "right.position": (0.5, 2.0)}
    curves, ((point, reason),) = loci_of_branches.follow_loci(results.branches, names, bounds, ("SB",))
    assert curves == () and (point.kind, point.label) == ("SB", "P111")
    assert reason.startswith("must keep the scene symmetric")
    results = replace(results, loci=curves, refused_points=((point, reason),))
    lines = results_report.format_results_table(results, "loci.toml").splitlines()
    assert f"not followed: SB of P111 at amplitude = {point.value:.12g}: {reason}" in lines
    (line,) = results_report.summarise_results(results, {})["not_followed"]
    assert (line["kind"], line["label"], line["reason"]) == ("SB", "P111", reason)
    assert line["value"] == pytest.approx(BREAKING, abs=1e-7)


def test_where_two_stable_motions_coexist(loci):
    branches, curves = loci.results.branches, loci.results.loci
    ((first, second, label),) = find_coexistence_loci(branches, curves)
    assert label == "P100 and P111" and {first.kind, second.kind} == {"SN", "GR"}
    assert find_coexistence_loci(branches, [first]) == []
    with_fold = next(branch for branch in branches if branch.points("SN"))
    unstable = replace(with_fold, data=with_fold.data.assign(stable=0 * with_fold.data["stable"]))
    assert find_coexistence_loci([unstable], curves) == []


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
    assert line.endswith(" itself")


def test_data_of_orbits(orbits):
    data, summary = orbits.data, orbits.summary["orbits"]
    assert files(orbits) == {"png", "nc", "txt"} and dict(data.sizes) == {"orbit": 7, "multiplier": 2}
    assert data["orbit_label"].values.tolist() == [orbit["label"] for orbit in summary]
    assert data["orbit_mirror"].values.tolist() == [orbit["mirror_of"] for orbit in summary]
    assert data["orbit_stable"].values.tolist() == [orbit["stable"] for orbit in summary]
    multipliers = np.stack([data["orbit_multiplier_real"], data["orbit_multiplier_imag"]], -1)
    np.testing.assert_array_equal(multipliers, [orbit["multipliers"] for orbit in summary])
    for key in ("x", "v", "phase"):
        np.testing.assert_array_equal(data[f"orbit_{key}"], [orbit["state"][key] for orbit in summary])
    units = [data[f"orbit_{key}"].attrs["units"] for key in ("x", "v", "phase", "multiplier_real", "least_speed")]
    assert units == ["length", "length w0", "rad", "1", "length w0"]


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """Attractors and orbits of one scene beside a sweep."""
    changes = [f"sweep.{key}=5" for key in ("count", "settle", "keep")] + ["attractors.starts=50"]
    changes += ["orbits={max_period=1, starts=20, at={amplitude=4.65}}"]
    text = (SCENES / "branches.toml").read_text()
    return run(tmp_path_factory.mktemp("beside"), text[: text.index("[branch]")], changes).results


def test_orbits_that_are_attractors_are_marked_once(beside, monkeypatch):
    assert beside.diagram_value(beside.file.attractors) == beside.diagram_value(beside.file.orbits) == 4.65
    assert [attractor.kind for attractor in beside.attractors] == 4 * ["periodic"] and len(beside.orbits) == 7
    others = [(orbit.label, orbit.stable, orbit.mirror_of) for orbit in beside.other_orbits]
    assert others == [("P111", False, 0), ("P112", False, 2), ("P121", False, 1)]
    marked, drawn = [], []
    for name in ("mark", "mark_orbits"):
        monkeypatch.setattr(jv.plot, name, lambda some, value, variable, ax, units: marked.append((len(some), value)))
    monkeypatch.setattr(jv.plot, "orbit", lambda orbit, ax, units: drawn.append(orbit.label))
    result_pictures.draw_main_picture(beside)
    assert marked == 2 * [(4, 4.65), (3, 4.65)] and drawn == []
    file = msgspec.structs.replace(beside.file, sweep=None, attractors=None)
    many = replace(beside, file=file, swept=None, attractors=None, orbits=beside.orbits + beside.orbits)
    result_pictures.draw_main_picture(many)
    assert drawn == 3 * ["P111"] + 2 * ["P112"] + 2 * ["P121"] + 2 * ["P111"]  # nine portraits at most


def test_a_state_at_another_phase_is_reported_with_it(beside):
    moved = replace(beside.orbits[3], state=jv.State(0.2, -0.4, 1.8, 0.0))
    table = results_report.format_results_table(replace(beside, orbits=(beside.orbits[0], moved)), "name")
    assert "x and v at the phase (rad) given" in table
    assert " 0.200000000000 -0.400000000000 1.800000000000 RLR " in " ".join(table.split())
    assert "x and v at phase 0;" in results_report.format_results_table(beside, "name")


def test_orbits_of_another_scene_stay_out_of_the_diagram_and_none_are_reported_as_none(beside):
    file = msgspec.structs.replace(beside.file, orbits=msgspec.structs.replace(beside.file.orbits, at={"damping": 0.1}))
    results = StudyResults(file, file.scene.make(), None, (), ())
    assert results.diagram_value(file.orbits) is None and results.diagram_value(file.attractors) == 4.65
    scenes = results.scene_of_table(file.orbits), results.scene_of_table(file.attractors)
    assert (scenes[0].damping, scenes[1].amplitude) == (0.1, 4.65)
    alone = replace(results, file=msgspec.structs.replace(file, sweep=None, attractors=None), attractors=None)
    assert "20 starts (seed 0): none found" in results_report.format_results_table(alone, "name")
    assert results_report.summarise_results(alone, {})["orbits"] == []
    assert result_pictures.draw_main_picture(alone).startswith(b"\x89PNG")
