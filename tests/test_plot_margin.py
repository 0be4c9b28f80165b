"""Pictures of margins: what is drawn are the numbers."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.design.margin import BEHIND, REACHED, NearPoint


def near(free):
    """A margin of made-up points: drawing asks for no more."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    orbit = jv.find_orbit(scene, jv.State(0.9, -1.1))
    points = []
    for k, (kind, status) in enumerate((("SB", REACHED), ("SN", BEHIND))):
        change = {name: (0.5 + k) * unit * (-1) ** j for j, (name, unit) in enumerate(free.items())}
        there = scene.replace(**{name: float(scene.parameter(name)) + by for name, by in change.items()})
        blank, distance = np.zeros(0), (0.5 + k) * len(free) ** 0.5
        points.append(NearPoint(kind, distance, change, change, there, blank, blank, (), 0.0, 0.0, status, ()))
    return jv.Margin(orbit, free, tuple(points), (), (4.0, 8))


def test_two_numbers_are_a_plane():
    one = near({"amplitude": 0.2, "frequency": 0.05})
    ax = jv.plot.margin(one)
    marked = {line.get_label(): np.ravel(line.get_data()) for line in ax.lines if not line.get_label().startswith("_")}
    assert marked["P111"] == pytest.approx([2.0, 2.1])
    assert marked["SB: symmetry breaking"] == pytest.approx([2.1, 2.075])
    assert marked["SN: saddle-node, behind another"] == pytest.approx([2.3, 2.025])
    (ring,) = ax.patches
    assert (ring.width, ring.height) == pytest.approx((2 * 0.2 * one.distance, 2 * 0.05 * one.distance))
    ways = [line.get_linestyle() for line in ax.lines if line.get_label().startswith("_")]
    assert ways == ["-", ":"]
    assert "amplitude" in ax.get_xlabel() and "frequency" in ax.get_ylabel()
    plt.close(ax.figure)


@pytest.mark.parametrize("free", [{"damping": 0.01}, {"amplitude": 0.2, "damping": 0.01, "right.position": 0.02}])
def test_other_counts_are_changes_in_units(free):
    one = near(free)
    fig, ax = plt.subplots()
    assert jv.plot.margin(one, ax) is ax
    lines = [line for line in ax.lines if not line.get_label().startswith("_")]
    for line, (name, unit) in zip(lines, free.items(), strict=True):
        assert line.get_ydata() == pytest.approx([each.change[name] / unit for each in one.points])
        assert line.get_label() == f"{name}, unit {unit:g}"
    assert [tick.get_text().split(":")[0] for tick in ax.get_xticklabels()] == ["SB", "SN"]
    plt.close(fig)


def test_a_margin_without_points_and_what_is_none():
    ax = jv.plot.margin(replace(near({"amplitude": 0.2, "frequency": 0.05}), points=()))
    assert not ax.patches
    plt.close(ax.figure)
    with pytest.raises(jv.ArgumentError, match=r"^plot.margin: must be given a Margin"):
        jv.plot.margin("near")
