"""The reproduction of the paper: verdicts, closed forms against 30 digits, the report, and resuming."""

import json
import math
from collections import Counter
from types import SimpleNamespace

import jax
import matplotlib.pyplot as plt
import mpmath as mp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad

import jaxvibro as jv
from jaxvibro.reproduction.bifurcation_diagrams import _chaos_claims
from jaxvibro.reproduction.claim import additional_claim, number_claim, statement_claim
from jaxvibro.reproduction.closed_forms import coexistence_area, single_wall_fold, symmetric_fold, symmetric_orbit_state
from jaxvibro.reproduction.figure_jobs import FigureJob
from jaxvibro.reproduction.figure_panels import FigureResult, panel_scene_files
from jaxvibro.reproduction.fixed_step import OscillatorParameters, fixed_step_strobe
from jaxvibro.reproduction.hysteresis import hysteresis_ranges
from jaxvibro.reproduction.phase_portraits import _existence_claim
from jaxvibro.studies.scene_file import read_scene_file
from tests.scene_files import SCENES

AGREES, DIFFERS, HOLDS, CANNOT_HOLD, UNDECIDED = "agrees to its digits", "differs", "holds", "cannot hold", "undecided"
SCENE = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
INFINITY, NAN = math.inf, math.nan


@pytest.mark.parametrize(
    ("printed", "computed", "verdict", "is_cut_off"),
    [
        ("3.42", (3.4246, 1e-9), AGREES, False),
        ("3.42", (3.4251, 1e-9), DIFFERS, True),
        ("3.42", (3.4251, 2e-4), UNDECIDED, True),
        ("3.4", (3.4499, 1e-9), AGREES, False),
        ("1334", (1334.4, 1e-9), AGREES, False),
        ("3.42", (NAN, NAN), CANNOT_HOLD, False),
        ("3.41", (3.4112, 1e-9), AGREES, False),
        ("3.41", (3.4264, 1e-9), DIFFERS, False),
    ],
)
def test_a_printed_number_is_judged_to_half_a_unit_of_its_last_digit(printed, computed, verdict, is_cut_off):
    claim = number_claim("4", "", printed, computed)
    assert claim.verdict == verdict and ("cut off" in claim.reason) == is_cut_off


@pytest.mark.parametrize(
    ("computed", "low", "high", "allowance", "verdict"),
    [
        ((0.2, 0.1), 0.0, INFINITY, 0.0, HOLDS),
        ((0.2, 0.3), 0.0, INFINITY, 0.0, UNDECIDED),
        ((-0.2, 0.1), 0.0, INFINITY, 0.0, CANNOT_HOLD),
        ((NAN, 0.0), 0.0, INFINITY, 0.0, CANNOT_HOLD),
        # unresolved motions, of which there may be more
        ((0.0, 0.0), 1.0, INFINITY, INFINITY, UNDECIDED),
        ((1.0, 0.0), 1.0, INFINITY, INFINITY, HOLDS),
        ((0.0, 0.0), -INFINITY, 0.0, INFINITY, UNDECIDED),
        ((1.0, 0.0), -INFINITY, 0.0, INFINITY, CANNOT_HOLD),
        ((4.0, 0.0), 4.0, 4.0, INFINITY, UNDECIDED),
        ((5.0, 0.0), 4.0, 4.0, INFINITY, CANNOT_HOLD),
        ((NAN, 0.0), 0.0, 1.0, INFINITY, UNDECIDED),
    ],
)
def test_a_claim_in_words_is_judged_by_its_number_and_by_unresolved_motions(computed, low, high, allowance, verdict):
    assert statement_claim("4", "chaos", computed, low, high, unresolved_allowance=allowance).verdict == verdict


def attractor(kind, exponent, label="P111"):
    """Return an attractor with the fields that a verdict reads."""
    state = jv.State(0.1, 0.2, 0.0, 0.0)
    fields = {"share": 0.5, "state": state, "periods": 1, "mirror_of": None, "orbit": None, "note": ""}
    return SimpleNamespace(label=label, kind=kind, exponent=exponent, **fields)


@pytest.mark.parametrize(
    ("kinds", "exponents", "verdict"),
    [
        (("periodic", "chaotic"), (-0.5, 0.1), HOLDS),
        (("periodic", "unresolved"), (-0.5, 0.1), HOLDS),
        (("periodic", "unresolved"), (-0.5, -0.1), UNDECIDED),
        (("periodic", "periodic"), (-0.5, -0.1), CANNOT_HOLD),
        (("unresolved",), (NAN,), UNDECIDED),
    ],
)
def test_chaos_is_judged_by_all_attractors(monkeypatch, kinds, exponents, verdict):
    attractors = [attractor(kind, exponent) for kind, exponent in zip(kinds, exponents, strict=True)]

    def spectrum(scene, name, values, state, **settings):
        assert len(values) == len(attractors) and np.shape(state.x) == (len(attractors),)
        rows = {"exponent": [[one, -1.0] for one in exponents], "error": [[1e-3, 1e-3]] * len(exponents)}
        return xr.Dataset({key: ([name, "order"], np.array(row)) for key, row in rows.items()})

    diagrams = "jaxvibro.reproduction.bifurcation_diagrams."
    monkeypatch.setattr(diagrams + "find_attractors", lambda scene, starts: attractors)
    monkeypatch.setattr("jaxvibro.reproduction.attractor_checks.spectrum", spectrum)
    monkeypatch.setattr(diagrams + "locate_chaos_onset", lambda scene, low, high: (4.98, 0.02, 8, 0.2))
    existence, onset = _chaos_claims("4", SCENE, "5.24", 3.4)
    assert existence.verdict == verdict
    assert onset.verdict == DIFFERS and "4.98" in onset.reason


@pytest.mark.parametrize(("label", "verdict"), [("P112", HOLDS), ("P121", HOLDS), ("P223", UNDECIDED)])
def test_a_motion_that_is_not_found_may_be_among_unresolved_starts(label, verdict):
    scene, motions = SCENE.replace(amplitude=5.0), [attractor("periodic", -0.1, label)]
    assert _existence_claim(3, scene, motions, INFINITY).verdict == verdict
    assert _existence_claim(3, scene, motions, 0.0).verdict == (CANNOT_HOLD if verdict == UNDECIDED else HOLDS)


def double_root(frequency, damping, restitution, distance, half, sign):
    """Return the fold amplitude and speed of impacts that repeat (1) or are mirrored (-1) after some half periods."""
    generator = mp.matrix([[0, 1], [-1, -2 * mp.mpf(damping)]])
    flow = mp.expm(generator * mp.pi * half / frequency)
    right = mp.matrix([0, -1]) - sign * flow * mp.matrix([0, mp.mpf(restitution)])
    a, b = mp.lu_solve(mp.eye(2) - sign * flow, right)
    b /= frequency
    length = mp.sqrt((1 - mp.mpf(frequency) ** 2) ** 2 + (2 * mp.mpf(damping) * frequency) ** 2)
    return distance * length * abs(b) / mp.sqrt(a * a + b * b), distance * a / (a * a + b * b)


@pytest.mark.parametrize("seed", range(4))
def test_closed_forms_are_those_of_thirty_digits(seed):
    draw = np.random.default_rng(seed)
    w, damping, bounce, place = draw.uniform([0.4, 0.01, 0.2, 0.5], [3.0, 1.6, 1.0, 2.0])
    with mp.workdps(30):
        exact = double_root(w, damping, bounce, 1, 1, -1)
        single = [double_root(w, damping, bounce, place, 2 * n, 1) for n in (1, 3)]
    assert symmetric_fold(w, damping, bounce) == pytest.approx([float(one) for one in exact], rel=1e-12)
    for n, expected in zip((1, 3), single, strict=True):
        fold = single_wall_fold(w, damping, bounce, place, n)
        assert fold == pytest.approx([float(one) for one in expected], rel=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_the_closed_forms_motion_is_an_orbit_in_every_tongue(seed):
    draw = np.random.default_rng(seed)
    damping, bounce, share = draw.uniform([0.01, 0.4, 0.2], [0.2, 0.9, 0.8])
    tongue = seed % 3  # 0: above r; k: from r / (2 k + 1) to r / (2 k)
    root = math.sqrt(1 - damping**2)
    low, high = (root, 2.5) if tongue == 0 else (root / (2 * tongue + 1), root / (2 * tongue))
    w = low + share * (high - low)
    begin, speed = (float(one) for one in symmetric_fold(w, damping, bounce))
    end = math.hypot(1 - w * w, 2 * damping * w)  # the grazing
    assert speed > 0 and begin < end and math.sin(math.pi * root / w) > 0
    scene = jv.make_scene(begin + 0.03 * (end - begin), w, damping, bounce, (-1.0, 1.0))  # it may graze further on
    start = symmetric_orbit_state(scene)
    _, impacts = jv.strobe(scene, start)  # its mirror image after half a period
    side, time, speed = (np.asarray(part)[0] for part in (impacts.side, impacts.time, impacts.speed))
    assert side == -1 and time == pytest.approx(math.pi / w, rel=1e-9) and speed == pytest.approx(-start.v / bounce)


def test_the_papers_method_comes_near_the_strobe():
    draw = np.random.default_rng(0)
    states = draw.uniform([-1.0, -3.0, 0.0], [1.0, 3.0, 6.0], (200, 3))
    stepped = fixed_step_strobe(OscillatorParameters(2.1, 0.05, 0.7), states, 400)
    scene = jv.make_scene(states[:, 2], 2.1, 0.05, 0.7, (-1.0, 1.0))
    end, impacts = jv.strobe(scene, jv.State(states[:, 0], states[:, 1]), slots=stepped.sides.shape[1])
    same = (stepped.sides == np.asarray(impacts.side)).all(axis=1)
    assert same.mean() > 0.97
    assert np.median(abs(stepped.ends - np.stack([end.x, end.v], axis=1))[same].max(axis=1)) < 1e-7


@pytest.mark.parametrize(("damping", "bounce"), [(0.05, 0.7), (0.65, 0.4)])
def test_area_and_its_derivatives_are_those_of_quadrature(damping, bounce):
    def width(w, damping, bounce):
        with mp.workdps(20):
            return math.hypot(1 - w * w, 2 * damping * w) - float(double_root(w, damping, bounce, 1, 1, -1)[0])

    def area(damping, bounce):
        return quad(width, math.sqrt(1 - damping**2), 3.0, args=(damping, bounce), epsabs=1e-11, epsrel=1e-11)[0]

    assert float(coexistence_area(damping, bounce, 3.0, 48)) == pytest.approx(area(damping, bounce), abs=1e-8)
    step = 1e-4
    slopes = [float(one) for one in jax.jacfwd(coexistence_area, (0, 1))(damping, bounce, 3.0, 48)]
    by_damping = (area(damping + step, bounce) - area(damping - step, bounce)) / (2 * step)
    by_bounce = (area(damping, bounce + step) - area(damping, bounce - step)) / (2 * step)
    assert slopes == pytest.approx([by_damping, by_bounce], abs=1e-5)


def test_panels_have_the_values_of_their_columns():
    scenes = [panel.scene.make() for panel in panel_scene_files(read_scene_file(SCENES / "fig2.toml"))]
    values = [(float(scene.frequency), float(scene.left.position)) for scene in scenes]
    assert values == [(1.9, -1.0), (2.3, -1.0), (1.9, -1.5), (2.3, -1.5)]


def test_ranges_in_which_two_legs_differ():
    values = np.stack([np.linspace(4.0, 0.0, 21), np.linspace(0.0, 4.0, 21)], -1)
    state = jv.State(np.array([0.9, 0.0]), np.array([-1.1, 0.0]))
    swept = jv.sweep(SCENE, "amplitude", values, state, settle=150, keep=4)
    (low, high), *rest = hysteresis_ranges(swept.rename(lane="leg"))
    # P100 grazes at 3.416, and the step from 3.2 to 3.4 sets it swinging farther than that
    assert (low, high, rest) == (pytest.approx(0.6), pytest.approx(3.2), [])


@pytest.fixture
def jobs(monkeypatch):
    """Two jobs that need no work; the second is interrupted at first."""
    calls = []

    def one(file, show_progress):
        calls.append("one")
        claims = (
            number_claim("1", "a|b <i>", "0.5", (0.51, 0.0), "Because."),
            number_claim("1", "fold", "0.5", (0.608057896812, 1.2e-3), "Because."),
            statement_claim("1", "none", (NAN, 0.0), low=0.0),
            statement_claim("1", "count", (2.0, 0.0), high=2.0, unresolved_allowance=INFINITY),
            additional_claim("8", "the sum", (0.508057896812, 1e-15), high=1.0),
        )
        return FigureResult(b"\x89PNG", "<b> & so on", claims, {"": xr.Dataset({"a": ("b", np.arange(3.0))})})

    def two(file, show_progress):
        calls.append("two")
        if calls.count("two") == 1:
            raise KeyboardInterrupt
        return FigureResult(None, "", (additional_claim("2", "never", (1.0, 0.0), high=0.0, reason="Because."),))

    jobs = {name: FigureJob(name, ("formulas",), job) for name, job in (("one", one), ("two", two))}
    monkeypatch.setattr("jaxvibro.reproduction.run.JOBS", jobs)
    return calls


def test_an_interrupted_run_resumes(jobs, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        jv.paper(out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "one.nc", "one.png"]
    done = jv.paper(out=tmp_path)
    assert jobs == ["one", "two", "two"]
    assert [claim.verdict for claim in done.claims[::5]] == [AGREES, CANNOT_HOLD]
    assert [claim.ours for claim in done.claims] == 4 * [False] + 2 * [True]
    jv.paper(out=tmp_path)
    assert len(jobs) == 3
    jv.paper(["one"], tmp_path, force=True)
    (tmp_path / "two.json").write_text("{")
    jv.paper(out=tmp_path)
    assert jobs[3:] == ["one", "two"]


def test_damaged_or_missing_results_are_computed_again(jobs, tmp_path):
    jv.paper(["one"], tmp_path)
    files, draw = [tmp_path / f"one.{ending}" for ending in ("json", "png", "nc")], np.random.default_rng(1)
    before = {path: path.read_bytes() for path in files}
    for round_ in range(20):
        path = files[round_ % 3]
        content = bytearray(before[path])
        content[draw.integers(len(content))] ^= 1 << draw.integers(8)
        path.write_bytes(content[: len(content) - round_ // 15])
        jv.paper(["one"], tmp_path)
        assert len(jobs) == round_ + 2 and {path: path.read_bytes() for path in files} == before
    files[2].unlink()
    jv.paper(["one"], tmp_path)
    jv.paper(["one"], tmp_path)
    assert len(jobs) == 22


def test_another_scene_is_computed_again(jobs, tmp_path):
    text = (SCENES / "formulas.toml").read_text()
    (tmp_path / "scenes").mkdir()
    for k, changed in enumerate((text, text.replace("0.7 ", "0.8 "))):
        (tmp_path / "scenes" / "formulas.toml").write_text(changed)
        jv.paper(["one"], tmp_path / "out", tmp_path / "scenes")
        assert len(jobs) == k + 1


def test_the_report_shows_each_claim_without_another_file(jobs, tmp_path):
    """Values have the digits that are certain; a right claim has no reason; our own claims have their own table."""
    jv.paper(["one"], tmp_path)
    html, (theirs, ours) = (tmp_path / "report.html").read_text(), (tmp_path / "report.md").read_text().split("## Our")
    assert [line for line in theirs.splitlines() if line.startswith("| 1 |")] == [
        f"| 1 | a\\|b <i> | 0.5 | 0.51 ± 0 | {AGREES} |  |",
        f"| 1 | fold | 0.5 | 0.6081 ± 0.001 | {DIFFERS} | Because. |",
        f"| 1 | none |  | none | {CANNOT_HOLD} |  |",
        f"| 1 | count |  | 2 (exact), perhaps more | {UNDECIDED} |  |",
    ]
    assert f"| 8 | the sum |  | 0.508057896812 ± 1e-15 | {HOLDS} |  |" in ours.splitlines() and "the sum" not in theirs
    counts = f"The paper's claims: 4 ({AGREES}: 1, {DIFFERS}: 1, {CANNOT_HOLD}: 1, {UNDECIDED}: 1)."
    assert counts in theirs and f"Our own rows: 1 ({HOLDS}: 1)." in ours
    assert "http" not in html and 'src="data:image/png;base64,' in html
    assert "&lt;b&gt; &amp; so on" in html and "a|b &lt;i&gt;" in html.split("Our own rows")[0]
    assert "the sum" not in html.split("Our own rows")[0]
    assert json.loads((tmp_path / "one.json").read_text())["claims"][0]["verdict"] == AGREES


def test_an_unknown_figure_is_refused(tmp_path):
    with pytest.raises(jv.ArgumentError, match=r"^figure: must be one of those known, perhaps fig9 \(fig2, "):
        jv.paper(["fig99"], tmp_path)
    with pytest.raises(jv.ArgumentError, match="workers: must be a whole number from 1 on; got 0"):
        jv.paper(["fig9"], tmp_path, workers=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("names", "workers"), [(["formulas"], 1), (["formulas", "walls"], 2)], ids=["small", "full"])
def test_formulas_and_one_wall(names, workers, tmp_path):
    """The full case runs a process for each of two figures."""
    claims = jv.paper(names, tmp_path, workers=workers).claims
    (fold,) = (claim for claim in claims if claim.figure == "(19)")
    assert fold.value == pytest.approx(0.508057896812, abs=1e-12) and fold.verdict == DIFFERS
    assert [claim.verdict for claim in claims if claim.figure in ("(8)", "(35)", "method")] == [HOLDS] * 5
    if "walls" in names:
        verdicts = [claim.verdict for claim in claims if claim.figure == "one wall" and "same as" in claim.text]
        assert verdicts == [HOLDS, CANNOT_HOLD, CANNOT_HOLD]
        (moving,) = (claim for claim in claims if claim.figure == "moving wall")
        assert abs(moving.value) < 1e-12 and moving.verdict == HOLDS and moving.ours


SMALLER = {  # of a figure: what its scene file has instead, and its verdicts
    "fig2": ([("count = 501", "count = 21")], {DIFFERS: 4, CANNOT_HOLD: 2}),
    "fig3": ([("starts = 200", "starts = 40")], {HOLDS: 4, CANNOT_HOLD: 3}),
    "fig12": (
        [("[0.05, 0.35, 0.65]", "[0.05]"), ("frequency = [0.2, 3.0]", "frequency = [0.4, 3.0]")],
        {HOLDS: 9},
    ),
    "walls": ([], {HOLDS: 6, CANNOT_HOLD: 2}),
}


@pytest.mark.parametrize("name", SMALLER)
def test_figures_with_fewer_values_have_the_same_verdicts(name, tmp_path):
    changes, verdicts = SMALLER[name]
    text = (SCENES / f"{name}.toml").read_text()
    for before, after in changes:
        assert text.count(before) == 1
        text = text.replace(before, after)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / f"{name}.toml").write_text(text)
    claims = jv.paper([name], tmp_path, tmp_path / "scenes").claims
    assert Counter(claim.verdict for claim in claims) == verdicts
    assert plt.imread(tmp_path / f"{name}.png").std() > 0.05
    if name == "fig2":  # P100 jumps up where it grazes, P111 down at its fold
        for up, down, w in ((claims[0], claims[1], 1.9), (claims[2], claims[3], 2.3)):
            assert up.value == pytest.approx(math.hypot(1 - w * w, 2 * 0.035 * w), rel=1e-12)
            assert down.value == pytest.approx(float(symmetric_fold(w, 0.035, 0.7)[0]), rel=1e-12)
