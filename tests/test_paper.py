"""The paper recomputed: verdicts, closed forms against 30 digits, the report, and that an interrupted run goes on."""

import json
import math

import jax
import mpmath as mp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad

import jaxvibro as jv
from jaxvibro.attractors.find import Attractor
from jaxvibro.reproduction import (
    attractor_checks,
    bifurcation_diagrams,
    closed_forms,
    figure_jobs,
    fixed_step,
    phase_portraits,
    run,
)
from jaxvibro.reproduction.claim import (
    AGREES,
    CANNOT_HOLD,
    DIFFERS,
    HOLDS,
    UNDECIDED,
    additional_claim,
    computed_value_text,
    number_claim,
    statement_claim,
    value_error_text,
)
from jaxvibro.reproduction.claim_report import claim_rows, report_html, report_markdown, verdict_counts_text
from jaxvibro.reproduction.figure_panels import FigureResult, panel_scene_files
from jaxvibro.reproduction.hysteresis import hysteresis_ranges
from jaxvibro.studies.command import main
from jaxvibro.studies.scene_file import parse_tables, read_scene_file

SCENES = run.ROOT.parent / "scenes"
SCENE = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "right": {"position": 1.0}}


@pytest.mark.parametrize(
    ("printed", "found", "verdict"),
    [
        ("3.42", (3.4246, 1e-9), AGREES),
        ("3.42", (3.4251, 1e-9), DIFFERS),
        ("3.42", (3.4251, 2e-4), UNDECIDED),
        ("3.4", (3.4499, 1e-9), AGREES),
        ("1334", (1334.4, 1e-9), AGREES),
        ("3.42", (math.nan, math.nan), CANNOT_HOLD),
    ],
)
def test_a_printed_number_is_judged_to_half_a_unit_of_its_last_digit(printed, found, verdict):
    assert number_claim("4", "", printed, found).verdict == verdict


def test_digits_cut_off_are_told():
    assert "cut off" in number_claim("4", "", "3.41", (3.41646, 1e-9)).reason
    assert "cut off" not in number_claim("4", "", "3.41", (3.4112, 1e-9)).reason
    assert "cut off" not in number_claim("4", "", "3.41", (3.4264, 1e-9)).reason


@pytest.mark.parametrize(
    ("found", "verdict"),
    [((0.2, 0.1), HOLDS), ((0.2, 0.3), UNDECIDED), ((-0.2, 0.1), CANNOT_HOLD), ((math.nan, 0.0), CANNOT_HOLD)],
)
def test_a_claim_in_words_holds_where_its_number_is_inside(found, verdict):
    assert statement_claim("4", "chaos", found, low=0.0).verdict == verdict


@pytest.mark.parametrize(
    ("value", "low", "high", "verdict"),
    [
        (0.0, 1.0, math.inf, UNDECIDED),
        (1.0, 1.0, math.inf, HOLDS),
        (0.0, -math.inf, 0.0, UNDECIDED),
        (1.0, -math.inf, 0.0, CANNOT_HOLD),
        (4.0, 4.0, 4.0, UNDECIDED),
        (5.0, 4.0, 4.0, CANNOT_HOLD),
        (math.nan, 0.0, 1.0, UNDECIDED),
    ],
)
def test_what_stays_unresolved_makes_a_verdict_undecided_where_it_could_change_it(value, low, high, verdict):
    claim = statement_claim("4", "share", (value, 0.0), low, high, unresolved_allowance=math.inf)
    assert claim.verdict == verdict and computed_value_text(claim).endswith(", perhaps more")


def attractor(kind, exponent, label="P111", share=0.5):
    return Attractor(
        label=label,
        kind=kind,
        share=share,
        share_bounds=(0.0, 1.0),
        starts=2,
        state=jv.State(0.1, 0.2, 0.0, 0.0),
        periods=1,
        itinerary=(),
        points=None,
        least_speed=1.0,
        exponent=exponent,
        mirror_of=None,
        note="",
    )


@pytest.mark.parametrize(
    ("kinds", "exponents", "verdict"),
    [
        (("periodic", "chaotic"), (-0.5, 0.1), HOLDS),
        (("periodic", "unresolved"), (-0.5, 0.1), HOLDS),
        (("periodic", "unresolved"), (-0.5, -0.1), UNDECIDED),
        (("periodic", "periodic"), (-0.5, -0.1), CANNOT_HOLD),
        (("unresolved",), (math.nan,), UNDECIDED),
    ],
)
def test_chaos_is_judged_by_all_that_lasts(monkeypatch, kinds, exponents, verdict):
    found = [attractor(kind, exponent) for kind, exponent in zip(kinds, exponents, strict=True)]

    def spectrum(scene, name, values, state, **asked):
        assert len(values) == len(found) and np.shape(state.x) == (len(found),)
        pairs = {
            key: ([name, "order"], np.array(rows))
            for key, rows in (("exponent", [[one, -1.0] for one in exponents]), ("error", [[1e-3, 1e-3]] * len(found)))
        }
        return xr.Dataset(pairs)

    monkeypatch.setattr(bifurcation_diagrams, "find_attractors", lambda scene, starts: found)
    monkeypatch.setattr(attractor_checks, "spectrum", spectrum)
    monkeypatch.setattr(bifurcation_diagrams, "locate_chaos_onset", lambda scene, low, high: (4.98, 0.02, 8, 0.2))
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    there, begins = bifurcation_diagrams._chaos_claims("4", scene, "5.24", 3.4)
    assert there.verdict == verdict
    assert begins.verdict == DIFFERS and "4.98" in begins.reason


@pytest.mark.parametrize(("label", "verdict"), [("P112", HOLDS), ("P121", HOLDS), ("P223", UNDECIDED)])
def test_a_motion_that_is_not_found_may_be_among_unresolved_starts(label, verdict):
    scene = jv.make_scene(5.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    motions = [attractor("periodic", -0.1, label)]
    assert phase_portraits._existence_claim(3, scene, motions, math.inf).verdict == verdict
    assert phase_portraits._existence_claim(3, scene, motions, 0.0).verdict == (
        HOLDS if verdict == HOLDS else CANNOT_HOLD
    )


def test_our_own_rows_stand_apart():
    claims = [number_claim("4", "SN1", "0.5", (0.51, 0.0)), additional_claim("8", "the sum", (0.0, 0.0), high=1.0)]
    assert [one.ours for one in claims] == [False, True]
    drawn = FigureResult(None, "", tuple(claims))
    for told_all in (report_html([("x", drawn)]), report_markdown([("x", None, drawn)])):
        theirs, ours = told_all.split("Our own rows")[0], told_all.split("Our own rows", 1)[1]
        assert "SN1" in theirs and "SN1" not in ours
        assert "the sum" in ours and "the sum" not in theirs
    assert verdict_counts_text(claims) == f"The paper's claims: 1 ({AGREES}: 1). Our own rows: 1 ({HOLDS}: 1)."


def test_values_are_told_to_the_digits_that_they_bear():
    assert value_error_text(0.508057896812, 1e-15) == "0.508057896812 ± 1e-15"
    assert value_error_text(0.1895123, 1.2e-3) == "0.1895 ± 0.001"
    assert value_error_text(2.0, 0.0) == "2 (exact)"
    assert value_error_text(math.nan, 0.0) == "none"


def flow(frequency, damping, time):
    return mp.expm(mp.matrix([[0, 1], [-1, -2 * mp.mpf(damping)]]) * time)


def double_root(frequency, damping, restitution, distance, half, sign):
    """(A_c, u) in 30 digits: of impacts that repeat (sign 1) or are mirrored (-1) after half a period or so many."""
    e = flow(frequency, damping, mp.pi * half / frequency)
    rest = mp.matrix([0, -1]) - sign * e * mp.matrix([0, mp.mpf(restitution)])
    a, b = mp.lu_solve(mp.eye(2) - sign * e, rest)
    b /= frequency
    length = mp.sqrt((1 - mp.mpf(frequency) ** 2) ** 2 + (2 * mp.mpf(damping) * frequency) ** 2)
    return distance * length * abs(b) / mp.sqrt(a * a + b * b), distance * a / (a * a + b * b)


@pytest.mark.parametrize("seed", range(8))
def test_closed_forms_are_those_of_thirty_digits(seed):
    draw = np.random.default_rng(seed)
    w, damping, bounce, place = draw.uniform([0.4, 0.01, 0.2, 0.5], [3.0, 1.6, 1.0, 2.0])
    with mp.workdps(30):
        exact = double_root(w, damping, bounce, 1, 1, -1)
        single = [double_root(w, damping, bounce, place, 2 * n, 1) for n in (1, 3)]
    assert closed_forms.symmetric_fold(w, damping, bounce) == pytest.approx([float(one) for one in exact], rel=1e-12)
    for n, expected in zip((1, 3), single, strict=True):
        found = closed_forms.single_wall_fold(w, damping, bounce, place, n)
        assert found == pytest.approx([float(one) for one in expected], rel=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_the_closed_forms_motion_is_an_orbit_in_every_tongue(seed):
    draw = np.random.default_rng(seed)
    damping, bounce, share = draw.uniform([0.01, 0.4, 0.2], [0.2, 0.9, 0.8])
    tongue = seed % 3  # 0: above r; k: from r / (2 k + 1) to r / (2 k)
    root = math.sqrt(1 - damping**2)
    low, high = (root, 2.5) if tongue == 0 else (root / (2 * tongue + 1), root / (2 * tongue))
    w = low + share * (high - low)
    begin, speed = (float(one) for one in closed_forms.symmetric_fold(w, damping, bounce))
    end = float(closed_forms.grazing_amplitude(w, damping))
    assert speed > 0 and begin < end and math.sin(math.pi * root / w) > 0
    scene = jv.make_scene(begin + 0.03 * (end - begin), w, damping, bounce, (-1.0, 1.0))  # it may graze further on
    start = closed_forms.symmetric_orbit_state(scene)
    _, impacts = jv.strobe(scene, start)  # its mirror image after half a period
    side, time, speed = (np.asarray(part)[0] for part in (impacts.side, impacts.time, impacts.speed))
    assert side == -1 and time == pytest.approx(math.pi / w, rel=1e-9) and speed == pytest.approx(-start.v / bounce)


@pytest.mark.slow
def test_the_papers_method_comes_near_the_strobe():
    draw = np.random.default_rng(0)
    states = draw.uniform([-1.0, -3.0, 0.0], [1.0, 3.0, 6.0], (200, 3))
    found = fixed_step.fixed_step_strobe(fixed_step.OscillatorParameters(2.1, 0.05, 0.7), states, 400)
    scene = jv.make_scene(states[:, 2], 2.1, 0.05, 0.7, (-1.0, 1.0))
    end, impacts = jv.strobe(scene, jv.State(states[:, 0], states[:, 1]), slots=fixed_step.MAX_IMPACTS)
    same = (found.sides == np.asarray(impacts.side)).all(axis=1)
    assert same.mean() > 0.97
    gaps = abs(found.ends - np.stack([end.x, end.v], axis=1))[same].max(axis=1)
    assert np.median(gaps) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "bounce"), [(0.05, 0.7), pytest.param(0.65, 0.4, marks=pytest.mark.long)])
def test_area_and_its_derivatives_are_those_of_quadrature(damping, bounce):
    def width(w, damping, bounce):
        with mp.workdps(20):
            grazing = mp.sqrt((1 - w * w) ** 2 + (2 * damping * w) ** 2)
            return float(grazing - double_root(w, damping, bounce, 1, 1, -1)[0])

    def area(damping, bounce):
        return quad(width, math.sqrt(1 - damping**2), 3.0, args=(damping, bounce), epsabs=1e-11, epsrel=1e-11)[0]

    assert float(closed_forms.coexistence_area(damping, bounce, 3.0, 48)) == pytest.approx(
        area(damping, bounce), abs=1e-8
    )
    step = 1e-4
    slopes = [float(one) for one in jax.jacfwd(closed_forms.coexistence_area, (0, 1))(damping, bounce, 3.0, 48)]
    by_damping = (area(damping + step, bounce) - area(damping - step, bounce)) / (2 * step)
    by_bounce = (area(damping, bounce + step) - area(damping, bounce - step)) / (2 * step)
    assert slopes == pytest.approx([by_damping, by_bounce], abs=1e-5)


def test_panels_have_the_values_of_their_columns():
    file = read_scene_file(SCENES / "fig2.toml")
    found = [each.scene.make() for each in panel_scene_files(file)]
    assert [float(one.frequency) for one in found] == [1.9, 2.3, 1.9, 2.3]
    assert [float(one.left.position) for one in found] == [-1.0, -1.0, -1.5, -1.5]


@pytest.mark.parametrize(
    ("tables", "key"),
    [
        ({"panels": {"speed": [1.0]}}, "panels.speed"),
        ({"panels": {"amplitude": [1.0, 2.0], "damping": [0.1]}}, "panels"),
        ({"panels": {"amplitude": []}}, "panels"),
        ({"panels": {"damping": [0.1, -1.0]}}, "panels.damping"),
        ({"spectrum": {"parameter": "size", "from": 0.0, "to": 1.0, "count": 3}}, "spectrum.parameter"),
        ({"spectrum": {"parameter": "amplitude", "from": 0.0, "to": 1.0, "count": 3, "error": 0.0}}, "spectrum.error"),
        ({"basins": {"x": [0.0, 1.5], "v": [-1.0, 1.0], "count": 9}}, "basins.x"),
        ({"basins": {"x": [0.0, 1.0], "v": [1.0, -1.0], "count": 9}}, "basins.v"),
    ],
)
def test_bad_tables_are_one_clear_error(tables, key):
    with pytest.raises(jv.ArgumentError) as error:
        parse_tables({"scene": SCENE} | tables)
    assert error.value.key == key


@pytest.mark.long
def test_ranges_in_which_two_legs_differ():
    swept = jv.sweep(
        jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)),
        "amplitude",
        np.stack([np.linspace(4.0, 0.0, 21), np.linspace(0.0, 4.0, 21)], -1),
        jv.State(np.array([0.9, 0.0]), np.array([-1.1, 0.0])),
        settle=150,
        keep=4,
    )
    (low, high), *rest = hysteresis_ranges(swept.rename(lane="leg"))
    # P100 grazes at 3.416, and the step from 3.2 to 3.4 sets it swinging farther than that
    assert (low, high, rest) == (pytest.approx(0.6), pytest.approx(3.2), [])


@pytest.fixture
def jobs(monkeypatch):
    """Two jobs that need no work; the second is interrupted at first."""
    calls = []

    def one(file, show_progress):
        calls.append("one")
        claim = number_claim("1", "a|b <i>", "0.5", (0.51, 0.0))
        return FigureResult(b"\x89PNG", "<b> & so on", (claim,), {"": xr.Dataset({"a": ("b", np.arange(3.0))})})

    def two(file, show_progress):
        calls.append("two")
        if calls.count("two") == 1:
            raise KeyboardInterrupt
        return FigureResult(None, "", (additional_claim("2", "never", (1.0, 0.0), high=0.0, reason="Because."),))

    jobs = {name: figure_jobs.FigureJob(name, ("formulas",), drawn) for name, drawn in (("one", one), ("two", two))}
    monkeypatch.setattr(run, "JOBS", jobs)
    return calls


def test_an_interrupted_run_goes_on_where_it_stopped(jobs, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        jv.paper(out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "one.nc", "one.png"]
    done = jv.paper(out=tmp_path)
    assert jobs == ["one", "two", "two"]
    assert [one.verdict for one in done.claims] == [AGREES, CANNOT_HOLD]
    assert [one.ours for one in done.claims] == [False, True]
    jv.paper(out=tmp_path)
    assert len(jobs) == 3
    jv.paper(["one"], tmp_path, force=True)
    (tmp_path / "two.json").write_text("{")
    jv.paper(out=tmp_path)
    assert jobs[3:] == ["one", "two"]


def test_what_is_damaged_or_gone_is_computed_again(jobs, tmp_path):
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


def test_the_report_needs_no_other_file_and_shows_what_was_written(jobs, tmp_path):
    jv.paper(["one"], tmp_path)
    told = (tmp_path / "report.html").read_text()
    assert "http" not in told and 'src="data:image/png;base64,' in told
    assert "&lt;b&gt; &amp; so on" in told and "a|b &lt;i&gt;" in told
    assert "a\\|b <i>" in (tmp_path / "report.md").read_text()
    assert json.loads((tmp_path / "one.json").read_text())["claims"][0]["verdict"] == AGREES


def test_a_reason_is_given_only_where_a_claim_is_not_right():
    claims = [number_claim("1", "", "0.5", (value, 0.0), "Because.") for value in (0.51, 0.61)]
    assert [row[-1] for row in claim_rows(claims)] == ["", "Because."]
    assert "1 " in report_html([("x", FigureResult(None, "", tuple(claims)))])


def test_an_unknown_figure_is_refused(tmp_path, capsys):
    assert main(["paper", "fig99", "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert (
        told.startswith("jaxvibro: figure: must be one of those known, perhaps fig9 (fig2, ") and told.count("\n") == 1
    )
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(jv.ArgumentError, match="workers: must be a whole number from 1 on; got 0"):
        jv.paper(["fig9"], tmp_path, workers=0)


@pytest.mark.long
def test_formulas_and_one_wall(tmp_path):
    done = jv.paper(["formulas", "walls"], tmp_path, workers=2)  # a process each
    found = {(one.figure, one.text): one for one in done.claims}
    verdicts = [one.verdict for one in done.claims if one.figure == "one wall" and "same as" in one.text]
    assert verdicts == [HOLDS, CANNOT_HOLD, CANNOT_HOLD]
    (fold,) = (one for one in found.values() if one.figure == "(19)")
    assert fold.value == pytest.approx(0.508057896812, abs=1e-12) and fold.verdict == DIFFERS
    (moving,) = (one for one in found.values() if one.figure == "moving wall")
    assert abs(moving.value) < 1e-12 and moving.verdict == HOLDS and moving.ours
    assert [one.verdict for one in done.claims if one.figure in ("(8)", "(35)", "method")] == [HOLDS] * 5
