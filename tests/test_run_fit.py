"""The table [fit] of a scene file: results, files, plots, records in physical units, input."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv

SCENES = Path(__file__).parents[1] / "scenes"
TRUE = {
    "damping": 0.043,
    "left.restitution": 0.83,
    "right.restitution": 0.71,
    "right.position": 1.12,
    "frequency": 1.75,
}
SAMPLED = {"damping": 0.062, "left.restitution": 0.64, "right.restitution": 0.81, "right.position": 1.05}
SAMPLED |= {"frequency": 1.12, "phase": 1.3}


def test_impacts_are_fitted_written_and_drawn(tmp_path):
    """The numbers that made the record, three impacts that it lacks, and its residuals at their impacts."""
    summary = jv.run(SCENES / "fit.toml", tmp_path).summary["fit"]
    assert summary["status"] == "OK" and summary["values"].keys() == TRUE.keys()
    for name, value in TRUE.items():
        assert abs(summary["values"][name] - value) < 4.0 * summary["sigma"][name], name
    assert [side for _, side in summary["missed"]] == [-1, -1, -1]
    assert [time for time, _ in summary["missed"]] == pytest.approx([5.4226, 23.4292, 41.4270], abs=2e-2)
    data = jv.load_data(tmp_path / "fit.nc")
    assert data["fitted"].values.tolist() == list(TRUE) and data.sizes["heard"] == 47
    assert data["fit_value"].values.tolist() == list(summary["values"].values())
    assert np.sqrt(np.diag(data["fit_covariance"].values)) == pytest.approx(data["fit_sigma"].values)
    assert np.sum(data["fit_residual"].values ** 2) == pytest.approx(summary["chi2"])
    assert {path.name for path in tmp_path.iterdir()} == {f"fit{end}" for end in (".png", ".nc", ".txt")}
    names = {"right": 1, "left": -1}
    rows = [line.split(",") for line in (SCENES / "fit.csv").read_text().split()[1:]]
    times, sides = np.array([[float(time), names[side]] for time, side in rows]).T
    record = jv.ImpactRecord(times, sides, 1e-3)
    scales = dict.fromkeys(TRUE, 0.1) | {"damping": 0.01, "frequency": 0.05}
    found = jv.fit(jv.load_scene(SCENES / "fit.toml"), record, scales)
    drawn = {line.get_label(): line for line in jv.plot.fit(found, record, Figure().subplots()).lines}
    assert len(drawn["left wall"].get_xdata()) == np.sum(sides < 0)
    assert drawn["right wall"].get_xdata().tolist() == times[sides > 0].tolist()
    assert drawn["right wall"].get_ydata().tolist() == found.residuals[sides > 0].tolist()
    assert drawn["missing"].get_xdata()[0] == found.missed[0][0]
    with pytest.raises(jv.ArgumentError, match=r"^plot.fit: must be given a Fit"):
        jv.plot.fit(record, record)
    with pytest.raises(jv.ArgumentError, match=r"^plot.fit: must be given an ImpactRecord or a SampleRecord"):
        jv.plot.fit(found, found)


def test_samples_are_fitted_written_and_drawn(tmp_path):
    """Of x(t) at an unknown phase: the numbers and the phase that made the file, and its residuals in order."""
    ran = jv.run(SCENES / "fit_samples.toml", tmp_path)
    summary = ran.summary["fit"]
    assert summary["status"] == "OK" and summary["values"].keys() == SAMPLED.keys()
    for name, value in SAMPLED.items():
        assert abs(summary["values"][name] - value) < 4.0 * summary["sigma"][name] < 0.04, name
    assert "parameters fitted to the 241 samples of fit_samples.csv" in ran.table
    times, x = np.loadtxt(SCENES / "fit_samples.csv", delimiter=",", skiprows=1).T
    residuals = jv.load_data(tmp_path / "fit_samples.nc")["fit_residual"].values
    numbers = {name: summary["values"][name] for name in list(SAMPLED)[:5]}
    scene = jv.load_scene(SCENES / "fit_samples.toml").replace(**numbers)
    record = jv.SampleRecord(times, x, 2e-3, phase=summary["values"]["phase"])
    found = jv.fit(scene, record, {"damping": 0.01})
    assert found.residuals == pytest.approx(residuals, abs=0.2)
    drawn = {line.get_label(): line for line in jv.plot.fit(found, record, Figure().subplots()).lines}
    assert drawn["x"].get_xdata().tolist() == times.tolist()
    assert drawn["x"].get_ydata().tolist() == found.residuals.tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("free={damping=-1.0}", r"free.damping: must be a positive number"),
        ("free={size=1.0}", r"size: "),
        ("bounds={amplitude=[0.0,1.0]}", r"bounds.amplitude: must belong to a free parameter"),
        ("sigma=0.0", r"sigma: must be a number greater than 0"),
        ("phase='late'", r"phase: "),
        ("record=''", r"record: "),
        ("sigma_v=0.1", r"sigma_v: must be left out for impacts"),
    ],
)
def test_bad_tables(tmp_path, change, message):
    with pytest.raises(jv.SceneError, match=f"^fit.{message}"):
        jv.run(SCENES / "fit.toml", tmp_path, [f"fit.{change}"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("when,what\n1.0,left\n", r"csv, line 1: must be time,side or time,x or time,x,v or .*; got .*when,what"),
        ("", r"csv, line 1: must be time,side"),
        ("time,side\n1.0,left\n2.0,up\n", r"csv, line 3: must have a side left, right, -1, 1, \+1; got 'up'"),
        ("time,side\n1.0\n", r"csv, line 2: must be time, side"),
        ("time,side\nsoon,left\n", r"csv, line 2: must have a number for time; got 'soon'"),
        ("time,side\n2.0,left\n1.0,right\n", r"csv, times.*: must be in order"),
        ("time,side\nnan,left\n", r"csv, times"),
        ("time,side\n1.0,left\n2.0,right\n", r"data: must hold at least 7 values, as many as unknowns"),
        ("time,x\n1.0,0.1\n2.0,far\n", r"csv, line 3: must have a number for x; got 'far'"),
        ("time,x,v\n1.0,0.1\n", r"csv, line 2: must be time, x, v"),
        ("time,x\n1.0,0.1\n1.0,0.2\n", r"csv, times.*: must be in order"),
        ("time,x\n1.0,0.1\n2.0,0.2\n", r"data: must hold at least 7 values, as many as unknowns"),
        ("time (s),x (mm)\n1.0,0.1\n", r"csv, line 1: must be time,.* as the scene has no \[scene.scales\]"),
        (None, "No such file"),
    ],
)
def test_bad_records_of_a_file(tmp_path, text, message):
    shutil.copy(SCENES / "fit.toml", tmp_path)
    if text is not None:
        (tmp_path / "fit.csv").write_text(text)
    error = FileNotFoundError if text is None else jv.SceneError
    with pytest.raises(error, match=message if text is None else f"^fit.{message}"):
        jv.run(tmp_path / "fit.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def assert_alike(record, other):
    for key, value in vars(record).items():
        given = np.asarray(getattr(other, key), float)
        np.testing.assert_allclose(given, np.asarray(value, float), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("what", ["samples", "impacts"])
def test_a_record_in_physical_units_is_the_same_record(tmp_path, monkeypatch, what):
    """By `record_from_physical`, and in the file of a run whose scene has scales."""
    natural, length = 500.0, 0.4e-3
    pace = length * natural
    rig = jv.scene_from_physical(2.0, 30.0, 2.0 * natural**2, 40.0, 900.0, 0.7, (-0.3e-3, 0.4e-3))
    times, x, v = np.linspace(0.0, 30.0, 40), np.sin(np.arange(40.0)), np.cos(np.arange(40.0))
    if what == "samples":
        expected = jv.SampleRecord(times, x, 0.01, v, 0.02, 0.3)
        given = jv.SampleRecord(times / natural, length * x, 0.01 * length, v * pace, 0.02 * pace, 0.3)
        rows = np.stack([given.times, 1e3 * given.x, given.v], 1).tolist()
        lines = ["time (s),x (mm),v (m/s)", *(f"{t!r},{one!r},{other!r}" for t, one, other in rows)]
        table = f"sigma = {1e3 * given.sigma!r}\nsigma_v = {given.sigma_v!r}\nphase = 0.3"
    else:
        expected = jv.ImpactRecord(times[:3], [1, -1, 1], 1e-3)
        given = jv.ImpactRecord(times[:3] / natural, [1, -1, 1], 1e-3 / natural)
        hits = zip(given.times.tolist(), ("right", "left", "right"), strict=True)
        lines = ["time (s),side", *(f"{t!r},{side}" for t, side in hits)]
        table = f"sigma = {given.sigma!r}"
    assert_alike(expected, jv.record_from_physical(given, rig))
    (tmp_path / "record.csv").write_text("\n".join(lines))
    jv.save_scene(rig, tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(f'{text}\n[fit]\nrecord = "record.csv"\n{table}\nfree = {{ damping = 0.01 }}\n')
    records = []

    def study(file, record, progress, store):
        records.append(record)
        raise InterruptedError

    monkeypatch.setattr("jaxvibro.studies.run.run_studies", study)
    with pytest.raises(InterruptedError):
        jv.run(tmp_path / "rig.toml", tmp_path)
    assert_alike(expected, records[0])


def test_times_that_look_like_seconds_are_warned_of():
    rig = jv.scene_from_physical(2.0, 30.0, 5e5, 40.0, 900.0, 0.7, (-0.3e-3, 0.4e-3))
    few = jv.SampleRecord(np.array([0.0, 1.5e-3]), np.array([0.0, 0.8]), 0.01)
    with pytest.warns(UserWarning, match="are its times in seconds"), pytest.raises(jv.ArgumentError):
        jv.fit(rig, few, {"damping": 0.1, "amplitude": 1.0})
