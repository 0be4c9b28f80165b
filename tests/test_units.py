"""Scenes that know their units: what goes in in SI comes back in N, Hz, mm, m/s, W, and as SciPy has it."""

import re
import warnings
from dataclasses import replace

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.branches.branch import describe_extent
from jaxvibro.output.units import to_physical
from jaxvibro.plot.branch import find_covering_line
from jaxvibro.problem import impact_loads, stability_descriptions
from jaxvibro.problem.end import End, parse_end, rescale_reason_text
from jaxvibro.scene.scales import Scales

RIG = {"mass": 0.5, "damping_ratio": 0.05, "stiffness": 3e4, "force": 30.0, "frequency_hz": 82.0, "restitution": 0.7}


def rig(**changes):
    return jv.scene_from_physical(**{**RIG, "gap": 0.5e-3, **changes})


@pytest.fixture(scope="module")
def followed():
    scene = rig(frequency_hz=2.1 * np.sqrt(3e4 / 0.5) / (2 * np.pi))
    plain = jv.make_scene(float(scene.amplitude), float(scene.frequency), 0.05, 0.7, (-1.0, 1.0))
    orbits = [jv.find_orbit(one, jv.State(0.9, -1.1)) for one in (scene, plain)]
    return [jv.follow(one, "amplitude", bounds=(0.0, 6.0)) for one in orbits]


def test_the_three_ways_to_say_a_quantity_are_one():
    scene, natural = rig(), np.sqrt(3e4 / 0.5)
    again = jv.scene_from_physical(
        mass=0.5,
        damping=2 * 0.05 * np.sqrt(3e4 * 0.5),
        stiffness=3e4,
        force=30.0,
        frequency=2 * np.pi * 82.0,
        restitution=0.7,
        walls=(-0.5e-3, 0.5e-3),
    )
    for name in scene.names:
        assert float(scene.parameter(name)) == pytest.approx(float(again.parameter(name)), rel=1e-15)
    assert float(scene.frequency) == pytest.approx(2 * np.pi * 82.0 / natural, rel=1e-15)
    assert rig(gap=(None, 1e-3)).left is None and float(rig(gap=(2e-3, 1e-3)).left.position) == -2.0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"walls": (-1.0, 1.0)}, "walls: must be given, or gap, but not both"),
        ({"gap": None}, "walls: must be given, or gap, but not both"),
        ({"damping": 1.0}, "damping: must be given, or damping_ratio, but not both; got 1.0"),
        ({"frequency_hz": None}, "frequency: must be given, or frequency_hz, but not both"),
        ({"gap": (1.0, 2.0, 3.0)}, "gap: must be a number, or"),
        ({"gap": (jv.Wall(1.0), None)}, "gap: must be a number, or"),
        ({"gap": "1 mm"}, "gap: must be a real number"),
        ({"mass": None}, "mass: must be given"),
        ({"gap": -1e-3}, "length: must be given if the right wall is not right of 0: are the walls in the wrong"),
    ],
)
def test_what_is_said_twice_or_not_at_all_is_refused(changes, told):
    with pytest.raises(jv.SceneError, match=told):
        rig(**changes)


def test_one_warning_asks_about_hz_and_mm():
    with pytest.warns(UserWarning, match=r"frequency in Hz.*0\.163.*1\.03.*positions in mm.*50\.1") as told:
        rig(frequency_hz=None, frequency=40.0, gap=0.5, force=20.0, damping_ratio=0.02)
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rig()
        rig(frequency_hz=40.0 / (2 * np.pi))  # 40 rad/s is meant
        rig(frequency_hz=None, frequency=60.0 * np.pi)
        rig(frequency_hz=None, frequency=np.array([40.0, 50.0]))


def test_an_orbit_is_told_in_physical_units(followed):
    orbit = followed[0].orbit(len(followed[0]) - 1)
    natural = np.sqrt(3e4 / 0.5)
    plain, found = (orbit.table(units).splitlines() for units in ("scene", "physical"))
    assert plain[0] == found[0] and plain[0].startswith(orbit.label + ", ")
    assert found[1].startswith("x (mm) ") and "v (m/s) " in found[1]
    assert found[2].split() == ["time", "(s)", "wall", "speed", "(m/s)"] and len(found) == 3 + orbit.impacts.count
    for one, other, time, speed in zip(plain[3:], found[3:], orbit.impacts.time, orbit.impacts.speed, strict=True):
        assert float(one.split()[0]) == pytest.approx(time, rel=1e-8)
        assert float(other.split()[0]) == pytest.approx(time / natural, rel=1e-8)
        assert float(other.split()[2]) == pytest.approx(0.5e-3 * natural * speed, rel=1e-8)
        assert one.split()[1] == other.split()[1]


def test_per_cent_and_positions_are_asked_about():
    with pytest.warns(UserWarning, match=r"damping ratio in per cent \(5\)") as told:
        rig(damping_ratio=5)
    with pytest.warns(UserWarning, match=r"is gap \(-0\.0002, 0\.0005\) meant as positions") as other:
        rig(gap=(-0.2e-3, 0.5e-3))
    assert len(told) == len(other) == 1


def test_scales_stay_with_a_scene_and_make_no_other_program():
    scene = rig()
    assert scene.scales == Scales(0.5, 3e4, 0.5e-3)
    assert scene.replace(amplitude=3.0).scales == scene.scales
    assert jax.tree.structure(scene) == jax.tree.structure(replace(scene, scales=None))
    assert rig(mass=np.array([0.5, 0.6])).scales is None
    assert jax.jit(lambda force: rig(force=force).amplitude)(30.0) == scene.amplitude


def test_scales_are_written_and_read(tmp_path, followed):
    jv.save_scene(rig(), tmp_path / "rig.toml")
    assert jv.load_scene(tmp_path / "rig.toml").scales == Scales(0.5, 3e4, 0.5e-3)
    followed[0].save(tmp_path / "branch.nc")
    again = jv.load_branch(tmp_path / "branch.nc")
    assert again.table(units="physical") == followed[0].table(units="physical")
    assert again.orbit(0).scene.scales == again.special[0].scene.scales == Scales(0.5, 3e4, 0.5e-3)
    (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text().replace("mass = 0.5", "mass = -1.0"))
    with pytest.raises(jv.SceneError, match=r"scales.mass: must be greater than 0; got -1.0"):
        jv.load_scene(tmp_path / "rig.toml")


def test_tables_in_physical_units_are_those_in_numbers_converted(followed):
    one, other = followed
    natural = np.sqrt(3e4 / 0.5)
    sizes = {"amplitude (N)": 15.0, "x (mm)": 0.5, "v (m/s)": 0.5e-3 * natural, "least_clearance (mm)": 0.5}
    sizes |= {"least_speed (m/s)": 0.5e-3 * natural, "largest_speed (m/s)": 0.5e-3 * natural}
    sizes |= {"work_rate (W)": 3e4 * 0.5e-3**2 * natural}
    plain, found = other.to_frame(), one.to_frame("physical")
    assert len(plain.columns) == len(found.columns)
    for name, expected in zip(found.columns, plain.columns, strict=True):
        assert name.split(" ")[0] == expected
        if found[name].dtype == float:
            error = found[name] - sizes.get(name, 1.0) * plain[expected]
            assert np.nanmax(abs(error)) <= 1e-14 * np.nanmax(abs(found[name])) or expected.startswith("multiplier")
        else:
            assert (found[name] == plain[expected]).all()
    with pytest.raises(jv.ArgumentError, match="units: physical units need scales"):
        other.to_frame("physical")
    with pytest.raises(jv.ArgumentError, match="units: must be one of scene, physical; got 'SI'"):
        one.table(units="SI")


def test_a_table_tells_stability_and_names_of_other_programs(followed):
    lines = followed[0].table().splitlines()
    assert [line.split()[0] for line in lines[1:6]] == ["EP", "GR", "SN", "SB", "EP"]
    assert "stable to saddle" in lines[2] and "saddle to stable" in lines[3] and "stable to saddle" in lines[4]
    physical = followed[0].table(units="physical", labels="auto").splitlines()
    assert physical[0].startswith("kind  amplitude (N)") and physical[3].startswith("LP    7.62086845219")
    assert physical[-1] == "last point: the parameter reached its bound 90"
    assert " LPC" in "\n" + followed[0].table(labels="matcont").replace("\n", "\n ")
    with pytest.raises(jv.ArgumentError, match="labels: must be one of jaxvibro, auto, matcont; got 'coco'"):
        followed[0].table(labels="coco")


def test_why_a_branch_ends_is_told_in_another_unit():
    for end in End:
        reason = end.reason(2.0, "SN").text
        assert parse_end(rescale_reason_text(reason, 3.0)) is end
        assert ("6" in rescale_reason_text(reason, 3.0)) == ("2" in reason)


def test_the_work_rate_is_what_drive_and_damper_leave(followed):
    """Over a period the drive's work is what the damper and the impacts take."""
    branch, frame = followed[1], followed[1].to_frame()
    hit = np.flatnonzero(frame["label"] == "P111")
    for place in hit[:: len(hit) // 4]:
        orbit = branch.orbit(int(place))
        scene, trace = orbit.scene, jv.simulate(orbit.scene, orbit.state, 1, 20_000)
        t, v, phase = (trace[name].values for name in ("time", "v", "phase"))
        power = float(scene.amplitude) * np.cos(phase) * v - 2 * float(scene.damping) * v**2
        assert frame["work_rate"][place] == pytest.approx(np.trapezoid(power, t) / t[-1], rel=2e-3, abs=2e-4)
        u = np.asarray(orbit.impacts.speed)
        assert frame["work_rate"][place] == pytest.approx(0.5 * (1 - 0.7**2) * np.sum(u**2) / t[-1], rel=1e-12)
        assert frame["largest_speed"][place] == pytest.approx(u.max(), rel=1e-12)
    assert (frame["work_rate"][frame["label"] == "P100"] == 0).all()


def test_what_comes_to_rest_leaves_all_its_energy():
    sides, speeds = np.array([[2, 1, -1, 0], [1, 2, -1, 0]]), np.array([[0.0, 2.0, 3.0, np.nan]] * 2)
    found = impact_loads.work_rate(
        sides, speeds, {"left": np.array([0.5] * 2), "right": np.array([0.5] * 2)}, np.ones(2)
    )
    np.testing.assert_allclose(found, [0.5 * 0.75 * 4 + 0.5 * 9, 0.5 * 0.75 * 9], atol=1e-15)
    soft = impact_loads.work_rate(sides[:, 1:], speeds[:, 1:], {"left": np.array([np.nan, 0.5])}, np.ones(2))
    assert np.isnan(soft).tolist() == [True, False]


def test_stability_in_words():
    pairs = np.array([[0.5, 0.2], [1.5, 0.1], [-1.5, 0.1], [-2.0, 3.0], [1.0, 0.3], [np.inf, np.inf], [0.6 + 0.6j] * 2])
    told = ["stable", "saddle", "flip saddle", "repelling", "neutral", "repelling", "stable"]
    assert stability_descriptions.stability_words(pairs).tolist() == told


def test_a_table_s_stability_is_that_of_the_points():
    """Beside a special point it is that of the neighbours, at an end that of the end itself, also next to a PD."""
    pairs = np.array([[-0.9, -0.03], [-1.0, -0.02], [-1.1338, -0.0198]])
    assert [stability_descriptions.stability_around(pairs, k) for k in range(3)] == [
        "stable",
        "stable to flip saddle",
        "flip saddle",
    ]
    assert stability_descriptions.stability_words(pairs[-1:]).tolist() == ["flip saddle"]
    near = np.array([[0.9, 0.3], [1.0, 0.3], [1.0, 0.1], [0.8, 0.1]])  # two saddle-nodes, no point between them
    assert [stability_descriptions.stability_around(near, k) for k in (1, 2)] == [
        "stable to neutral",
        "neutral to stable",
    ]
    apart = np.array([[-0.9, -0.3], [-1.0, -0.3], [1.0, 0.3], [1.2, 0.3]])  # a PD, then an SN: stable in between
    assert [stability_descriptions.stability_around(apart, k) for k in (1, 2)] == ["stable", "stable to saddle"]


def test_a_table_and_a_frame_agree_on_the_ends(followed):
    for branch in followed:
        words, lines = branch.to_frame()["stability"].values, branch.table().splitlines()
        for place, line in ((0, lines[1]), (-1, lines[len(branch.special)])):
            assert line.startswith("EP") and f"  {words[place]}  " in line


def test_a_closed_branch_is_told_by_its_range(followed):
    branch = followed[1]
    low, high = branch.values.min(), branch.values.max()
    closed = replace(branch, ends=(End.CLOSED, End.CLOSED))
    assert describe_extent(closed) == f"closed, between {low:.12g} and {high:.12g}"
    assert describe_extent(closed, 2.0, 4) == f"closed, between {2 * low:.4g} and {2 * high:.4g}"
    assert repr(closed).startswith(f"Branch(amplitude closed, between {low:g} and {high:g}, ")
    first, last = branch.values[[0, -1]]
    assert describe_extent(branch).startswith(f"from {first:.12g} to {last:.12g}")
    turned = replace(branch, data=branch.data.isel(point=np.r_[0 : len(branch), 0]))  # there and back
    assert describe_extent(turned) == f"from {first:.12g} to {first:.12g}, between {low:.12g} and {high:.12g}"


def test_lines_that_coincide_are_drawn_once(followed):
    """Two dashed lines on one another look solid, which means stable."""
    branch = followed[1]
    ax = Figure().subplots()

    def lines():
        return [one for one in ax.lines if one.get_gid() == "branch" and np.size(one.get_xdata())]

    plot.branch(branch, "speed", ax)
    first = lines()
    dashed = [one for one in first if one.get_linestyle() == "--"]
    assert dashed and any(one.get_linestyle() == "-" for one in first)
    plot.branch(branch, "speed", ax)
    other = replace(branch, segments=tuple(replace(one, label="P101") for one in branch.segments))
    plot.branch(other, "speed", ax)  # a mirror image has other labels
    assert lines() == first
    text = ", ".join(dict.fromkeys(one.label for one in branch.segments))
    assert f"P101, on {text}" in [one.get_label() for one in ax.lines]
    x, y = dashed[0].get_data()
    width = dashed[0].get_linewidth()
    assert (
        find_covering_line(ax, x[::-1][::3], y[::-1][::3], width) is dashed[0]
    )  # at other points, the other way round
    assert find_covering_line(ax, x, y + 0.01 * np.ptp(y), width) is None
    assert find_covering_line(ax, x, y, 2.0 * width) is None


def test_without_an_impact_the_largest_speed_is_zero(followed):
    sides, speeds = (
        np.array([[0, 0], [1, -1], [-2, 0], [2, 1]]),
        np.array([[np.nan] * 2, [0.3, 0.7], [0.9, 0.0], [0, 1.5]]),
    )
    assert impact_loads.largest_speed(sides, speeds).tolist() == [0.0, 0.7, 0.0, 1.5]
    frame = followed[1].to_frame()
    free = frame["label"] == "P100"
    assert free.any() and (frame["largest_speed"][free] == 0).all() and (frame["largest_speed"][~free] >= 0).all()
    assert np.isfinite(followed[1].curves("speed").pieces[0].columns).all()


def test_datasets_and_pictures_in_physical_units(followed):
    branch = followed[0]
    data, found = branch.data, to_physical(branch.data)
    assert found["amplitude"].attrs["units"] == "N" and found["v"].attrs["units"] == "m/s"
    np.testing.assert_allclose(found["amplitude"], 15.0 * data["amplitude"], rtol=1e-15)
    np.testing.assert_allclose(found["time"], data["time"] / np.sqrt(3e4 / 0.5), rtol=1e-15)
    with pytest.raises(jv.ArgumentError, match="data: must be a Dataset of a scene with scales"):
        to_physical(followed[1].data)
    ax = plot.branch(branch, "speed", Figure().subplots(), units="physical", labels="auto")
    assert ax.get_xlabel() == "drive amplitude $F$ (N)" and ax.get_ylabel() == "largest impact speed (m/s)"
    assert "LP: saddle-node" in ax.get_legend_handles_labels()[1]
    drawn = [line.get_xdata() for line in ax.lines if line.get_gid() == "branch" and len(line.get_xdata())]
    assert max(across.max() for across in drawn) == pytest.approx(90.0)
    swept = to_physical(jv.sweep(rig(), "frequency", [2.0, 2.1], jv.State(0.0, 0.0), settle=3, keep=2))
    np.testing.assert_allclose(swept["frequency"], np.array([2.0, 2.1]) * np.sqrt(3e4 / 0.5) / (2 * np.pi))
    assert swept["frequency"].attrs["units"] == "Hz" and swept["x"].attrs["units"] == "mm"


@pytest.mark.parametrize("seed", range(5))
def test_a_rig_in_si_is_as_scipy_has_it(seed):
    """M X'' + C X' + K X = F cos(Omega T) between walls, in SI throughout, by events that end each flight."""
    rng = np.random.default_rng(seed)
    mass, stiffness, ratio = 10.0 ** rng.uniform(-2, 2), 10.0 ** rng.uniform(3, 6), rng.uniform(0.01, 1.2)
    natural, gap = np.sqrt(stiffness / mass), 10.0 ** rng.uniform(-4, -2)
    hertz, rebound = natural * rng.uniform(1.5, 3.0) / (2 * np.pi), rng.uniform(0.5, 0.9)
    force = stiffness * gap * rng.uniform(2.0, 8.0)
    walls = (-gap * rng.uniform(0.5, 2.0), gap)
    scene = jv.scene_from_physical(
        mass, None, stiffness, force, None, rebound, walls, damping_ratio=ratio, frequency_hz=hertz
    )
    damping, omega = 2 * ratio * np.sqrt(mass * stiffness), 2 * np.pi * hertz
    X, V, T, end = 0.2 * gap, 0.3 * gap * natural, 0.0, 3.0 / hertz
    met = [lambda t, y: y[0] - walls[0], lambda t, y: y[0] - walls[1]]
    for way, event in zip((-1, 1), met, strict=True):
        event.terminal, event.direction = True, way
    speeds, times = [], []
    while end > T:
        run = solve_ivp(
            lambda t, y: [y[1], (force * np.cos(omega * t) - damping * y[1] - stiffness * y[0]) / mass],
            (T, end),
            [X, V],
            method="DOP853",
            rtol=1e-11,
            atol=[1e-12 * gap, 1e-12 * gap * natural],
            events=met,
        )
        assert len(speeds) < 40  # no chatter: its hops would have no end here
        T, (X, V) = run.t[-1], run.y[:, -1]
        if run.status == 1:
            speeds, times, V = [*speeds, abs(V)], [*times, T], -rebound * V
    trace = to_physical(jv.simulate(scene, jv.State(0.2, 0.3), 3, 200))
    np.testing.assert_allclose(trace["speed"], speeds, rtol=1e-8, atol=1e-9 * gap * natural)
    np.testing.assert_allclose(trace["impact_time"], times, rtol=1e-9)
    assert float(trace["x"][-1]) == pytest.approx(1e3 * X, abs=1e-8 * 1e3 * gap)
    assert float(trace["v"][-1]) == pytest.approx(V, abs=1e-8 * gap * natural)
    assert float(trace["time"][-1]) == pytest.approx(end, rel=1e-14)


def test_a_run_writes_tables_for_spreadsheets(tmp_path):
    jv.save_scene(rig(frequency_hz=81.88), tmp_path / "rig.toml")
    asked = """
[sweep]
parameter = "amplitude"
count = 3
settle = 5
keep = 2
legs = [{name = "up", from = 0.5, to = 1.0, start = {x = 0.0, v = 0.0}}]

[branch]
parameter = "amplitude"
bounds = [0.5, 4.0]
at = {amplitude = 1.0}
"""
    with (tmp_path / "rig.toml").open("a") as file:
        file.write(asked)
    done = jv.run(tmp_path / "rig.toml", tmp_path / "out", csv=True, units="physical")
    swept, branches = (pd.read_csv(tmp_path / "out" / f"rig.{what}.csv") for what in ("sweep", "branches"))
    assert list(swept.columns[:6]) == ["leg", "amplitude (N)", "period", "x (mm)", "v (m/s)", "status"]
    borne = ["largest_speed (m/s)", "largest_force (N)", "work_rate (W)"]
    assert list(swept.columns[6:]) == [f"{side} {what}" for side in ("left", "right") for what in borne]
    here = rig(frequency_hz=81.88).replace(amplitude=swept["amplitude (N)"].values / 15.0)
    states = jv.State(swept["x (mm)"].values / 0.5, swept["v (m/s)"].values / (0.5e-3 * np.sqrt(6e4)))
    hits = jv.strobe(here, states, slots=8)[1]
    speeds = np.where(hits.side == 1, hits.speed, 0.0).max(axis=1) * 0.5e-3 * np.sqrt(6e4)
    np.testing.assert_allclose(swept["right largest_speed (m/s)"].fillna(0.0), speeds, rtol=1e-9)
    np.testing.assert_allclose(swept["amplitude (N)"], np.repeat([7.5, 11.25, 15.0], 2), rtol=1e-14)
    with xr.open_dataset(tmp_path / "out" / "rig.nc") as data:
        np.testing.assert_allclose(swept["x (mm)"], 0.5 * data["x"].values.ravel(), rtol=1e-14)
    assert branches["amplitude (N)"].max() == 60.0 and {"stable", "saddle"} <= set(branches["stability"])
    assert re.search(r"^SN +7\.6\d+ +P111 ", done.table, re.M) and re.search(r"^amplitude +30 +N$", done.table, re.M)
    assert done.summary["files"]["sweep table"].endswith("rig.sweep.csv")
    with pytest.raises(FileExistsError):
        jv.run(tmp_path / "rig.toml", tmp_path / "out", csv=True)
