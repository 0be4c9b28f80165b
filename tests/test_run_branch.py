"""The table [branch] of a scene file: what a run of it tells, writes and draws; the branches that are walked for it."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.branches import branch_tree
from jaxvibro.problem.end import End
from jaxvibro.problem.orbit_point import OrbitPoint
from jaxvibro.studies import command, result_pictures, scene_file, scene_file_studies
from tests.scene_files import SCENE, check_refusal, each_of

SCENE_FILE = Path(__file__).parents[1] / "scenes" / "branches.toml"
FOLD, GRAZING, BREAKING = 0.508057896812, 3.416460156361, 3.543892249375
BRANCH = """
[branch]
parameter = "amplitude"
bounds = [0.0, 4.0]
start = {x = 0.9, v = -1.1}
at = {amplitude = 2.0}
"""
LOOP = """
[branch]
parameter = "frequency"
bounds = [0.5, 3.0]
"""


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """What a file that asks for branches alone gives: its folder and its summary; and what was `Found`."""
    out, found = tmp_path_factory.mktemp("branch"), []
    plain = scene_file_studies.run_studies
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys.modules[jv.run.__module__], "run_studies", lambda *given: found.append(plain(*given)) or found[0]
        )
        (out / "branch.toml").write_text(SCENE + BRANCH)
        done = jv.run(out / "branch.toml", out / "out")
    return out, done, found[0]


def test_special_points_are_told_with_their_values(followed):
    told, table = followed[1].summary, followed[1].table
    main, *others = told["branches"]
    assert [(one["kind"], one["label"]) for one in main["special"]] == [
        ("EP", "P100"),
        ("GR", "P111"),
        ("SN", "P111"),
        ("SB", "P111"),
        ("EP", "P111"),
    ]
    values = [one["value"] for one in main["special"]]
    np.testing.assert_allclose(values, [0.0, GRAZING, FOLD, BREAKING, 4.0], atol=1e-11)
    assert [part["label"] for part in main["segments"]] == ["P100", "P111"]
    assert (main["parameter"], main["from"], main["to"]) == ("amplitude", 0.0, 4.0)
    assert main["special"][1]["meets"] == ["P100<", "P111<"]
    fold = main["special"][2]
    assert fold["residual"] < 1e-13 and fold["itinerary"] == ["RL"]
    np.testing.assert_allclose(fold["multipliers"][0], [1.0, 0.0], atol=1e-9)
    assert [one["label"] for one in others] == ["P111", "P111"]
    for one in others:
        np.testing.assert_allclose([one["from"], one["to"]], [BREAKING, 4.0], atol=1e-11)
        assert [each["kind"] for each in one["special"]] == ["EP", "EP"]
    lines = [" ".join(line.split()) for line in table.splitlines()]
    for line in (
        f"SN {FOLD:.12g} P111 saddle to stable RL 1, 0.178013 -",
        "1: P100 from 0 to 4, ",
        "2: P111 from 3.543892",
    ):
        assert any(each.startswith(line) for each in lines), line
    assert sum(line.startswith("GR 3.4164601563") for line in lines) == 1
    assert "last point: the parameter reached its bound 4" in lines


def test_the_data_hold_the_branches(followed):
    out, told = followed[0] / "out", followed[1].summary["branches"]
    assert {one.name for one in out.iterdir()} == {"branch.png", "branch.nc", "branch.txt"}
    with xr.open_dataset(out / "branch.nc", engine="scipy") as data:
        sizes = [one["points"] for one in told]
        assert data.sizes["branch_point"] == sum(sizes) and data.sizes["branch_period"] == 1
        assert np.bincount(data["branch_number"]).tolist() == sizes
        kinds, value = data["special_kind"].values, data["special_value"].values
        assert kinds.tolist() == [each["kind"] for one in told for each in one["special"]]
        for kind, wanted in (("SN", FOLD), ("GR", GRAZING), ("SB", BREAKING)):
            np.testing.assert_allclose(value[kinds == kind], [wanted], atol=1e-11)
        np.testing.assert_array_equal(data["branch_value"][data["special_point"].values], value)
        np.testing.assert_array_equal(data["branch_number"][data["special_point"].values], data["special_branch"])
        assert data["branch_value"].attrs["parameter"] == "amplitude"
        assert data["branch_x"].attrs["units"] == "length"
        first = data.isel(branch_point=data["branch_number"].values == 0)
        np.testing.assert_array_equal(first["branch_x"], followed[2].branches[0].data["x"])
        assert data["branch_last_reason"].values.tolist() == 3 * ["the parameter reached its bound 4"]


@pytest.mark.filterwarnings("ignore:No artists with labels")
def test_branches_are_drawn_alone_and_over_what_was_swept_along_their_parameter(followed, monkeypatch):
    found, drawn = followed[2], []
    monkeypatch.setattr(plot, "branch", lambda one, variable, ax, units: drawn.append(variable))
    monkeypatch.setattr(plot, "diagram", lambda swept, variable, ax, faint, units: drawn.append((variable, faint)))

    def picked(*changes, **others):
        drawn.clear()
        file = scene_file.read_scene_file(SCENE_FILE, ["branch.bounds=[0.0, 4.0]", *changes])
        result_pictures.draw_main_picture(replace(found, file=msgspec.structs.replace(file, attractors=None), **others))
        return list(drawn)

    result_pictures.draw_main_picture(found)
    assert drawn == 3 * ["x"] + 3 * ["v"]
    assert picked() == [("x", True), *3 * ["x"], ("v", True), *3 * ["v"]]
    assert picked("branch.at.damping=0.06") == [("x", False), ("v", False)]
    moved = ["sweep.parameter='right.position'", "sweep.legs.0.to=2", "sweep.legs.1.from=2"]
    assert picked(*moved) == [("x", False), ("v", False)]


def test_a_diagram_of_branches_says_where_it_is_and_takes_what_is_of_the_same_scene(followed):
    found = followed[2]
    assert (found.diagram_parameter, found.diagram_value(found.file.branch)) == ("amplitude", 2.0)
    at = [
        scene_file.read_scene_file(SCENE_FILE, [f"orbits.at={given}"]).orbits
        for given in ("{amplitude=3}", "{damping=0.1}", "{}")
    ]
    assert [found.diagram_value(each) for each in at] == [3.0, None, 4.65]
    heading = result_pictures._heading_text(found, "scene")
    assert "A$" not in heading and "2.1" in heading


def test_a_start_that_settles_on_no_orbit_is_one_clear_line(tmp_path, capsys):
    (tmp_path / "lost.toml").write_text(SCENE + BRANCH)
    changes = ["branch.at.amplitude=5.26", "branch.bounds=[0.0,6.0]", "branch.settle=100"]
    words = [word for change in changes for word in ("--set", change)]
    assert command.main(["run", str(tmp_path / "lost.toml"), "--out", str(tmp_path / "out"), *words]) == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert err.startswith(
        "jaxvibro: branch.start: must lead to an orbit that can be followed (no orbit: the state does"
    )
    assert not (tmp_path / "out").exists()


def test_a_branch_has_defaults():
    asked = scene_file.read_scene_file(SCENE_FILE).branch
    assert (asked.parameter, asked.bounds, asked.max_period, asked.at) == ("amplitude", (0.0, 6.0), 2, {"amplitude": 2})
    assert (asked.start.x, asked.start.v, asked.settle, asked.largest_step) == (0.9, -1.1, 200, 0.1)
    table = "branch = {parameter='frequency', bounds=[1, 3]}"
    file = msgspec.to_builtins(msgspec.structs.replace(scene_file.read_scene_file(SCENE_FILE), branch=None))
    asked = scene_file.parse_tables(scene_file.apply_change(file, table)).branch
    assert (asked.start.x, asked.start.v, asked.at, asked.max_period) == (0.0, 0.0, {}, 1)


KEYS = "(parameter, bounds, start, at, settle, max_period, largest_step, max_seconds)"
# The change to scenes/branches.toml, the key that the error names, and what it says.
BAD = [
    ("branch = 3", "branch", "must be a table; got 3"),
    ("branch.name = 'amplitude'", "branch.name", f"is not a key here {KEYS}"),
    ("branch.parameter = 'force'", "branch.parameter", "must be a parameter of the scene"),
    ("branch.parameter = 3", "branch.parameter", "must be a text; got 3"),
    ("branch.bounds = 3", "branch.bounds", "must be a list; got 3"),
    ("branch.bounds = [1.0]", "branch.bounds", "must be a list of length 2; got [1.0]"),
    ("branch.bounds = ['low', 1.0]", "branch.bounds[0]", "must be a number; got 'low'"),
    ("branch.bounds = [6, 0]", "branch.bounds", "two finite numbers, the first smaller; got [6.0, 0.0]"),
    ("branch.bounds = [2, 2]", "branch.bounds", "two finite numbers, the first smaller; got [2.0, 2.0]"),
    ("branch.bounds = [0, inf]", "branch.bounds", "two finite numbers, the first smaller; got [0.0, inf]"),
    ("branch.bounds = [nan, 6]", "branch.bounds", "two finite numbers, the first smaller; got [nan, 6.0]"),
    ("branch.bounds = [3, 6]", "branch.at.amplitude", "must lie within branch.bounds, 3.0 and 6.0; got 2.0"),
    ("branch.parameter = 'damping'\nbranch.bounds=[1, 2]", "branch.bounds", "must contain the scene's damping, 0.05"),
    ("branch.at = 4.65", "branch.at", "must be a table; got 4.65"),
    ("branch.at.force = 1.0", "branch.at.force", "is not a parameter of this scene, perhaps amplitude ("),
    ("branch.at.damping = 'low'", "branch.at.damping", "must be a number; got 'low'"),
    ("branch.at.amplitude = nan", "branch.at.amplitude", "must be finite; got nan"),
    ("branch.at.frequency = 0", "branch.at.frequency", "must be greater than 0; got 0.0"),
    ("branch.start.x = 1.01", "branch.start.x", "must lie between the walls, at -1.0 and 1.0; got 1.01"),
    ("branch.start.v = inf", "branch.start.v", "must be finite; got inf"),
    ("branch.start = 3", "branch.start", "must be a table; got 3"),
    ("branch.start.y = 3", "branch.start.y", "is not a key here (x, v)"),
    ("branch.settle = -1", "branch.settle", "must be a whole number >= 0; got -1"),
    ("branch.max_period = 0", "branch.max_period", "must be a whole number >= 1; got 0"),
    ("branch.max_period = 33", "branch.max_period", "must be a whole number <= 32; got 33"),
    ("branch.largest_step = 0", "branch.largest_step", "must be greater than 0; got 0.0"),
    ("branch.largest_step = nan", "branch.largest_step", "must be finite; got nan"),
]


@each_of(BAD)
def test_a_bad_branch_is_one_clear_line(change, key, said):
    check_refusal(SCENE_FILE, change, key, said)


def test_a_branch_survives_writing(tmp_path):
    file = scene_file.read_scene_file(SCENE_FILE, ["branch.at.'right.restitution'=0.5", "branch.settle=0"])
    scene_file.write_scene_file(file, tmp_path / "copy.toml")
    assert scene_file.read_scene_file(tmp_path / "copy.toml") == file


PLAIN = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
HALF = np.pi / 2.1


@dataclass
class Point:
    """A special point of a branch, as far as `tree` looks at it."""

    kind: str
    value: float
    spot: OrbitPoint
    place: int
    scene: jv.Scene = PLAIN
    name: str = "amplitude"


def point(kind, value, right, left=(), periods=1):
    """The `Point` whose orbit has impacts of these speeds, on the right wall at phase 0, on the left half a turn on."""
    sides = np.array([1.0] * len(right) + [-1.0] * len(left))
    times = np.where(sides < 0, HALF, 0.0)
    spot = OrbitPoint(value, times, np.array([*right, *left], float), sides, periods, 0.0, 0.0, 0.0)
    return Point(kind, value, spot, int(kind != "EP"))


class Walk(list):
    """A branch, as far as `tree` looks at it; it has as many points as special ones."""

    def __init__(self, label, *special, ends=(End.BOUND, End.BOUND)):
        super().__init__(special)
        self.special, self.segments, self.ends = special, [SimpleNamespace(label=label)], ends


def reflected(branch):
    """The mirror image of a `Walk`, as far as `tree` looks at it."""
    twins = [
        replace(one, spot=one.spot._replace(times=one.spot.times + HALF, sides=-one.spot.sides))
        for one in branch.special
    ]
    return Walk(branch.segments[0].label, *twins, ends=branch.ends)


def test_a_branch_and_its_mirror_image_are_one_of_two():
    """Told by their special points, in any order; a symmetric branch has none, nor has a branch in another scene."""
    own = Walk("P110", point("EP", 1.0, [0.5]), point("PD", 2.0, [0.7]), point("EP", 3.0, [0.9]))
    image, other = reflected(own), Walk("P110", *own.special[:2], point("EP", 3.0, [0.8]))
    image.special = image.special[::-1]
    both = Walk("P111", point("EP", 1.0, [0.5], [0.5]))
    for one in (own, image, other, both):
        one.scene, one.name = PLAIN, "amplitude"
    assert branch_tree.originals_of_mirrors([both, own, other, image]) == {3: 1}
    assert branch_tree.originals_of_mirrors([own, own, both]) == {}
    for one in (own, image):
        one.name = "left.position"
    assert branch_tree.originals_of_mirrors([own, image]) == {}


def walked(monkeypatch, first, ways, symmetric=False, **given):
    """(the branches, the special points that were left) where `ways` says which branches leave them."""
    asked = []

    def starts(one):
        asked.append(one)
        return ways[one.kind, one.value]

    monkeypatch.setattr(branch_tree, "follow", lambda orbit, name, bounds, **settings: first)
    monkeypatch.setattr(branch_tree, "_prime_period_starts", starts)
    monkeypatch.setattr(branch_tree, "follow_away_from_point", lambda one, start, bounds, **settings: start)
    monkeypatch.setattr(branch_tree, "set_up_equations", lambda scene, name, spot: (None, None))
    monkeypatch.setattr(branch_tree, "is_repeated", lambda along, z: False)
    monkeypatch.setattr(branch_tree, "stays_symmetric", lambda scene, name: symmetric)
    monkeypatch.setattr(branch_tree, "mirror_branch", reflected)
    return branch_tree.follow_tree(SimpleNamespace(scene=PLAIN), "amplitude", (0.0, 9.0), **given), asked


def test_each_special_point_is_left_once_and_mirror_images_are_two(monkeypatch):
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("EP", 0.0, [])
    one, twin = point("PD", 5.0, [1.0, 2.0], [3.0]), point("PD", 5.0, [3.0], [2.0, 1.0])
    halves = [
        Walk("P112", point("EP", 3.0, [1.0], [1.0]), one, point("PD", 5.0 + 1e-12, [2.0, 1.0 + 1e-9], [3.0])),
        Walk("P121", point("EP", 3.0, [1.0], [1.0]), twin),
    ]
    ways = {("SB", 3.0): halves, ("PD", 5.0): [Walk("P224", point("EP", 5.0, [1, 1, 2, 2], [3, 3], 2), end)]}
    main = Walk("P100", end, sb, point("SN", 4.0, [2.0]), point("EP", 9.0, [9.0], [9.0]))
    found, asked = walked(monkeypatch, main, ways)
    assert asked == [sb] and [one.segments[0].label for one in found] == ["P100", "P112", "P121"]
    counts = []
    found, asked = walked(monkeypatch, main, ways, max_period=2, progress=counts.append)
    assert asked == [sb, one, twin] and len(found) == 4 and counts == [1, 2, 3, 4]  # the second P224 is the first here


def test_a_branch_that_joins_two_special_points_is_walked_once(monkeypatch):
    """A period doubling and its reverse: the doubled orbits come back at 6, and on to their start the other way."""
    twice = {value: point("EP", value, [value, value], (), 2) for value in (5.0, 6.0)}
    met = point("BP", 6.0, [6.0, 6.0], (), 2)
    here, there = point("PD", 5.0, [5.0]), point("PD", 6.0, [6.0])
    ways = {("PD", 5.0): [Walk("P202", twice[5.0], met, twice[5.0])]}
    main = Walk("P101", point("EP", 0.0, [0.5]), here, there, point("EP", 9.0, [9.0]))
    found, asked = walked(monkeypatch, main, {**ways, ("BP", 6.0): []}, max_period=2)
    assert len(found) == 2 and asked[0] is here and there not in asked
    closed = [Walk("P111", point("EP", 3.0, [1.0]), point("EP", 3.0, [1.0])) for _ in range(2)]
    main = Walk("P111", point("EP", 0.0, [0.5]), point("BP", 3.0, [1.0]), point("EP", 9.0, [9.0]))
    found, _ = walked(monkeypatch, main, {("BP", 3.0): closed})
    assert len(found) == 2


def test_in_a_symmetric_scene_half_is_walked(monkeypatch):
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("EP", 9.0, [9.0], [9.0])
    one = point("PD", 5.0, [1.0, 2.0], [3.0])
    halves = [Walk("P112", point("EP", 3.0, [1.0], [1.0]), one, point("EP", 9.0, [1.0, 4.0], [9.0])), None]
    ways = {("SB", 3.0): halves, ("PD", 5.0): [Walk("P224", point("EP", 5.0, [1, 1, 2, 2], [3, 3], 2))]}
    main = Walk("P111", point("EP", 0.0, [], []), sb, end)
    ways["PD", 5.0][0].append(None)  # two points long
    found, asked = walked(monkeypatch, main, ways, symmetric=True, max_period=2)
    assert asked == [sb, one]
    assert [each.segments[0].label for each in found] == ["P111", "P112", "P112", "P224", "P224"]
    for first, image in ((1, 2), (3, 4)):
        pairs = zip(found[first].special, found[image].special, strict=True)
        assert all(np.array_equal(here.spot.sides, -there.spot.sides) for here, there in pairs)


@pytest.mark.parametrize("ends", [(End.START, End.CLOSED), (End.START, End.BOUND), (End.BOUND, End.MAX_POINTS)])
def test_a_symmetry_breaking_that_a_branch_of_asymmetric_orbits_goes_through_is_left(ends, monkeypatch):
    """The branch goes on into its mirror images, which are no other branch: a loop wherever it was started, one within
    bounds though more special points were seen on one side, and one that a limit cut before they were all met."""
    sb = point("SB", 3.0, [1.0], [1.0])
    start, fold = point("EP", 1.0, [0.5]), point("SN", 2.0, [2.0])
    others = {End.CLOSED: (point("SN", 2.0, (), [2.0]), start), End.BOUND: (point("EP", 1.0, (), [0.5]),)}
    loop = Walk("P101", start, fold, sb, *others.get(ends[1], ()), ends=ends)
    halves = [
        Walk("P111", point("EP", 3.0, [1.0], [1.0]), point("EP", end, [end], [end])) for end in (0.0, 9.0)
    ]  # symmetric
    found, asked = walked(monkeypatch, loop, {("SB", 3.0): halves}, symmetric=True)
    images = 1 if End.MAX_POINTS in ends else 0
    assert asked == [sb] and len(found) == 3 + images
    assert found[0] is loop and found[-2:] == tuple(halves)


def test_a_loop_that_goes_through_its_mirror_images_is_walked_once(monkeypatch):
    """Both ways that leave an SB go round the same loop; the second ends in the mirror image of the first's end."""
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("GR", 4.0, [4.0, 1.0], [5.0])
    begin, fold = point("EP", 3.0, [1.0], [1.0]), point("SN", 2.0, [2.0])
    loop = Walk("P112", begin, fold, sb, end, ends=(End.LEFT, End.CLOSED))
    main = Walk("P111", point("EP", 0.0, [0.5], [0.5]), sb, point("EP", 9.0, [9.0], [9.0]))
    found, _ = walked(monkeypatch, main, {("SB", 3.0): [loop, reflected(loop)]}, symmetric=True)
    assert found == (main, loop)
    other = Walk("P112", begin, fold, sb, point("GR", 4.0, [4.0, 1.0], [6.0]), ends=(End.LEFT, End.CLOSED))
    found, _ = walked(monkeypatch, main, {("SB", 3.0): [loop, other]}, symmetric=True)
    assert found == (main, loop, other)


def test_symmetric_orbits_that_cross_a_loop_of_asymmetric_ones_are_followed(tmp_path):
    """The loop, P101 and P111 and their mirror images, goes through an SB, where the symmetric P111 crosses it."""
    file = tmp_path / "loop.toml"
    file.write_text(SCENE + LOOP)
    numbers = {"amplitude": 0.6871, "frequency": 0.8333, "damping": 0.015, "restitution": 0.6}
    changes = [f"scene.{key}={value}" for key, value in numbers.items()]
    loop, *crossing = scene_file_studies.run_studies(scene_file.read_scene_file(file, changes)).branches
    (breaking,) = [one.value for one in loop.special if one.kind == "SB"]
    assert End.CLOSED in loop.ends and breaking == pytest.approx(0.914752380254, abs=1e-9)
    for one, value in zip(crossing, (0.5, 3.0), strict=True):
        assert one.ends == (End.LEFT, End.BOUND) and one.values[-1] == value
        assert one.special[0].label == "P111" and one.values[0] == pytest.approx(breaking, abs=1e-9)
    told = [(one.kind, one.value) for one in crossing[1].special[1:-1]]
    assert [kind for kind, _ in told] == ["SN", "GR"]
    np.testing.assert_allclose([value for _, value in told], [2.372, 1.2985], atol=6e-5)


def test_there_are_64_branches_at_most_and_points_without_length_are_none(monkeypatch):
    def half(k):
        return Walk(
            "P101", point("EP", k - 1.0, [0.5]), point("BP", float(k), [k + 1.0]), point("EP", k + 0.5, [k + 1])
        )

    ways = {("BP", float(k)): [half(k + 1), Walk("P101", point("EP", float(k), [1.0]))] for k in range(100)}
    found, _ = walked(monkeypatch, half(0), ways)
    assert len(found) == branch_tree.MAX_BRANCHES == 64
