"""Pictures of motions, orbits and branches: drawn into given Axes, distinct in grey, with symbols and units."""

from dataclasses import replace
from functools import cache

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.plot.smooth_line import SUBDIVISIONS, smooth_line
from jaxvibro.plot.style import COLOURS, WALL_COLOUR, parameter_label
from tests.scene_files import refusal

SCENE = jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, 0.5, motion=jv.Motion(0.3, 0.5, 2))))


def swept(legs=2, count=7, kept=3):
    """A Dataset like that of `sweep`, of numbers without meaning."""
    values = np.linspace(0.0, 6.0, count)
    x = np.sin(np.arange(count * legs * kept)).reshape(count, legs, kept)
    across = np.stack([values, values[::-1]], -1)[:, :legs]
    coords = {"amplitude": (("step", "leg"), across), "leg": ["down $x", "up"][:legs]}
    attrs = {"swept": "amplitude", "left.position": -1.1, "right.position": 1.0, "right.motion.amplitude": 0.1}
    dims = ("step", "leg", "period")
    return xr.Dataset({"x": (dims, x), "v": (dims, 2 * x)}, coords, attrs)


def numbers(line):
    return tuple(np.asarray(part) for part in line.get_data())


@pytest.mark.parametrize(("variable", "walls"), [("x", [-1.1]), ("v", [])])
def test_a_diagram_holds_every_state_of_every_leg_and_walls_at_rest(variable, walls):
    data, ax = swept(), Figure().subplots()
    assert jv.plot.diagram(data, variable, ax) is ax and plt.get_fignums() == []
    dots = [line for line in ax.lines if line.get_rasterized()]
    for line, leg in zip(dots, data["leg"].values, strict=True):
        across, up = numbers(line)
        one = data.sel(leg=leg)
        np.testing.assert_array_equal(up, one[variable].values.ravel())
        np.testing.assert_array_equal(across, np.repeat(one["amplitude"].values, 3))
    assert len({line.get_color() for line in dots}) == len({line.get_markersize() for line in dots}) == 2
    assert "A = F" in ax.get_xlabel() and "/" in ax.get_ylabel()
    assert [line.get_ydata()[0] for line in ax.lines if line.get_color() == WALL_COLOUR] == walls


def test_a_plain_sweep_and_names_with_signs_are_drawn(tmp_path):
    values = np.linspace(0.0, 6.0, 4)
    data = jv.sweep(jv.make_scene(1.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), "amplitude", values, jv.State(0.0, 0.0), 3, 2)
    figure = Figure()
    left, right = figure.subplots(1, 2)
    jv.plot.diagram(data, "x", left)
    jv.plot.diagram(swept(), "x", right).legend()
    figure.savefig(tmp_path / "both.png")
    assert left.get_legend_handles_labels()[1] == ["from 0 to 6"]
    assert right.get_legend_handles_labels()[1] == [r"down \$x: from 0 to 6", "up: from 6 to 0"]


def test_an_orbit_with_another_phase_is_marked_at_phase_0():
    one = jv.find_orbit(jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1))
    later = jv.simulate(one.scene, one.state, 1, 400).isel(time=120)
    state = jv.State(float(later["x"]), float(later["v"]), float(later["phase"]))
    ax = jv.plot.mark_orbits([replace(one, state=state)], 4.65, "v", Figure().subplots())
    np.testing.assert_allclose(ax.lines[-1].get_ydata(), [one.state.v], atol=1e-9)


def test_mirror_images_are_one_entry_and_a_symmetric_orbit_has_none():
    one = jv.find_orbit(jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.9, -1.1))
    ax = jv.plot.mark_orbits(
        [replace(one, mirror_of=place) for place in (0, 2, 1, None)], 3.0, "x", Figure().subplots()
    )
    assert ax.get_legend_handles_labels()[1] == ["P111, stable", "P111 and mirror image, stable", "P111, stable"]
    assert len({line.get_marker() for line in ax.lines[1:]}) == 3


PERIOD = 2 * np.pi / 2.1


@cache
def followed():
    """A branch of which the tests use all but the numbers."""
    scene = jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (2.9, 3.1))


def branch(periods=1, change=7):
    """A branch of nine points, of numbers without meaning but for these: it turns unstable at the fourth; its impact on
    the right crosses phase 0, to earlier times, 0.4 of the way from the fifth to the sixth; x jumps at a change of
    itinerary."""
    k = np.arange(9.0)
    late = np.stack([PERIOD * (4.4 - k) / 20, 1.3 + 0 * k], -1)
    roots = np.where(k < 3, 0.5, np.where(k > 3, 1.5, 1.0 + 1e-13))
    x = (0.1 * k + (k >= change))[:, None] + np.arange(periods)
    column = {
        "amplitude": 1 + 0.5 * k,
        "multiplier_real": (("point", "multiplier"), np.stack([roots, 0 * k], -1)),
        "multiplier_imag": (("point", "multiplier"), np.zeros((9, 2))),
        "stable": (roots < 1).astype(np.int8),
        "segment": (k >= change).astype(int),
        "value_slope": 0 * k,
        "residual": 0 * k,
        "least_speed": 2 + 0.1 * k,
        "least_clearance": np.where(k < 2, np.inf, 0.3),
    }
    impacts = {"time": late, "speed": 2 + 0.1 * np.stack([k, k], -1), "side": np.tile(np.int8([1, -1]), (9, 1))}
    impacts |= {"time_slope": 0 * late, "speed_slope": 0 * late}
    data = {key: value if isinstance(value, tuple) else ("point", value) for key, value in column.items()}
    data |= {key: (("point", "impact"), value) for key, value in impacts.items()}
    data |= {"x": (("point", "period"), x), "v": (("point", "period"), -x)}
    data = xr.Dataset(data, attrs={"parameter": "amplitude"})
    one, (first, *_) = followed(), followed().segments
    segments = (
        replace(first, first=0, last=change - 1, label="P111"),
        replace(first, first=change, last=8, label="P112"),
    )
    kinds = {"EP": 0, "SN": 3, "PD": 6, "fast": 8}
    special = tuple(
        replace(one.special[0], kind=kind, place=place, value=float(data["amplitude"][place]))
        for kind, place in kinds.items()
    )
    return replace(one, bounds=(0.0, 9.0), data=data, segments=segments, special=special)


def kept(ax, kind):
    """What is drawn of a kind, without what stands in a legend alone."""
    return [line for line in ax.lines if line.get_gid() == kind and len(line.get_xdata())]


def test_stable_parts_of_a_branch_are_solid_and_unstable_ones_dashed():
    one = branch(change=9)
    ax = jv.plot.branch(one, "speed", Figure().subplots())
    solid, dashed = kept(ax, "branch")
    points = np.stack([one.values, one.data["least_speed"]], -1)  # of all its impacts
    np.testing.assert_allclose(solid.get_xydata()[::SUBDIVISIONS], points[:4], rtol=1e-14)
    np.testing.assert_allclose(dashed.get_xydata()[::SUBDIVISIONS], points[3:], rtol=1e-14)
    assert (solid.get_linestyle(), dashed.get_linestyle()) == ("-", "--")
    solid, dashed = kept(jv.plot.branch(one, "clearance", Figure().subplots(), "red"), "branch")
    assert np.isnan(numbers(solid)[1]).tolist() == [True, True, False, False] and solid.get_color() == "red"


def test_a_line_breaks_where_an_impact_crosses_phase_0_and_where_an_itinerary_changes_with_a_jump():
    """At phase 0 the mass is on the wall at 1; before the crossing the state is the one ahead of the impact."""
    x, v = (branch().curves(variable).pieces[1] for variable in "xv")
    across = [2.5, 3.0, *3 * [3.2], 3.5, 4.0, 4.0, 4.0, 4.5, 4.5, 5.0]
    np.testing.assert_allclose(x.values, across)
    np.testing.assert_allclose(x.columns[:, 0], [0.3, 0.4, 1.0, np.nan, 1.0, 0.5, 0.6, 0.6, np.nan, 1.7, 1.7, 1.8])
    fast, slow = 2.44, -0.7 * 2.44
    np.testing.assert_allclose(
        v.columns[:, 0], [-0.3, -0.4, fast, np.nan, slow, -0.5, -0.6, -0.6, np.nan, -1.7, -1.7, -1.8]
    )
    ax = jv.plot.branch(branch(change=9), "x", Figure().subplots())
    assert np.isnan(numbers(kept(ax, "branch")[1])[1]).sum() == 1
    first, second = kept(jv.plot.branch(branch(periods=2, change=9), "v", Figure().subplots()), "branch")[2:]
    assert np.isnan(numbers(first)[1]).sum() == 1 and not np.isnan(numbers(second)[1]).any()


def test_a_line_is_bent_between_its_points_and_swings_beyond_none():
    way = np.linspace(0.0, 3.0, 12)
    across, up = np.cos(way), np.sin(way)
    fine = np.array(smooth_line(across, up))
    np.testing.assert_allclose(fine[:, ::SUBDIVISIONS], [across, up], atol=1e-15)
    assert abs(np.hypot(*fine) - 1.0).max() < 0.2 * (1.0 - np.cos(0.5 * way[1]))  # a chord's error
    sharp = np.array(smooth_line(np.array([0.0, 1.0, 1.2, 1.2, 1.2]), np.array([0.3, 0.4, 1.0, np.nan, 1.0])))
    assert np.nanmax(sharp[0]) == 1.2 and np.isnan(sharp[1]).sum() == 1
    many = np.linspace(0.0, 1.0, 1000)
    assert smooth_line(many, many)[0] is many
    turn = np.linspace(0.0, 1.0, 7)
    line = np.stack([turn, np.sin(turn)])  # with its ends twice
    np.testing.assert_array_equal(smooth_line(*line[:, [0, *range(7), 6]]), smooth_line(*line))
    assert smooth_line(*line).shape == (2, 6 * SUBDIVISIONS + 1)


def test_curves_are_arrays_ready_to_plot():
    one = branch(change=9).curves("clearance")
    assert [piece.stable for piece in one.pieces] == [True, False]
    assert list(one.points) == ["SN", "PD", "fast"]
    np.testing.assert_allclose(one.points["PD"].values, [4.0])
    np.testing.assert_allclose(one.points["PD"].columns, [[0.3]])
    backward = branch(change=9)
    backward = replace(backward, data=backward.data.isel(point=slice(None, None, -1)), special=())
    pieces = backward.curves("speed").pieces
    assert [(piece.stable, len(piece.values)) for piece in pieces] == [(False, 6), (True, 4)]
    expected = "variable: must be one of x, v, clearance, speed, least_speed, peak"
    assert refusal(branch().curves, "clearence").startswith(expected)


def test_special_points_are_marked_and_named_along_the_top():
    one = branch()
    for limit, expected in ((9.0, ["SN 2.500", "PD 4.000", "fast 5.000"]), (200.0, ["SN 2.5\nPD 4.0\nfast 5.0"])):
        ax = jv.plot.branch(one, "v", Figure().subplots())
        marks = [line.get_xydata()[0] for line in kept(ax, "special")]
        np.testing.assert_allclose(marks, [[2.5, -0.3], [4.0, -0.6], [5.0, -1.8]])
        ax.set_xlim(0.0, limit)
        (top,) = jv.plot.mark_points([one, one], ax).child_axes
        assert [tick.get_text() for tick in top.get_xticklabels()] == expected


@pytest.fixture(scope="module")
def motion():
    """A motion with impacts on both walls, and the path that is drawn of it: time, x, v."""
    trajectory = jv.simulate(SCENE, jv.State(0.0, 0.0), 6, 300)
    drawn = [draw(trajectory, SCENE, Figure().subplots()) for draw in (jv.plot.trace, jv.plot.portrait)]
    times, places = (next(line for line in ax.lines if line.get_color() == COLOURS[0]) for ax in drawn)
    return trajectory, drawn, (PERIOD * numbers(times)[0], *numbers(places))


def test_a_path_breaks_at_impacts_and_obeys_the_impact_law(motion):
    trajectory, _, (time, x, v) = motion
    places = np.flatnonzero(np.isnan(x)) - 1
    assert len(places) == trajectory.sizes["impact"] > 5
    assert np.all(np.diff(time) >= 0)
    for at, gap in ((places, -1), (places + 2, 1)):
        step = time[at + gap] - time[at]
        assert abs(x[at + gap] - x[at] - v[at] * step).max() < 20 * abs(step).max() ** 2
        assert abs(v[at + gap] - v[at]).max() < 20 * abs(step).max()


def test_a_trajectory_is_drawn_whole_between_its_walls(motion):
    trajectory, drawn, _ = motion
    for ax, name in zip(drawn, "xv", strict=True):
        assert np.isin(trajectory[name].values, np.concatenate([numbers(line)[1] for line in ax.lines])).all()
        assert "/" in ax.get_xlabel() and "/" in ax.get_ylabel()
    left, right = (numbers(line)[1] for line in drawn[0].lines if line.get_color() == WALL_COLOUR)
    np.testing.assert_allclose(right, 1.0 + 0.3 * np.cos(2 * trajectory["phase"] + 0.5))
    assert (left == -1.0).all()


def test_parameters_have_labels_and_neighbouring_colours_differ_in_grey():
    for name in (*SCENE.names, "left.motion.amplitude"):
        assert "$" in parameter_label(name) or "rad" in parameter_label(name)
    grey = [np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)) for colour in COLOURS]
    assert np.min(abs(np.diff(grey))) > 0.14
