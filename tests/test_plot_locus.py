"""Pictures of loci: their lines, their points of codimension two, the regions between them."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.loci.locus import MEANINGS, Locus
from jaxvibro.loci.locus_start import KINDS
from jaxvibro.plot import style

PAIR = ("amplitude", "frequency")


class Curve(Locus):
    """A locus, as far as a picture looks at it."""

    values = label = None  # no longer worked out

    def __init__(self, kind, label, values, special=(), names=PAIR):
        values = np.array(values, float)
        ends = [(0, "EP"), (len(values) - 1, "EP")]
        special = [
            SimpleNamespace(kind=each, place=place, values=dict(zip(names, values[place], strict=True)))
            for place, each in (*special, *ends)
        ]
        self.__dict__.update(kind=kind, label=label, names=names, values=values, special=special)

    def __len__(self):
        return len(self.values)

    def points(self, kind):
        return tuple(one for one in self.special if one.kind == kind)


def kept(artists, what):
    return [one for one in artists if (one.get_gid() or "").startswith(what)]


def test_a_locus_is_its_points_in_the_plane_of_its_parameters():
    one = Curve("SN", "P111", [(0.5, 1.2), (1.0, 2.0), (0.75, 3.0)])
    ax = Figure().subplots()
    assert jv.plot.locus(one, ax) is ax and plt.get_fignums() == []
    (line,) = ax.lines
    np.testing.assert_array_equal(line.get_xydata(), one.values)
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(style.parameter_label(name) for name in PAIR)
    assert line.get_label() == "SN of P111"
    new = jv.plot.locus(one, colour="red")
    assert new.lines[0].get_color() == "red" and len(plt.get_fignums()) == 1
    plt.close(new.figure)


def test_kinds_differ_in_colour_in_grey_and_in_style_and_loci_of_a_kind_in_width():
    ax = Figure().subplots()
    for kind in KINDS:
        for label in ("P111", "P112", "P111"):
            jv.plot.locus(Curve(kind, label, [(0, 1), (1, 2)]), ax)
    lines = np.reshape(ax.lines, (4, 3))
    assert (
        len({line.get_color() for line in lines[:, 0]}) == len({repr(line._dash_pattern) for line in lines[:, 0]}) == 4
    )
    assert {line.get_color() for line in lines[:, 0]} < set(style.COLOURS)
    for first, second, again in lines:
        assert first.get_color() == second.get_color() == again.get_color()
        assert first.get_linewidth() > 1.3 * second.get_linewidth() and again.get_linewidth() == first.get_linewidth()
    told = ax.get_legend_handles_labels()[1]
    assert told == [f"{kind} of {label}" for kind in ("SN", "PD", "SB", "GR") for label in ("P111", "P112")]


def test_the_same_motion_in_another_colour_is_told_again():
    ax = Figure().subplots()
    for colour in ("red", "blue", "blue"):
        jv.plot.locus(Curve("SN", "P111", [(0, 1), (1, 2)]), ax, colour)
    assert [line.get_color() for line in ax.get_legend_handles_labels()[0]] == ["red", "blue"]


def test_each_kind_of_codimension_two_has_a_marker_and_a_meaning():
    kinds = [*(kind for kind in MEANINGS if kind != "EP"), "SN", "PD", "SB"]
    ax = Figure().subplots()
    values = [(k, k * k) for k in range(len(kinds) + 2)]
    jv.plot.locus(Curve("GR", "P112", values, [(k, kind) for k, kind in enumerate(kinds, 1)]), ax)
    marks = kept(ax.lines, "codimension two")
    assert [line.get_xydata().tolist() for line in marks] == [[[k, k * k]] for k in range(1, len(kinds) + 1)]
    assert len({line.get_marker() for line in marks}) == len(kinds)
    told = ax.get_legend_handles_labels()[1]
    assert told[1:3] == ["CP: cusp", "GPD: generalized period doubling"] and told[-1] == "SB: end of a locus of SB"
    jv.plot.locus(Curve("SN", "P112", values, [(1, "CP"), (3, "CP")]), ax)
    (both,) = kept(ax.lines, "codimension two")[len(kinds) :]
    assert both.get_xydata().tolist() == [[1, 1], [3, 9]] and both.get_marker() == marks[0].get_marker()
    assert ax.get_legend_handles_labels()[1] == [*told, "SN of P112"]


def test_axes_hold_one_plane():
    ax = jv.plot.locus(Curve("SN", "P111", [(0, 1), (1, 2)]), Figure().subplots())
    for names in (PAIR[::-1], ("amplitude", "damping")):
        other = Curve("GR", "P111", [(0, 1), (1, 2)], names=names)
        with pytest.raises(
            jv.ArgumentError, match=r"^one\.names: must have .* \(amplitude, frequency, in this order\); got"
        ):
            jv.plot.locus(other, ax)
        with pytest.raises(jv.ArgumentError, match="in this order"):
            jv.plot.region(other, other, "both", ax)
    assert len(ax.lines) == 1 and ax.get_xlabel() == style.parameter_label("amplitude")
    jv.plot.locus(
        Curve("GR", "P111", [(0, 1), (1, 2)], names=("left.position", "right.motion.phase")), Figure().subplots()
    )


def corners(ax):
    return [patch.get_xy()[:-1] for patch in kept(ax.patches, "region")]


def area(outline):
    x, y = outline.T
    return 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))


def test_a_region_lies_between_two_loci_wherever_a_level_line_meets_both():
    first = Curve("SN", "P111", [(0.0, 0.0), (1.0, 4.0)])
    second = Curve("GR", "P111", [(4.0, 3.0), (4.0, 1.0), (2.0, -1.0)])
    ax = Figure().subplots()
    assert jv.plot.region(first, second, "two $ motions", ax) is ax
    (outline,) = corners(ax)
    wanted = [(0.0, 0.0), (0.25, 1.0), (0.75, 3.0), (4.0, 3.0), (4.0, 1.0), (3.0, 0.0)]
    met = outline[np.sort(np.unique(outline, axis=0, return_index=True)[1])]
    np.testing.assert_allclose(met, wanted, atol=1e-15)
    (told,) = ax.texts
    assert told.get_text() == ax.get_legend_handles_labels()[1][0] == r"two \$ motions"
    assert kept(ax.patches, "region")[0].contains_point(ax.transData.transform(told.get_position()))
    swapped = jv.plot.region(second, first, "same", Figure().subplots())
    np.testing.assert_allclose(area(corners(swapped)[0]), area(outline))


def test_a_region_of_loci_that_fold_or_cross():
    turning = Curve("SN", "P111", [(1.0, 0.0), (2.0, 1.0), (3.0, 0.0)])
    straight = Curve("GR", "P111", [(0.0, 0.0), (0.0, 2.0)])
    (outline,) = corners(jv.plot.region(turning, straight, "left of the near side", Figure().subplots()))
    np.testing.assert_allclose(area(outline), 1.5)
    inside = Curve("GR", "P111", [(2.0, 0.0), (2.0, 1.0)])
    both = corners(jv.plot.region(turning, inside, "on both sides", Figure().subplots()))
    np.testing.assert_allclose([area(one) for one in both], [0.5, 0.5])
    slanted = Curve("GR", "P111", [(-1.0, 0.0), (0.0, 1.0), (1.0, 2.0)])
    (crossed,) = corners(jv.plot.region(straight, slanted, "beside a crossing", Figure().subplots()))
    assert crossed[:, 0].min() == -1.0 and crossed[:, 0].max() == 1.0
    beyond = Curve("GR", "P111", [(0.0, 5.0), (0.0, 6.0)])
    with pytest.raises(jv.ArgumentError, match=r"^second: must share values of frequency with the first"):
        jv.plot.region(straight, beyond, "none", Figure().subplots())
    with pytest.raises(jv.ArgumentError, match=r"^second: must be a locus in amplitude and frequency"):
        jv.plot.region(straight, Curve("GR", "P111", [(0, 1), (1, 2)], names=PAIR[::-1]), "none", Figure().subplots())


def test_regions_are_told_apart_without_colour():
    ax, one = Figure().subplots(), Curve("SN", "P111", [(0, 0), (0, 1)])
    for k in (1, 2, 3):
        jv.plot.region(one, Curve("GR", "P111", [(k, 0), (k, 1)]), f"region {k}", ax)
    patches = kept(ax.patches, "region")
    assert len({patch.get_hatch() for patch in patches}) == 3
    assert all(len(set(to_rgb(patch.get_facecolor()))) == 1 and patch.get_alpha() < 0.5 for patch in patches)
    assert all(patch.get_zorder() < 2 for patch in patches)


def test_loci_of_a_scene_are_drawn(tmp_path):
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 3.6))
    bounds = {"amplitude": (0.0, 5.0), "frequency": (2.0, 2.3)}
    fold, grazing = (jv.locus(branch.points(kind)[0], PAIR, bounds) for kind in ("SN", "GR"))
    figure = Figure()
    ax = figure.subplots()
    for one in (fold, grazing):
        jv.plot.locus(one, ax)
    jv.plot.region(fold, grazing, "P100 and P111", ax).legend()
    figure.savefig(tmp_path / "loci.png")
    (outline,) = corners(ax)
    lines = kept(ax.lines, "locus")
    drawn = np.concatenate([line.get_xydata() for line in lines])
    for one in (fold, grazing):  # the line goes through every point
        apart = np.abs(drawn[:, None] - one.values[None]).max(axis=2).min(axis=0)
        assert apart.max() < 1e-12
    assert outline[:, 1].min() == 2.0 and outline[:, 1].max() == 2.3
    inside = [
        any(patch.contains_point(ax.transData.transform(at)) for patch in ax.patches) for at in ((2, 2.1), (4, 2.1))
    ]
    assert inside == [True, False]
