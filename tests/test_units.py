"""Scenes that know their units: SI quantities, results in N, Hz, mm, m/s and W, and mistakes with units."""

import re
import warnings
from dataclasses import replace

import jax
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.output.units import display_unit, unit_of
from jaxvibro.plot.branch import find_covering_line
from jaxvibro.problem.curve_ends import End, parse_end
from jaxvibro.problem.orbit_curve import largest_speed, stability_around, stability_words, work_rate
from tests.scene_files import refusal

RIG = {"mass": 0.5, "damping_ratio": 0.05, "stiffness": 3e4, "force": 30.0, "frequency_hz": 82.0, "restitution": 0.7}
NATURAL = np.sqrt(3e4 / 0.5)
SPEED = 0.5e-3 * NATURAL  # m/s
STATE = jv.State(0.0, 0.0)


def rig(**changes):
    """Return the scene of a rig, whose unit of length is 0.5 mm."""
    return jv.scene_from_physical(**{**RIG, "gap": 0.5e-3, **changes})


@pytest.fixture(scope="module")
def followed():
    """A branch of the rig, and the branch of the same scene without scales."""
    scene = rig(frequency_hz=2.1 * NATURAL / (2 * np.pi))
    plain = jv.make_scene(float(scene.amplitude), float(scene.frequency), 0.05, 0.7, (-1.0, 1.0))
    orbits = [jv.find_orbit(given, jv.State(0.9, -1.1)) for given in (scene, plain)]
    return [jv.follow(orbit, "amplitude", bounds=(0.0, 6.0)) for orbit in orbits]


def test_the_three_ways_to_give_a_quantity_agree():
    omitted = dict.fromkeys(("damping_ratio", "frequency_hz", "gap"))
    given = {"damping": 2 * 0.05 * np.sqrt(3e4 * 0.5), "frequency": 2 * np.pi * 82.0, "walls": (-0.5e-3, 0.5e-3)}
    scene, again = rig(), rig(**omitted, **given)
    for name in scene.names:
        assert float(scene.parameter(name)) == pytest.approx(float(again.parameter(name)), rel=1e-15)
    assert float(scene.frequency) == pytest.approx(2 * np.pi * 82.0 / NATURAL, rel=1e-15)
    assert rig(gap=(None, 1e-3)).left is None and float(rig(gap=(2e-3, 1e-3)).left.position) == -2.0
    at_zero = rig(gap=(1e-3, 0.0), length=1e-3)
    assert float(at_zero.right.position) == 0.0 and float(at_zero.left.position) == -1.0
    assert rig(mass=np.array([0.5, 0.6])).scales is None
    assert jax.jit(lambda force: rig(force=force).amplitude)(30.0) == scene.amplitude


def test_quantities_of_a_rig_are_those_it_was_given():
    """Along a parameter of the scene, pictures and tables show the SI quantity."""
    damper = 2 * 0.05 * np.sqrt(3e4 * 0.5)
    scene = rig(frequency_hz=None, frequency=2 * np.pi * 82.0, damping_ratio=None, damping=damper)
    quantities = {"amplitude": 30.0, "frequency": 82.0, "damping": damper, "left.position": -0.5}
    for name, expected in quantities.items():
        shown = float(scene.parameter(name)) * display_unit(unit_of(name), scene.scales)[1]
        assert shown == pytest.approx(expected, rel=1e-14), name


LEFT_OF_ZERO = "length: must be given if the right wall is not right of 0: are the walls in the wrong order"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"walls": (-1.0, 1.0)}, "walls: must be given, or gap, but not both"),
        ({"gap": None}, "walls: must be given, or gap, but not both"),
        ({"damping": 1.0}, "damping: must be given, or damping_ratio, but not both; got 1.0"),
        ({"frequency_hz": None}, "frequency: must be given, or frequency_hz, but not both"),
        ({"gap": (1.0, 2.0, 3.0)}, "gap: must be a number, or"),
        ({"gap": (jv.Wall(1.0), None)}, "gap: must be a number, or"),
        ({"gap": "1 mm"}, "gap: must be a real number"),
        ({"gap": -1e-3}, LEFT_OF_ZERO),
        ({"gap": 0.0}, "length: must be given if the gap, or the right wall's position, is 0"),
        ({"gap": (1e-3, 0.0)}, "length: must be given if the gap"),
        ({"gap": None, "walls": (-1e-3, 0.0)}, "length: must be given if the gap"),
        ({"gap": None, "walls": (-1.0, None)}, "length: must be given"),
        ({"gap": None, "walls": (-1.0, -0.5)}, LEFT_OF_ZERO),
        ({"gap": None, "walls": ("a", 1.0)}, r"left\.position: must be a real number"),
        ({"gap": None, "walls": (jv.Wall(-1.0, motion=3), 1.0)}, r"left\.motion: must be a Motion"),
        ({"gap": None, "walls": 3}, "walls: must be a pair"),
        ({"mass": None}, "mass: must be given"),
        ({"mass": 0.0}, "mass: must be greater than 0"),
        ({"stiffness": -1.0}, "stiffness: must be greater than 0"),
        ({"stiffness": 0.0}, r"stiffness: must be greater than 0: .*make_scene with a Force; got 0\.0"),
        ({"mass": np.ones(2), "stiffness": np.ones(3)}, "stiffness: must broadcast"),
        ({"damping_ratio": -0.1}, "damping: must not be negative"),
        ({"frequency_hz": 0.0}, "frequency: must be greater than 0"),
        ({"force": float("nan")}, "force: must be finite"),
        ({"force": np.sin(np.arange(4096.0))}, r"force: must be the drive amplitude, not a force in t.*\(4096,\)"),
        ({"length": -1.0}, "length: must be greater than 0"),
        ({"restitution": 7.0}, "restitution: must lie between 0 and 1"),
    ],
)
def test_wrong_or_missing_quantities_are_refused(changes, said):
    assert re.match(said, refusal(rig, **changes))


HERTZ_AND_MM = {"frequency_hz": None, "frequency": 40.0, "gap": 0.5, "force": 20.0, "damping_ratio": 0.02}


@pytest.mark.parametrize(
    ("changes", "asked"),
    [
        (HERTZ_AND_MM, r"frequency in Hz.*0\.163.*1\.03.*positions in mm.*50\.1"),
        ({"damping_ratio": 5}, r"damping ratio in per cent \(5\)"),
        ({"gap": (-0.2e-3, 0.5e-3)}, r"is gap \(-0\.0002, 0\.0005\) meant as positions"),
        ({"force": 30.0 * np.exp(-np.linspace(0.0, 1.0, 4096))}, "its 4096 values make a batch of 4096 scenes"),
    ],
)
def test_one_warning_asks_about_units_that_look_wrong(changes, asked):
    with pytest.warns(UserWarning, match=asked) as caught:
        rig(**changes)
    assert len(caught) == 1


def test_usual_quantities_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rig()
        rig(frequency_hz=40.0 / (2 * np.pi))  # 40 rad/s is meant
        rig(frequency_hz=None, frequency=60.0 * np.pi)
        rig(frequency_hz=None, frequency=np.array([40.0, 50.0]))
        assert rig(force=np.linspace(10.0, 30.0, 50)).shape == (50,)


def test_orbits_in_physical_units(followed):
    orbit = followed[0].orbit(len(followed[0]) - 1)
    plain, physical = (orbit.table(units).splitlines() for units in ("scene", "physical"))
    assert plain[0] == physical[0] and plain[0].startswith(orbit.label + ", ")
    assert physical[1].startswith("x (mm) ") and "v (m/s) " in physical[1]
    assert physical[2].split() == ["time", "(s)", "wall", "speed", "(m/s)"] and len(physical) == 3 + orbit.impacts.count
    for row, other, time, speed in zip(plain[3:], physical[3:], orbit.impacts.time, orbit.impacts.speed, strict=True):
        assert float(row.split()[0]) == pytest.approx(time, rel=1e-8)
        assert float(other.split()[0]) == pytest.approx(time / NATURAL, rel=1e-8)
        assert float(other.split()[2]) == pytest.approx(SPEED * speed, rel=1e-8)
        assert row.split()[1] == other.split()[1]


def test_scales_are_written_and_read(tmp_path, followed):
    scene = rig()
    assert scene.scales == jv.Scales(0.5, 3e4, 0.5e-3)
    jv.save_scene(scene, tmp_path / "rig.toml")
    assert jv.load_scene(tmp_path / "rig.toml").scales == scene.scales
    followed[0].save(tmp_path / "branch.nc")
    again = jv.load_branch(tmp_path / "branch.nc")
    assert again.table(units="physical") == followed[0].table(units="physical")
    assert again.orbit(0).scene.scales == again.special[0].scene.scales == scene.scales
    (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text().replace("mass = 0.5", "mass = -1.0"))
    with pytest.raises(jv.SceneError, match=r"scales.mass: must be greater than 0; got -1.0"):
        jv.load_scene(tmp_path / "rig.toml")


def test_tables_in_physical_units_are_converted_ones(followed):
    with_scales, without = followed
    sizes = {"amplitude (N)": 15.0, "x (mm)": 0.5, "v (m/s)": SPEED, "least_clearance (mm)": 0.5}
    sizes |= {"least_speed (m/s)": SPEED, "largest_speed (m/s)": SPEED, "work_rate (W)": 3e4 * 0.5e-3**2 * NATURAL}
    plain, physical = without.to_frame(), with_scales.to_frame("physical")
    assert len(plain.columns) == len(physical.columns)
    for name, expected in zip(physical.columns, plain.columns, strict=True):
        assert name.split(" ")[0] == expected
        if physical[name].dtype == float:
            error = physical[name] - sizes.get(name, 1.0) * plain[expected]
            assert np.nanmax(abs(error)) <= 1e-14 * np.nanmax(abs(physical[name])) or expected.startswith("multiplier")
        else:
            assert (physical[name] == plain[expected]).all()
    assert refusal(without.to_frame, "physical").startswith("units: physical units need scales")
    assert refusal(with_scales.table, units="SI") == "units: must be one of scene, physical; got 'SI'"


def test_tables_have_stability_and_names_of_other_programs(followed):
    for branch in followed:
        words, lines = branch.to_frame()["stability"].values, branch.table().splitlines()
        for place, line in ((0, lines[1]), (-1, lines[len(branch.special)])):
            assert line.startswith("EP") and f"  {words[place]}  " in line
    lines = followed[0].table().splitlines()
    assert [line.split()[0] for line in lines[1:6]] == ["EP", "GR", "SN", "SB", "EP"]
    assert "stable to saddle" in lines[2] and "saddle to stable" in lines[3] and "stable to saddle" in lines[4]
    physical = followed[0].table(units="physical", labels="auto").splitlines()
    assert physical[0].startswith("kind  amplitude (N)") and physical[3].startswith("LP    7.62086845219")
    assert physical[-1] == "last point: the parameter reached its bound 90"
    assert " LPC" in "\n" + followed[0].table(labels="matcont").replace("\n", "\n ")
    expected = "labels: must be one of jaxvibro, auto, matcont; got 'coco'"
    assert refusal(followed[0].table, labels="coco") == expected


def test_reasons_of_ends_are_read_and_rescaled(followed):
    for end in End:
        reason = end.reason(2.0, "SN").text
        assert parse_end(reason) is end
        *_, line = replace(followed[0], reasons=(reason, reason)).table(units="physical").splitlines()
        assert line.startswith("last point: ") and (" 30" in line) == (" 2" in reason), line


def test_the_work_rate_is_the_work_of_drive_and_damper(followed):
    """Over a period the work of the drive is lost in the damper and at the impacts."""
    branch, frame = followed[1], followed[1].to_frame()
    rows = np.flatnonzero(frame["label"] == "P111")
    for row in rows[:: len(rows) // 4]:
        orbit = branch.orbit(int(row))
        scene, trace = orbit.scene, jv.simulate(orbit.scene, orbit.state, 1, 20_000)
        t, v, phase = (trace[name].values for name in ("time", "v", "phase"))
        power = float(scene.amplitude) * np.cos(phase) * v - 2 * float(scene.damping) * v**2
        assert frame["work_rate"][row] == pytest.approx(np.trapezoid(power, t) / t[-1], rel=2e-3, abs=2e-4)
        u = np.asarray(orbit.impacts.speed)
        assert frame["work_rate"][row] == pytest.approx(0.5 * (1 - 0.7**2) * np.sum(u**2) / t[-1], rel=1e-12)
        assert frame["largest_speed"][row] == pytest.approx(u.max(), rel=1e-12)
    free = frame["label"] == "P100"
    assert free.any() and (frame["work_rate"][free] == 0).all() and (frame["largest_speed"][free] == 0).all()
    assert (frame["largest_speed"][~free] >= 0).all() and np.isfinite(branch.curves("speed").pieces[0].columns).all()


def test_loads_of_impacts_that_end_in_rest_and_of_no_impact():
    sides, speeds = np.array([[2, 1, -1, 0], [1, 2, -1, 0]]), np.array([[0.0, 2.0, 3.0, np.nan]] * 2)
    walls = {side: np.array([0.5] * 2) for side in ("left", "right")}
    rates = work_rate(sides, speeds, walls, np.ones(2))
    np.testing.assert_allclose(rates, [0.5 * 0.75 * 4 + 0.5 * 9, 0.5 * 0.75 * 9], atol=1e-15)
    soft = work_rate(sides[:, 1:], speeds[:, 1:], {"left": np.array([np.nan, 0.5])}, np.ones(2))
    assert np.isnan(soft).tolist() == [True, False]
    sides, speeds = [[0, 0], [1, -1], [-2, 0], [2, 1]], [[np.nan] * 2, [0.3, 0.7], [0.9, 0.0], [0, 1.5]]
    assert largest_speed(np.array(sides), np.array(speeds)).tolist() == [0.0, 0.7, 0.0, 1.5]


def test_stability_in_words():
    """Beside a special point it is that of the neighbours, at an end that of the end itself, also next to a PD."""
    pairs = np.array([[0.5, 0.2], [1.5, 0.1], [-1.5, 0.1], [-2.0, 3.0], [1.0, 0.3], [np.inf, np.inf], [0.6 + 0.6j] * 2])
    words = ["stable", "saddle", "flip saddle", "repelling", "neutral", "repelling", "stable"]
    assert stability_words(pairs).tolist() == words
    past_doubling = [[-0.9, -0.03], [-1.0, -0.02], [-1.1338, -0.0198]]
    two_folds = [[0.9, 0.3], [1.0, 0.3], [1.0, 0.1], [0.8, 0.1]]  # no point between them
    doubling_and_fold = [[-0.9, -0.3], [-1.0, -0.3], [1.0, 0.3], [1.2, 0.3]]  # stable in between
    for multipliers, rows, expected in (
        (past_doubling, (0, 1, 2), ["stable", "stable to flip saddle", "flip saddle"]),
        (two_folds, (1, 2), ["stable to neutral", "neutral to stable"]),
        (doubling_and_fold, (1, 2), ["stable", "stable to saddle"]),
    ):
        multipliers = np.array(multipliers)
        assert [stability_around(multipliers, row) for row in rows] == expected


def test_the_range_of_a_closed_branch(followed):
    branch = followed[1]
    low, high, (first, last) = branch.values.min(), branch.values.max(), branch.values[[0, -1]]
    assert repr(branch).startswith(f"Branch(amplitude from {first:g} to {last:g}")
    closed = replace(branch, ends=(End.CLOSED, End.CLOSED))
    assert repr(closed).startswith(f"Branch(amplitude closed, between {low:g} and {high:g}, ")
    returning = replace(branch, data=branch.data.isel(point=np.r_[0 : len(branch), 0]))
    assert f"from {first:g} to {first:g}, between {low:g} and {high:g}" in repr(returning)


def test_lines_that_coincide_are_drawn_once(followed):
    """Two dashed lines on one another look solid, which means stable."""
    branch, ax = followed[1], Figure().subplots()

    def lines():
        return [line for line in ax.lines if line.get_gid() == "branch" and np.size(line.get_xdata())]

    jv.plot.branch(branch, "speed", ax)
    first = lines()
    dashed = [line for line in first if line.get_linestyle() == "--"]
    assert dashed and any(line.get_linestyle() == "-" for line in first)
    jv.plot.branch(branch, "speed", ax)
    image = replace(branch, segments=tuple(replace(segment, label="P101") for segment in branch.segments))
    jv.plot.branch(image, "speed", ax)  # a mirror image has other labels
    assert lines() == first
    labels = ", ".join(dict.fromkeys(segment.label for segment in branch.segments))
    assert f"P101, on {labels}" in [line.get_label() for line in ax.lines]
    (x, y), width = dashed[0].get_data(), dashed[0].get_linewidth()
    assert find_covering_line(ax, x[::-1][::3], y[::-1][::3], width) is dashed[0]  # at other points, reversed
    assert find_covering_line(ax, x, y + 0.01 * np.ptp(y), width) is None
    assert find_covering_line(ax, x, y, 2.0 * width) is None


def test_datasets_and_pictures_in_physical_units(followed):
    branch = followed[0]
    data, physical = branch.data, jv.to_physical(branch.data)
    assert physical["amplitude"].attrs["units"] == "N" and physical["v"].attrs["units"] == "m/s"
    np.testing.assert_allclose(physical["amplitude"], 15.0 * data["amplitude"], rtol=1e-15)
    np.testing.assert_allclose(physical["time"], data["time"] / NATURAL, rtol=1e-15)
    assert refusal(jv.to_physical, followed[1].data).startswith("data: must be a Dataset of a scene with scales")
    ax = jv.plot.branch(branch, "speed", Figure().subplots(), units="physical", labels="auto")
    assert ax.get_xlabel() == "drive amplitude $F$ (N)" and ax.get_ylabel() == "largest impact speed (m/s)"
    assert "LP: saddle-node" in ax.get_legend_handles_labels()[1]
    drawn = [line.get_xdata() for line in ax.lines if line.get_gid() == "branch" and len(line.get_xdata())]
    assert max(across.max() for across in drawn) == pytest.approx(90.0)
    swept = jv.to_physical(jv.sweep(rig(), "frequency", [2.0, 2.1], STATE, settle=3, keep=2))
    np.testing.assert_allclose(swept["frequency"], np.array([2.0, 2.1]) * NATURAL / (2 * np.pi))
    assert swept["frequency"].attrs["units"] == "Hz" and swept["x"].attrs["units"] == "mm"


def test_a_motion_in_physical_units():
    """The response to M X'' + C X' + K X = F cos(Omega T), and the times and speeds of impacts, in SI."""
    scene, mass, damping, omega = rig(), 0.5, 2 * 0.05 * np.sqrt(3e4 * 0.5), 2 * np.pi * 82.0
    amplitude, frequency, ratio = (float(scene.parameter(name)) for name in ("amplitude", "frequency", "damping"))
    response = 0.5e-3 * amplitude / (1 - frequency**2 + 2j * ratio * frequency)
    assert response == pytest.approx(30.0 / (3e4 - mass * omega**2 + 1j * damping * omega), rel=1e-14)
    trace = jv.simulate(scene.replace(amplitude=8.0), jv.State(0.2, 0.3), 3, 200)
    physical = jv.to_physical(trace)
    assert len(trace["speed"]) > 3 and float(physical["time"][-1]) == pytest.approx(3.0 / 82.0, rel=1e-14)
    for name, size in (("x", 0.5), ("v", SPEED), ("speed", SPEED), ("time", 1 / NATURAL), ("impact_time", 1 / NATURAL)):
        np.testing.assert_allclose(physical[name], size * trace[name], rtol=1e-14)


def test_a_run_writes_tables_for_spreadsheets(tmp_path):
    path, out = tmp_path / "rig.toml", tmp_path / "out"
    jv.save_scene(rig(frequency_hz=81.88), path)
    legs = "[{name='up', from=0.5, to=1.0, start={x=0.0, v=0.0}}]"
    tables = [f"sweep = {{parameter='amplitude', count=3, settle=5, keep=2, legs={legs}}}"]
    tables += ["branch = {parameter='amplitude', bounds=[0.5, 4.0], at={amplitude=1.0}}"]
    done = jv.run(path, out, tables, csv=True, units="physical")
    swept, branches = (pd.read_csv(out / f"rig.{table}.csv") for table in ("sweep", "branches"))
    assert list(swept.columns[:6]) == ["leg", "amplitude (N)", "period", "x (mm)", "v (m/s)", "status"]
    loads = ["largest_speed (m/s)", "largest_force (N)", "work_rate (W)"]
    assert list(swept.columns[6:]) == [f"{side} {load}" for side in ("left", "right") for load in loads]
    scene = rig(frequency_hz=81.88).replace(amplitude=swept["amplitude (N)"].values / 15.0)
    impacts = jv.strobe(scene, jv.State(swept["x (mm)"].values / 0.5, swept["v (m/s)"].values / SPEED), slots=8)[1]
    speeds = np.where(impacts.side == 1, impacts.speed, 0.0).max(axis=1) * SPEED
    np.testing.assert_allclose(swept["right largest_speed (m/s)"].fillna(0.0), speeds, rtol=1e-9)
    np.testing.assert_allclose(swept["amplitude (N)"], np.repeat([7.5, 11.25, 15.0], 2), rtol=1e-14)
    np.testing.assert_allclose(swept["x (mm)"], 0.5 * jv.load_data(out / "rig.nc")["x"].values.ravel(), rtol=1e-14)
    assert branches["amplitude (N)"].max() == 60.0 and {"stable", "saddle"} <= set(branches["stability"])
    assert re.search(r"^SN +7\.6\d+ +P111 ", done.table, re.M) and re.search(r"^amplitude +30 +N$", done.table, re.M)
    assert done.summary["files"]["sweep table"].endswith("rig.sweep.csv")
    with pytest.raises(FileExistsError):
        jv.run(path, out, csv=True)


HERTZ = [30.0, 45.0, 60.0]
OF_SCENES = {
    "sweep": lambda scene: jv.sweep(scene, "frequency", HERTZ, STATE),
    "spectrum": lambda scene: jv.spectrum(scene, "frequency", HERTZ, STATE),
    "fractions": lambda scene: jv.fractions(scene, "frequency", HERTZ),
    "map": lambda scene: jv.map_parameters(scene, {"frequency": HERTZ}),
    "explore": lambda scene: jv.explore(scene, "frequency", (30.0, 60.0)),
    "diagrams": lambda scene: jv.diagrams(scene, "frequency", (30.0, 60.0), "damping", [0.05]),
    "diagrams over": lambda scene: jv.diagrams(scene, "amplitude", (0.1, 3.0), "frequency", HERTZ),
}
OF_ORBITS = {
    "follow": lambda orbit: jv.follow(orbit, "frequency", (30.0, 60.0)),
    "follow_all": lambda orbit: jv.follow_all([orbit], "frequency", (30.0, 60.0)),
    "search": lambda orbit: jv.search(orbit.scene, "SN", {"frequency": 0.1}, {"frequency": (30.0, 60.0)}),
    "margin": lambda orbit: jv.margin(orbit, {"frequency": 0.1}, {"frequency": (30.0, 60.0)}),
}


@pytest.fixture(scope="module")
def slow_orbit():
    """An orbit without impacts of the rig, driven at 45 Hz."""
    return jv.find_orbit(rig(frequency_hz=45.0).replace(amplitude=0.1), STATE, 1, settle=0)


@pytest.mark.parametrize("study", [*OF_SCENES, *OF_ORBITS])
def test_values_and_bounds_in_hertz_are_refused(slow_orbit, study):
    if study in OF_SCENES:
        line = refusal(OF_SCENES[study], slow_orbit.scene)
        assert "frequency is 1.15" in line and "look like Hz; divide them by 38.98" in line
    else:
        assert "45 Hz (are these in Hz? divide them by 38.98" in refusal(OF_ORBITS[study], slow_orbit)


def test_values_that_may_be_hertz_are_asked_about(slow_orbit):
    with pytest.warns(UserWarning, match=r"in which it is 1\.15.*are these in Hz\? Divide them by 38\.98"):
        jv.sweep(slow_orbit.scene, "frequency", [12.0, 15.0], STATE, settle=1, keep=1)
    plain = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jv.sweep(plain, "frequency", [30.0, 60.0], STATE, settle=1, keep=1)
        jv.sweep(slow_orbit.scene, "frequency", [0.5, 4.0], STATE, settle=1, keep=1)


def test_names_that_are_no_parameters_get_advice(slow_orbit, tmp_path):
    advice = "vary left.position or right.position instead"
    assert advice in refusal(jv.follow, slow_orbit, "gap", (0.5, 1.5))
    assert advice in refusal(slow_orbit.scene.replace, gap=1.0)
    path = tmp_path / "rig.toml"
    jv.save_scene(slow_orbit.scene, path)
    assert re.match(r"scene\.freqency: is not a key.* frequency", refusal(jv.run, path, "out", ["freqency=2"]))
    assert refusal(jv.run, path, "out", ["swep.count=2"]).startswith("swep: ")
    traced = jax.jit(lambda amplitude: jv.find_orbit(slow_orbit.scene.replace(amplitude=amplitude), STATE))
    assert "inside, use solve_orbits; located has" in refusal(traced, 0.5)
