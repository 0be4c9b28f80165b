"""The table [locus] of a scene file: what a run of it tells, writes and draws; which special points are followed."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.loci import loci_of_branches
from jaxvibro.loci.bistability import find_coexistence_loci
from jaxvibro.loci.locus_start import KINDS
from jaxvibro.studies import result_pictures as picture
from jaxvibro.studies import results_report, scene_file, scene_file_studies, schema
from tests.reference import closed
from tests.scene_files import check_refusal, each_of

SCENES = Path(__file__).parents[1] / "scenes"
LOCI, FIG4 = SCENES / "loci.toml", SCENES / "fig4.toml"
PAIR, LOW, HIGH = ("amplitude", "frequency"), 2.0, 2.3
SMALL = [
    "branch.bounds = [0.0, 4.0]",
    "branch.max_period = 1",
    f"locus.bounds = {{amplitude = [0.0, 12.0], frequency = [{LOW}, {HIGH}]}}",
    "locus.kinds = ['SN', 'GR']",
]


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """What a file that asks for loci gives: its folder and its summary; and what was `Found`."""
    out, found = tmp_path_factory.mktemp("loci"), []
    plain = scene_file_studies.run_studies
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys.modules[jv.run.__module__], "run_studies", lambda *given: found.append(plain(*given)) or found[0]
        )
        done = jv.run(LOCI, out, SMALL)
    return out, done, found[0]


def test_loci_are_told_with_their_ends(followed):
    told, table = followed[1].summary, followed[1].table
    assert [(one["kind"], one["label"], one["parameters"]) for one in told["loci"]] == [
        ("GR", "P111", list(PAIR)),
        ("SN", "P111", list(PAIR)),
    ]
    assert told["not_followed"] == [] and "not followed" not in table
    for one, true in zip(told["loci"], (closed.grazing, _fold), strict=True):
        assert [each["kind"] for each in one["special"]] == ["EP", "EP"]
        assert sorted(each["values"]["frequency"] for each in one["special"]) == [LOW, HIGH]
        assert one["reasons"] == [f"frequency reached its bound {each:g}" for each in _ends(one)]
        for each in one["special"]:
            with mpmath.workdps(30):
                assert abs(each["values"]["amplitude"] - float(true(0.05, each["values"]["frequency"], 1.0))) < 1e-12
            assert each["residual"] < 1e-12 and each["itinerary"] == ["RL"] and len(each["multipliers"]) == 2
    lines = [" ".join(line.split()) for line in table.splitlines()]
    assert "loci of special points in amplitude from 0 to 12 and frequency from 2 to 2.3: 2" in lines
    for place, one in enumerate(told["loci"], 1):
        assert f"{place}: {one['kind']} of P111, {one['points']} points" in lines
        for each in one["special"]:
            amplitude, frequency = each["values"].values()
            assert f"EP {amplitude:.12g} {frequency:.12g} P111 RL" in lines
    assert any(line.startswith("CP cusp, ") for line in lines)


def _fold(gamma, frequency, wall):
    return closed.fold(gamma, frequency, 0.7, wall, symmetric=True).amplitude


def _ends(told):
    return [each["values"]["frequency"] for each in told["special"]]


def test_files_and_data_hold_the_loci(followed):
    out, done, found = followed
    assert {one.name for one in out.iterdir()} == {"loci.png", "loci.loci.png", "loci.nc", "loci.txt"}
    assert done.summary["files"]["loci"] == str(out / "loci.loci.png")
    assert (out / "loci.loci.png").read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(out / "loci.nc", engine="scipy") as data:
        assert np.bincount(data["locus_number"]).tolist() == [len(one) for one in found.loci]
        for k, name in enumerate(PAIR):
            wanted = np.concatenate([one.values[:, k] for one in found.loci])
            np.testing.assert_array_equal(data[f"locus_{name}"], wanted)
        assert data["locus_kind"].values.tolist() == ["GR", "SN"]
        assert data["locus_first_reason"].values.tolist() == [one.reasons[0] for one in found.loci]
        ends = data["locus_frequency"].values[data["codim2_point"].values]
        assert sorted(ends) == [LOW, LOW, HIGH, HIGH] and data["codim2_locus"].values.tolist() == [0, 0, 1, 1]
        assert data["codim2_kind"].values.tolist() == 4 * ["EP"]


def test_a_file_without_loci_has_no_picture_of_them(followed, tmp_path):
    (tmp_path / "plain.toml").write_text("scene = {amplitude=1.0, frequency=2.1, damping=0.05, restitution=0.7}")
    done = jv.run(tmp_path / "plain.toml", tmp_path / "out")
    assert {one.name for one in (tmp_path / "out").iterdir()} == {"plain.png", "plain.nc", "plain.txt"}
    assert "loci" not in done.summary["files"] and "loci" not in done.summary
    with pytest.raises(FileExistsError, match=r"loci\.png"):
        jv.run(LOCI, followed[0], SMALL)


def test_the_picture_has_its_bounds_and_draws_mirror_images_once(followed, monkeypatch):
    found, axes, figures = followed[2], [], []
    one = found.loci[1]
    walls = {"P112": ("RLR",), "P121": ("LRL",), "P111": ("RL",)}

    def named(label):
        special = tuple(SimpleNamespace(kind="EP", itinerary=walls[label]) for _ in range(2))
        return SimpleNamespace(
            kind="SN", label=label, names=PAIR, bounds=one.bounds, values=one.values, special=special, points=one.points
        )

    class Kept(jv.Locus):
        label = values = None

        def __init__(self, **numbers):
            vars(self).update(numbers)

        def __len__(self):
            return len(self.values)

    twins = [Kept(**vars(named(label))) for label in ("P112", "P121", "P111")]
    draw = plot.locus
    monkeypatch.setattr(plot, "locus", lambda each, ax, **more: axes.append(each.label) or draw(each, ax, **more))
    monkeypatch.setattr(picture, "png_bytes", lambda figure: figures.append(figure))
    picture.draw_loci_picture(
        SimpleNamespace(branches=(), file=found.file, loci=twins, scene_of_table=found.scene_of_table)
    )
    assert axes == ["P112", "P111"]
    (figure,) = figures
    assert isinstance(figure, Figure) and figure.axes[0].get_ylim() == (LOW, HIGH)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["SN of P112 and mirror image", "SN of P111"]
    assert "0.05" in figure.get_suptitle() and "2.1" not in figure.get_suptitle()
    picture.draw_loci_picture(
        SimpleNamespace(branches=(), file=found.file, loci=(), scene_of_table=found.scene_of_table)
    )
    assert figures[1].axes[0].get_xlim() == (0.0, 12.0) and not figures[1].legends


def curve(values, label="P111", kind="SN"):
    return SimpleNamespace(
        kind=kind, label=label, names=PAIR, values=np.array(values), bounds=dict.fromkeys(PAIR, (0.0, 10.0))
    )


def bent(turn):
    """A parabola whose points are as far apart as those of a locus are, turned on by an angle."""
    along = np.linspace(-2.0, 2.0, 41)
    cos, sin = np.cos(turn), np.sin(turn)
    return lambda t: 5.0 + np.stack([cos * t - sin * t * t, sin * t + cos * t * t], axis=-1), along


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2, np.pi / 2, 2.5])
def test_a_point_between_those_of_a_locus_is_told_from_one_beside_it(turn):
    draw, along = bent(turn)
    one = curve(draw(along))
    for t in np.linspace(-1.99, 1.99, 77):
        assert loci_of_branches.contains_point(one, draw(t)), t
    off = np.array([-np.sin(turn), np.cos(turn)])
    for t in along[1:-1]:
        for aside in (1e-4, -1e-4, 0.1):
            assert not loci_of_branches.contains_point(one, draw(t) + aside * off), (t, aside)
    assert not loci_of_branches.contains_point(one, draw(2.05)) and not loci_of_branches.contains_point(one, [0.0, 0.0])


def test_special_points_on_one_locus_are_followed_once(monkeypatch):
    """At A = 2 both symmetry breakings along the frequency are on one curve."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "frequency", (1.0, 3.0))
    first, second = branch.points("SB")
    bounds, counts = {"amplitude": (1.0, 2.5), "frequency": (1.05, 1.7)}, []
    found, refused = loci_of_branches.follow_loci([branch], PAIR, bounds, progress=counts.append)
    assert [one.kind for one in found] == ["SB"] and refused == () and counts == [1, 2]
    assert (
        loci_of_branches.count_points_to_follow([branch], bounds) == 2
        and loci_of_branches.count_points_to_follow([branch], bounds | {"frequency": (1.3, 1.7)}) == 1
    )
    assert all(loci_of_branches.contains_point(found[0], [2.0, one.value]) for one in (first, second))
    assert not loci_of_branches.contains_point(found[0], [2.0, first.value + 1e-5])
    followed = []
    monkeypatch.setattr(loci_of_branches, "locus", lambda one, *given, **settings: followed.append(one) or found[0])
    loci_of_branches.follow_loci([branch, branch], PAIR, bounds, ("SN", "SB"))
    assert followed == [first]
    loci_of_branches.follow_loci([branch], PAIR, bounds, ("SN", "PD"))
    loci_of_branches.follow_loci([branch], PAIR, {"amplitude": (2.1, 2.5), "frequency": (1.05, 1.7)})
    assert followed == [first]


def test_a_point_that_cannot_be_followed_is_told(followed):
    """A symmetry breaking is no point of a scene whose walls are unlike."""
    found = followed[2]
    names, bounds = ("amplitude", "right.position"), {"amplitude": (0.0, 9.0), "right.position": (0.5, 2.0)}
    curves, refused = loci_of_branches.follow_loci(found.branches, names, bounds, ("SB",))
    assert curves == () and [(one.kind, one.label) for one, _ in refused] == [("SB", "P111")]
    (why,) = [why for _, why in refused]
    assert why.startswith("must keep the scene symmetric")
    told = scene_file_studies.StudyResults(
        found.file, found.scene, None, None, None, found.branches, None, curves, refused
    )
    lines = results_report.format_results_table(told, "loci.toml").splitlines()
    assert f"not followed: SB of P111 at amplitude = {refused[0][0].value:.12g}: {why}" in lines
    (line,) = results_report.summarise_results(told, {})["not_followed"]
    assert (line["kind"], line["label"], line["reason"]) == ("SB", "P111", why) and abs(
        line["value"] - 3.5438922
    ) < 1e-7


def test_a_locus_has_defaults():
    asked = scene_file.read_scene_file(LOCI, ["locus = {largest_step = 0.2}"]).locus
    assert asked.parameters == PAIR and asked.bounds == {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
    assert asked.kinds == schema.LOCUS_KINDS == KINDS and asked.largest_step == 0.2
    assert scene_file.read_scene_file(FIG4).locus is None


ALLOWED = "(parameters, bounds, kinds, largest_step, max_seconds)"
# The change to scenes/loci.toml, the key that the error names, and what it says.
BAD = [
    ("locus = 3", "locus", "must be a table; got 3"),
    ("locus.names = 3", "locus.names", f"is not a key here {ALLOWED}; got 3"),
    ("locus.parameters = 'amplitude'", "locus.parameters", "must be a list; got 'amplitude'"),
    ("locus.parameters = ['amplitude']", "locus.parameters", "must be a list of length 2; got ['amplitude']"),
    ("locus.parameters = ['amplitude', 3]", "locus.parameters[1]", "must be a text; got 3"),
    (
        "locus.parameters = ['amplitude', 'force']",
        "locus.parameters[1]",
        "must be a parameter of the scene",
    ),
    (
        "locus.parameters = ['damping', 'damping']",
        "locus.parameters",
        "must be two different parameters; got ['damping'",
    ),
    (
        "locus.parameters = ['amplitude', 'damping']",
        "locus.bounds",
        "for amplitude and for damping only; got 'amp",
    ),
    (
        "locus.bounds.damping = [0, 1]",
        "locus.bounds",
        "must give [low, high] for amplitude and for frequency only",
    ),
    ("locus.bounds = 3", "locus.bounds", "must be a table; got 3"),
    ("locus.bounds.frequency = 3", "locus.bounds.frequency", "must be a list; got 3"),
    ("locus.bounds.frequency = [1.2]", "locus.bounds.frequency", "must be a list of length 2; got [1.2]"),
    ("locus.bounds.frequency = [1.2, 'high']", "locus.bounds.frequency[1]", "must be a number; got 'high'"),
    ("locus.bounds.frequency = [3, 1]", "locus.bounds.frequency", "the first smaller; got [3.0, 1.0]"),
    ("locus.bounds.frequency = [1, inf]", "locus.bounds.frequency", "two finite numbers, the first smaller"),
    (
        "locus.bounds.frequency = [2.2, 3]",
        "locus.bounds.frequency",
        "must contain the frequency of [branch], 2.1; got [2.2",
    ),
    (
        "branch.at.frequency = 3.5",
        "locus.bounds.frequency",
        "must contain the frequency of [branch], 3.5; got [1.2, 3.0]",
    ),
    ("locus.bounds.amplitude = [7, 9]", "locus.bounds.amplitude", "must overlap branch.bounds, 0.0 and 6.0; got [7.0"),
    ("locus.kinds = 'SN'", "locus.kinds", "must be a list; got 'SN'"),
    ("locus.kinds = []", "locus.kinds", "must be a list of length >= 1; got []"),
    ("locus.kinds = ['SN', 'EP']", "locus.kinds[1]", "must be one of SN, PD, SB, GR; got 'EP'"),
    ("locus.kinds = ['SN', 'SN']", "locus.kinds[1]", "must differ from the others; got 'SN'"),
    ("locus.kinds = ['SN', 3]", "locus.kinds[1]", "must be a text; got 3"),
    ("locus.largest_step = 0", "locus.largest_step", "must be greater than 0; got 0.0"),
    ("locus.largest_step = inf", "locus.largest_step", "must be finite; got inf"),
]


@each_of(BAD)
def test_a_bad_locus_is_one_clear_line(change, key, said):
    check_refusal(LOCI, change, key, said)


def test_loci_need_branches(tmp_path):
    text = LOCI.read_text()
    (tmp_path / "lone.toml").write_text(text[: text.index("[branch]")] + text[text.index("[locus]") :])
    with pytest.raises(
        jv.ArgumentError, match=r"^locus: must come with \[branch\] or \[explore\], whose special points"
    ):
        scene_file.read_scene_file(tmp_path / "lone.toml")


def test_a_locus_survives_writing(tmp_path):
    old, new = "{amplitude = [0.0, 12.0], frequency = [1.2, 3.0]}", "{damping = [0, 1], 'right.position' = [0.9, 2]}"
    text = LOCI.read_text().replace(old, new)
    (tmp_path / "other.toml").write_text(text.replace('["amplitude", "frequency"]', '["damping", "right.position"]'))
    file = scene_file.read_scene_file(tmp_path / "other.toml", ["locus.kinds=['GR']"])
    scene_file.write_scene_file(file, tmp_path / "copy.toml")
    assert scene_file.read_scene_file(tmp_path / "copy.toml") == file
    assert file.locus.bounds == {"damping": (0.0, 1.0), "right.position": (0.9, 2.0)}
    with pytest.raises(jv.ArgumentError) as caught:
        scene_file.read_scene_file(tmp_path / "other.toml", ["locus.bounds.'right.position'=[1, 'far']"])
    assert caught.value.key == "locus.bounds.right.position[1]"


def test_where_two_motions_exist_together(followed):
    _, _, found = followed
    ((first, second, told),) = find_coexistence_loci(found.branches, found.loci)
    assert told == "P100 and P111" and {first.kind, second.kind} == {"SN", "GR"}
    assert find_coexistence_loci(found.branches, [first]) == []


def test_no_stable_motions_no_region(followed):
    one = next(each for each in followed[2].branches if each.points("SN"))
    unstable = replace(one, data=one.data.assign(stable=0 * one.data["stable"]))
    assert find_coexistence_loci([unstable], followed[2].loci) == []
