"""Pictures: Axes in, Axes out, nothing shown; told apart by the colour-blind and in grey; symbols and units."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.attractors import Attractor
from jaxvibro.plot import path, style

SCENE = jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, 0.5, jv.Motion(0.3, 0.5, 2))))


def swept(legs=2, count=7, kept=3):
    """A Dataset like that of `sweep`, of numbers without meaning."""
    values = np.linspace(0.0, 6.0, count)
    x = np.sin(np.arange(count * legs * kept)).reshape(count, legs, kept)
    across = np.stack([values, values[::-1]], -1)[:, :legs]
    coords = {"amplitude": (("step", "leg"), across), "leg": ["down $x", "up"][:legs]}
    attrs = {"swept": "amplitude", "left.position": -1.1, "right.position": 1.0, "right.motion.amplitude": 0.1}
    dims = ("step", "leg", "period")
    return xr.Dataset({"x": (dims, x), "v": (dims, 2 * x)}, coords, attrs)


def attractor(label, mirror, x):
    points = np.array([[x, -x]])
    return Attractor(label, "periodic", 0.4, jv.State(x, -x), 1, ("LR",), points, 1.0, -0.1, mirror, "")


def numbers(line):
    return tuple(np.asarray(part) for part in line.get_data())


def test_a_diagram_takes_axes_and_shows_nothing():
    ax = Figure().subplots()
    assert plot.diagram(swept(), "x", ax) is ax
    assert plt.get_fignums() == []
    new = plot.diagram(swept(), "v")
    assert len(plt.get_fignums()) == 1
    plt.close(new.figure)


@pytest.mark.parametrize("variable", ["x", "v"])
def test_a_diagram_holds_every_state_of_every_leg(variable):
    data = swept()
    ax = plot.diagram(data, variable, Figure().subplots())
    dots = [line for line in ax.lines if line.get_rasterized()]
    for line, leg in zip(dots, data["leg"].values, strict=True):
        across, up = numbers(line)
        one = data.sel(leg=leg)
        np.testing.assert_array_equal(up, one[variable].values.ravel())
        np.testing.assert_array_equal(across, np.repeat(one["amplitude"].values, 3))
    assert len({line.get_color() for line in dots}) == len({line.get_markersize() for line in dots}) == 2
    assert ("A = F" in ax.get_xlabel()) and ("/" in ax.get_ylabel())


def test_only_walls_that_stand_still_are_lines_in_a_diagram():
    def walls(variable):
        return [
            line
            for line in plot.diagram(swept(), variable, Figure().subplots()).lines
            if line.get_color() == style.WALL
        ]

    assert [line.get_ydata()[0] for line in walls("x")] == [-1.1]
    assert walls("v") == []


def test_a_plain_sweep_and_names_with_signs_are_drawn(tmp_path):
    values = np.linspace(0.0, 6.0, 4)
    data = jv.sweep(jv.make_scene(1.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), "amplitude", values, jv.State(0.0, 0.0), 3, 2)
    figure = Figure()
    left, right = figure.subplots(1, 2)
    plot.diagram(data, "x", left)
    plot.diagram(swept(), "x", right).legend()
    figure.savefig(tmp_path / "both.png")
    assert left.get_legend_handles_labels()[1] == ["from 0 to 6"]
    assert right.get_legend_handles_labels()[1] == [r"down \$x: from 0 to 6", "up: from 6 to 0"]


def test_attractors_are_marked_where_they_are_and_twins_share_a_shape():
    found = [attractor("P111", 1, 0.2), attractor("P111", 0, -0.3), attractor("P101", None, 0.5)]
    ax = plot.mark(found, 4.65, "v", Figure().subplots())
    marks = ax.lines[1:]
    assert [line.get_xydata().tolist() for line in marks] == [[[4.65, -0.2]], [[4.65, 0.3]], [[4.65, -0.5]]]
    one, twin, other = ((line.get_marker(), line.get_markerfacecolor()) for line in marks)
    assert one[0] == twin[0] != other[0] and one[1] != twin[1]
    assert ax.get_legend_handles_labels()[1][0] == "P111, 40.0 % of starts"


def test_neighbouring_colours_differ_in_grey():
    grey = [np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722)) for colour in style.COLOURS]
    assert np.min(abs(np.diff(grey))) > 0.14


def test_a_path_breaks_at_impacts_and_obeys_the_impact_law():
    trajectory = jv.simulate(SCENE, jv.State(0.0, 0.0), 6, 300)
    time, x, v, places = path.with_impacts(trajectory, SCENE)
    assert len(places) == trajectory.sizes["impact"] > 5
    assert np.isnan(x[places + 1]).all() and np.all(np.diff(time) >= 0)
    for at, gap in ((places, -1), (places + 2, 1)):
        step = time[at + gap] - time[at]
        assert abs(x[at + gap] - x[at] - v[at] * step).max() < 20 * abs(step).max() ** 2
        assert abs(v[at + gap] - v[at]).max() < 20 * abs(step).max()


def test_a_wall_in_a_picture_is_where_and_as_fast_as_it_is():
    phase, wall, small = np.linspace(0.0, 7.0, 50), SCENE.right, 1e-6
    np.testing.assert_allclose(path.position(wall, phase), 1.0 + 0.3 * np.cos(2 * phase + 0.5))
    rate = (path.position(wall, phase + 2.1 * small) - path.position(wall, phase - 2.1 * small)) / (2 * small)
    np.testing.assert_allclose(path.velocity(wall, 2.1, phase), rate, atol=1e-8)
    assert (path.position(SCENE.left, phase) == -1.0).all()


@pytest.mark.parametrize("draw", [plot.portrait, plot.trace])
def test_a_trajectory_is_drawn_whole(draw):
    trajectory = jv.simulate(SCENE, jv.State(0.0, 0.0), 6, 300)
    ax = Figure().subplots()
    assert draw(trajectory, SCENE, ax) is ax
    drawn = np.concatenate([numbers(line)[1] for line in ax.lines])
    wanted = trajectory["v" if draw is plot.portrait else "x"].values
    assert np.isin(wanted, drawn).all()
    assert "/" in ax.get_xlabel() and "/" in ax.get_ylabel()


@pytest.mark.parametrize("name", [*SCENE.names, "left.motion.amplitude"])
def test_every_parameter_has_a_label(name):
    assert "$" in style.label(name) or "rad" in style.label(name)
