"""Pictures of loci: their lines, their points of codimension two, the regions between them."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro.loci.locus import MEANINGS
from tests.scene_files import refusal

PAIR, LINE = ("amplitude", "frequency"), [(0, 1), (1, 2)]
DRAWN_KINDS = "SN", "PD", "SB", "GR"


class Curve(jv.Locus):
    """A locus of invented points."""

    values = label = None

    def __init__(self, kind, values, label="P111", special=(), names=PAIR):
        values = np.array(values, float)
        special = [
            SimpleNamespace(kind=point, place=place, values=dict(zip(names, values[place], strict=True)))
            for place, point in (*special, (0, "EP"), (len(values) - 1, "EP"))
        ]
        vars(self).update(kind=kind, label=label, names=names, values=values, special=special)

    def __len__(self):
        return len(self.values)

    def points(self, kind):
        return tuple(point for point in self.special if point.kind == kind)


def draw(*curves, ax=None, **options):
    """Draw curves into Axes; return these."""
    ax = ax or Figure().subplots()
    for curve in curves:
        assert jv.plot.locus(curve, ax, **options) is ax
    return ax


def of_group(artists, name):
    return [artist for artist in artists if (artist.get_gid() or "").startswith(name)]


def legend(ax):
    return ax.get_legend_handles_labels()[1]


def test_a_locus_is_a_line_in_the_plane_of_its_parameters():
    curve = Curve("SN", [(0.5, 1.2), (1.0, 2.0), (0.75, 3.0)])
    ax = draw(curve)
    (line,) = ax.lines
    np.testing.assert_array_equal(line.get_xydata(), curve.values)
    assert "A = F" in ax.get_xlabel() and "omega" in ax.get_ylabel()
    assert line.get_label() == "SN of P111" and plt.get_fignums() == []
    new = jv.plot.locus(curve, colour="red")
    assert new.lines[0].get_color() == "red" and len(plt.get_fignums()) == 1
    plt.close(new.figure)
    for names in (PAIR[::-1], ("amplitude", "damping")):
        other = Curve("GR", LINE, names=names)
        line = refusal(jv.plot.locus, other, ax)
        assert line.startswith("one.names: must have ") and "(amplitude, frequency, in this order)" in line
        assert "in this order" in refusal(jv.plot.region, other, other, "both", ax)
    assert len(ax.lines) == 1
    draw(Curve("GR", LINE, names=("left.position", "right.motion.phase")))


def test_kinds_differ_in_colour_and_style_and_loci_of_a_kind_in_width():
    ax = draw(*(Curve(kind, LINE, label) for kind in DRAWN_KINDS for label in ("P111", "P112", "P111")))
    lines = np.reshape(ax.lines, (4, 3))
    assert len({line.get_color() for line in lines[:, 0]}) == 4
    assert len({repr(line._dash_pattern) for line in lines[:, 0]}) == 4
    for first, second, again in lines:
        assert first.get_color() == second.get_color() == again.get_color()
        assert first.get_linewidth() > 1.3 * second.get_linewidth() and again.get_linewidth() == first.get_linewidth()
    assert legend(ax) == [f"{kind} of {label}" for kind in DRAWN_KINDS for label in ("P111", "P112")]
    ax = Figure().subplots()
    for colour in ("red", "blue", "blue"):
        draw(Curve("SN", LINE), ax=ax, colour=colour)
    assert [line.get_color() for line in ax.get_legend_handles_labels()[0]] == ["red", "blue"]


def test_each_kind_of_codimension_two_has_a_marker_and_a_meaning():
    kinds = [*(kind for kind in MEANINGS if kind != "EP"), "SN", "PD", "SB"]
    values = [(k, k * k) for k in range(len(kinds) + 2)]
    ax = draw(Curve("GR", values, "P112", list(enumerate(kinds, 1))))
    marks = of_group(ax.lines, "codimension two")
    assert [line.get_xydata().tolist() for line in marks] == [[[k, k * k]] for k in range(1, len(kinds) + 1)]
    assert len({line.get_marker() for line in marks}) == len(kinds)
    texts = legend(ax)
    assert texts[1:3] == ["CP: cusp", "GPD: generalized period doubling"] and texts[-1] == "SB: end of a locus of SB"
    draw(Curve("SN", values, "P112", [(1, "CP"), (3, "CP")]), ax=ax)
    (both,) = of_group(ax.lines, "codimension two")[len(kinds) :]
    assert both.get_xydata().tolist() == [[1, 1], [3, 9]] and both.get_marker() == marks[0].get_marker()
    assert legend(ax) == [*texts, "SN of P112"]


def outlines(first, second, text="both", ax=None):
    """Draw the region between two loci; return the corners of its parts."""
    ax = jv.plot.region(first, second, text, ax or Figure().subplots())
    return [patch.get_xy()[:-1] for patch in of_group(ax.patches, "region")]


def areas(*curves):
    pairs = (outline.T for outline in outlines(*curves))
    return [0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) for x, y in pairs]


def test_a_region_lies_between_two_loci_wherever_a_level_line_meets_both():
    first, second = Curve("SN", [(0.0, 0.0), (1.0, 4.0)]), Curve("GR", [(4.0, 3.0), (4.0, 1.0), (2.0, -1.0)])
    ax = Figure().subplots()
    (outline,) = outlines(first, second, "two $ motions", ax)
    distinct = outline[np.sort(np.unique(outline, axis=0, return_index=True)[1])]
    expected = [(0.0, 0.0), (0.25, 1.0), (0.75, 3.0), (4.0, 3.0), (4.0, 1.0), (3.0, 0.0)]
    np.testing.assert_allclose(distinct, expected, atol=1e-15)
    (text,) = ax.texts
    assert text.get_text() == legend(ax)[0] == r"two \$ motions"
    assert of_group(ax.patches, "region")[0].contains_point(ax.transData.transform(text.get_position()))
    np.testing.assert_allclose(areas(second, first), areas(first, second))


def test_regions_of_loci_that_fold_or_cross():
    turning, straight = Curve("SN", [(1.0, 0.0), (2.0, 1.0), (3.0, 0.0)]), Curve("GR", [(0.0, 0.0), (0.0, 2.0)])
    np.testing.assert_allclose(areas(turning, straight), [1.5])
    np.testing.assert_allclose(areas(turning, Curve("GR", [(2.0, 0.0), (2.0, 1.0)])), [0.5, 0.5])
    (crossed,) = outlines(straight, Curve("GR", [(-1.0, 0.0), (0.0, 1.0), (1.0, 2.0)]))
    assert crossed[:, 0].min() == -1.0 and crossed[:, 0].max() == 1.0
    line = refusal(outlines, straight, Curve("GR", [(0.0, 5.0), (0.0, 6.0)]))
    assert line.startswith("second: must share values of frequency with the first")
    line = refusal(outlines, straight, Curve("GR", LINE, names=PAIR[::-1]))
    assert line.startswith("second: must be a locus in amplitude and frequency")


def test_regions_differ_without_colour():
    ax, curve = Figure().subplots(), Curve("SN", [(0, 0), (0, 1)])
    for k in (1, 2, 3):
        outlines(curve, Curve("GR", [(k, 0), (k, 1)]), f"region {k}", ax)
    patches = of_group(ax.patches, "region")
    assert len({patch.get_hatch() for patch in patches}) == 3
    assert all(len(set(to_rgb(patch.get_facecolor()))) == 1 and patch.get_alpha() < 0.5 for patch in patches)
    assert all(patch.get_zorder() < 2 for patch in patches)
