"""The table [fit] of a scene file: what a run of it tells, writes and draws."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.studies.record_file import load_measured_record
from jaxvibro.studies.schema import FitTable

SCENES = Path(__file__).parents[1] / "scenes"
TRUE = {
    "damping": 0.043,
    "left.restitution": 0.83,
    "right.restitution": 0.71,
    "right.position": 1.12,
    "frequency": 1.75,
}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return jv.run(SCENES / "fit.toml", out), out


def test_the_numbers_that_made_the_record_are_told(done):
    ran, out = done
    told = ran.summary["fit"]
    assert told["status"] == "OK" and told["values"].keys() == TRUE.keys()
    for name, value in TRUE.items():
        assert abs(told["values"][name] - value) < 4.0 * told["sigma"][name], name
    assert [side for _, side in told["missed"]] == [-1, -1, -1]
    assert [time for time, _ in told["missed"]] == pytest.approx([5.4226, 23.4292, 41.4270], abs=2e-2)
    data = jv.load_data(out / "fit.nc")
    assert data["fitted"].values.tolist() == list(TRUE) and data.sizes["heard"] == 47
    assert data["fit_value"].values.tolist() == list(told["values"].values())
    assert np.sqrt(np.diag(data["fit_covariance"].values)) == pytest.approx(data["fit_sigma"].values)
    assert np.sum(data["fit_residual"].values ** 2) == pytest.approx(told["chi2"])
    assert {one.name for one in out.iterdir()} == {f"fit{end}" for end in (".png", ".nc", ".txt")}


def test_a_record_in_physical_units_is_the_same_record(tmp_path):
    natural, length = 500.0, 0.4e-3
    pace = length * natural
    rig = jv.scene_from_physical(2.0, 30.0, 2.0 * natural**2, 40.0, 900.0, 0.7, (-0.3e-3, 0.4e-3))
    times, x, v = np.linspace(0.0, 30.0, 40), np.sin(np.arange(40.0)), np.cos(np.arange(40.0))
    plain = jv.SampleRecord(times, x, 0.01, v, 0.02, 0.3)
    given = jv.SampleRecord(times / natural, length * x, 0.01 * length, v * pace, 0.02 * pace, 0.3)
    heard = jv.ImpactRecord(times[:3], [1, -1, 1], 1e-3)
    rows = np.stack([given.times, 1e3 * given.x, given.v], 1).tolist()
    lines = ["time (s),x (mm),v (m/s)", *(f"{t!r},{one!r},{other!r}" for t, one, other in rows)]
    (tmp_path / "samples.csv").write_text("\n".join(lines))
    hits = zip((times[:3] / natural).tolist(), ("right", "left", "right"), strict=True)
    (tmp_path / "impacts.csv").write_text("\n".join(["time (s),side", *(f"{t!r},{side}" for t, side in hits)]))
    samples = FitTable(record="samples.csv", sigma=1e3 * given.sigma, free={}, sigma_v=given.sigma_v, phase=0.3)
    impacts = FitTable(record="impacts.csv", sigma=1e-3 / natural, free={})
    assert_alike(plain, jv.record_from_physical(given, rig))
    assert_alike(plain, load_measured_record(tmp_path, samples, rig))
    assert_alike(heard, load_measured_record(tmp_path, impacts, rig))
    with pytest.raises(jv.SceneError, match=r"line 1: must be time,x,v, as the scene has no \[scene.scales\]"):
        load_measured_record(tmp_path, samples, jv.make_scene(1.0, 2.0, 0.1, 0.7, (-1.0, 1.0)))
    few = jv.SampleRecord(times[:2] / natural, x[:2], 0.01)
    with pytest.warns(UserWarning, match="are its times in seconds"), pytest.raises(jv.ArgumentError):
        jv.fit(rig, few, {"damping": 0.1, "amplitude": 1.0})


def assert_alike(one, other):
    for key, value in vars(one).items():
        given = np.asarray(getattr(other, key), float)
        np.testing.assert_allclose(given, np.asarray(value, float), rtol=1e-14, atol=1e-14)


def test_residuals_are_drawn_at_their_impacts():
    times, sides = np.loadtxt(
        SCENES / "fit.csv", delimiter=",", skiprows=1, converters={1: lambda side: 1 if side == "right" else -1}
    ).T
    record = jv.ImpactRecord(times, sides, 1e-3)
    scene = jv.load_scene(SCENES / "fit.toml")
    scales = dict.fromkeys(TRUE, 0.1) | {"damping": 0.01, "frequency": 0.05}
    found = jv.fit(scene, record, scales)
    ax = jv.plot.fit(found, record, Figure().subplots())
    drawn = {line.get_label(): line for line in ax.lines}
    assert len(drawn["left wall"].get_xdata()) == np.sum(sides < 0)
    assert drawn["right wall"].get_xdata().tolist() == times[sides > 0].tolist()
    assert drawn["right wall"].get_ydata().tolist() == found.residuals[sides > 0].tolist()
    assert drawn["missing"].get_xdata()[0] == found.missed[0][0]
    with pytest.raises(jv.ArgumentError, match=r"^plot.fit: must be given a Fit"):
        jv.plot.fit(record, record)


def test_samples_are_fitted_told_and_drawn(tmp_path):
    """Of x(t) at an unknown phase: the numbers and the phase that made the file, and its residuals in order."""
    ran = jv.run(SCENES / "fit_samples.toml", tmp_path)
    told = ran.summary["fit"]
    true = {"damping": 0.062, "left.restitution": 0.64, "right.restitution": 0.81, "right.position": 1.05}
    true |= {"frequency": 1.12, "phase": 1.3}
    assert told["status"] == "OK" and told["values"].keys() == true.keys()
    for name, value in true.items():
        assert abs(told["values"][name] - value) < 4.0 * told["sigma"][name] < 0.04, name
    assert "parameters fitted to the 241 samples of fit_samples.csv" in ran.table
    times, x = np.loadtxt(SCENES / "fit_samples.csv", delimiter=",", skiprows=1).T
    left = jv.load_data(tmp_path / "fit_samples.nc")["fit_residual"].values
    scene = jv.load_scene(SCENES / "fit_samples.toml").replace(
        **{name: told["values"][name] for name in list(true)[:5]}
    )
    record = jv.SampleRecord(times, x, 2e-3, phase=told["values"]["phase"])
    found = jv.fit(scene, record, {"damping": 0.01})
    assert found.residuals == pytest.approx(left, abs=0.2)
    ax = jv.plot.fit(found, record, Figure().subplots())
    drawn = {line.get_label(): line for line in ax.lines}
    assert drawn["x"].get_xdata().tolist() == times.tolist()
    assert drawn["x"].get_ydata().tolist() == found.residuals.tolist()
    with pytest.raises(jv.ArgumentError, match=r"^plot.fit: must be given an ImpactRecord or a SampleRecord"):
        jv.plot.fit(found, found)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("fit.free={damping=-1.0}", r"^fit.free.damping: must be a positive number"),
        ("fit.free={size=1.0}", r"^fit.size: "),
        ("fit.bounds={amplitude=[0.0,1.0]}", r"^fit.bounds.amplitude: must belong to a free parameter"),
        ("fit.sigma=0.0", r"^fit.sigma: must be a number greater than 0"),
        ("fit.phase='late'", r"^fit.phase: "),
        ("fit.record=''", r"^fit.record: "),
        ("fit.sigma_v=0.1", r"^fit.sigma_v: must be left out for impacts"),
    ],
)
def test_what_may_not_stand_there_is_one_clear_error(tmp_path, change, told):
    with pytest.raises(jv.SceneError, match=told):
        jv.run(SCENES / "fit.toml", tmp_path, [change])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("when,what\n1.0,left\n", r"^fit.csv, line 1: must be time,side or time,x or time,x,v or .*; got .*when,what"),
        ("", r"^fit.csv, line 1: must be time,side"),
        ("time,side\n1.0,left\n2.0,up\n", r"^fit.csv, line 3: must have a side left, right, -1, 1, \+1; got 'up'"),
        ("time,side\n1.0\n", r"^fit.csv, line 2: must be time, side"),
        ("time,side\nsoon,left\n", r"^fit.csv, line 2: must have a number for time; got 'soon'"),
        ("time,side\n2.0,left\n1.0,right\n", r"^fit.csv, times.*: must be in order"),
        ("time,side\nnan,left\n", r"^fit.csv, times"),
        ("time,side\n1.0,left\n2.0,right\n", r"^fit.data: must hold at least 7 values, as many as unknowns"),
        ("time,x\n1.0,0.1\n2.0,far\n", r"^fit.csv, line 3: must have a number for x; got 'far'"),
        ("time,x,v\n1.0,0.1\n", r"^fit.csv, line 2: must be time, x, v"),
        ("time,x\n1.0,0.1\n1.0,0.2\n", r"^fit.csv, times.*: must be in order"),
        ("time,x\n1.0,0.1\n2.0,0.2\n", r"^fit.data: must hold at least 7 values, as many as unknowns"),
    ],
)
def test_a_record_that_cannot_be(tmp_path, text, told):
    shutil.copy(SCENES / "fit.toml", tmp_path)
    (tmp_path / "fit.csv").write_text(text)
    with pytest.raises(jv.SceneError, match=told):
        jv.run(tmp_path / "fit.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_record_that_is_not_there(tmp_path):
    shutil.copy(SCENES / "fit.toml", tmp_path)
    with pytest.raises(FileNotFoundError):
        jv.run(tmp_path / "fit.toml", tmp_path / "out")


def test_a_run_reads_a_record_in_physical_units_as_python_does(tmp_path, monkeypatch):
    """The scene of a run has scales: the record of its [fit] is that of `record_from_physical`."""
    rig = jv.scene_from_physical(2.0, 30.0, 5e5, 40.0, 900.0, 0.7, (-0.3e-3, 0.4e-3))
    times = np.array([0.01, 0.02, 0.035])
    hits = zip(times.tolist(), ("right", "left", "right"), strict=True)
    (tmp_path / "impacts.csv").write_text("\n".join(["time (s),side", *(f"{t!r},{side}" for t, side in hits)]))
    asked = '[fit]\nrecord = "impacts.csv"\nsigma = 1e-5\nfree = { damping = 0.01 }\n'
    jv.save_scene(rig, tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text() + asked)

    class Asked(Exception):
        pass

    def study(file, heard, progress, store):
        raise Asked(heard)

    monkeypatch.setattr("jaxvibro.studies.run.run_studies", study)
    with pytest.raises(Asked) as caught:
        jv.run(tmp_path / "rig.toml", tmp_path)
    heard, known = (
        caught.value.args[0],
        jv.record_from_physical(jv.ImpactRecord(times, np.array([1, -1, 1]), 1e-5), rig),
    )
    assert heard.times.tolist() == known.times.tolist() and heard.sigma == known.sigma
    assert heard.sides.tolist() == known.sides.tolist()
