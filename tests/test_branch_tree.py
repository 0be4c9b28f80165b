"""The tree of branches that leave the special points of a branch, on branches of invented points."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.branches import branch_tree
from jaxvibro.problem.curve_ends import End
from jaxvibro.problem.orbit_point import OrbitPoint, make_orbit_point
from jaxvibro.problem.orbit_problem import make_orbit_problem

PLAIN = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
HALF = np.pi / 2.1
PROBLEM = make_orbit_problem(PLAIN, "amplitude", periods=1)


@dataclass
class Point:
    """A special point of a branch, with the fields that the tree reads."""

    kind: str
    value: float
    spot: OrbitPoint
    place: int
    scene: jv.Scene = PLAIN
    name: str = "amplitude"


def point(kind, value, right, left=(), periods=1):
    """Return a `Point` whose orbit hits the right wall at phase 0 and the left one half a turn later."""
    sides = np.array([1.0] * len(right) + [-1.0] * len(left))
    times = np.where(sides < 0, HALF, 0.0)
    impacts = list(zip(times, [*right, *left], sides, strict=True))
    return Point(kind, value, make_orbit_point(PROBLEM, value, impacts, periods), int(kind != "EP"))


class Walk(list):
    """A branch, with the fields that the tree reads; it has as many points as special ones."""

    def __init__(self, label, *special, ends=(End.BOUND, End.BOUND)):
        super().__init__(special)
        self.special, self.segments, self.ends = special, [SimpleNamespace(label=label)], ends


def reflected(branch):
    """Return the mirror image of a `Walk`."""
    twins = [replace(one, spot=one.spot.mirror()) for one in branch.special]
    return Walk(branch.segments[0].label, *twins, ends=branch.ends)


def test_a_mirror_image_is_assigned_to_its_original():
    """They are recognised by their special points, in any order; a symmetric branch has no image."""
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


def follow_tree(monkeypatch, first, ways, symmetric=False, **given):
    """Return the branches of a tree, and the special points that it left; ways: the branches that leave each."""
    asked = []

    def starts(one):
        asked.append(one)
        return ways[one.kind, one.value]

    monkeypatch.setattr(branch_tree, "follow", lambda orbit, name, bounds, **settings: first)
    monkeypatch.setattr(branch_tree, "_prime_period_starts", starts)
    monkeypatch.setattr(branch_tree, "follow_away_from_point", lambda one, start, bounds, **settings: start)
    monkeypatch.setattr(branch_tree, "is_repeated", lambda along, z: False)
    monkeypatch.setattr(branch_tree, "stays_symmetric", lambda scene, name: symmetric)
    monkeypatch.setattr(branch_tree, "mirror_branch", reflected)
    return branch_tree.follow_tree(SimpleNamespace(scene=PLAIN), "amplitude", (0.0, 9.0), **given), asked


def test_each_special_point_is_left_once_and_mirror_images_are_two_points(monkeypatch):
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("EP", 0.0, [])
    one, twin = point("PD", 5.0, [1.0, 2.0], [3.0]), point("PD", 5.0, [3.0], [2.0, 1.0])
    halves = [
        Walk("P112", point("EP", 3.0, [1.0], [1.0]), one, point("PD", 5.0 + 1e-12, [2.0, 1.0 + 1e-9], [3.0])),
        Walk("P121", point("EP", 3.0, [1.0], [1.0]), twin),
    ]
    ways = {("SB", 3.0): halves, ("PD", 5.0): [Walk("P224", point("EP", 5.0, [1, 1, 2, 2], [3, 3], 2), end)]}
    main = Walk("P100", end, sb, point("SN", 4.0, [2.0]), point("EP", 9.0, [9.0], [9.0]))
    found, asked = follow_tree(monkeypatch, main, ways)
    assert asked == [sb] and [one.segments[0].label for one in found] == ["P100", "P112", "P121"]
    counts = []
    found, asked = follow_tree(monkeypatch, main, ways, max_period=2, progress=counts.append)
    assert asked == [sb, one, twin] and len(found) == 4 and counts == [1, 2, 3, 4]  # the second P224 is the first here


def test_a_branch_that_joins_two_special_points_is_followed_once(monkeypatch):
    """A period doubling and its reverse: the doubled orbits come back at 6, and on to their start the other way."""
    twice = {value: point("EP", value, [value, value], (), 2) for value in (5.0, 6.0)}
    met = point("BP", 6.0, [6.0, 6.0], (), 2)
    here, there = point("PD", 5.0, [5.0]), point("PD", 6.0, [6.0])
    ways = {("PD", 5.0): [Walk("P202", twice[5.0], met, twice[5.0])]}
    main = Walk("P101", point("EP", 0.0, [0.5]), here, there, point("EP", 9.0, [9.0]))
    found, asked = follow_tree(monkeypatch, main, {**ways, ("BP", 6.0): []}, max_period=2)
    assert len(found) == 2 and asked[0] is here and there not in asked
    closed = [Walk("P111", point("EP", 3.0, [1.0]), point("EP", 3.0, [1.0])) for _ in range(2)]
    main = Walk("P111", point("EP", 0.0, [0.5]), point("BP", 3.0, [1.0]), point("EP", 9.0, [9.0]))
    found, _ = follow_tree(monkeypatch, main, {("BP", 3.0): closed})
    assert len(found) == 2


def test_in_a_symmetric_scene_one_of_two_mirror_images_is_followed(monkeypatch):
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("EP", 9.0, [9.0], [9.0])
    one = point("PD", 5.0, [1.0, 2.0], [3.0])
    halves = [Walk("P112", point("EP", 3.0, [1.0], [1.0]), one, point("EP", 9.0, [1.0, 4.0], [9.0])), None]
    ways = {("SB", 3.0): halves, ("PD", 5.0): [Walk("P224", point("EP", 5.0, [1, 1, 2, 2], [3, 3], 2))]}
    main = Walk("P111", point("EP", 0.0, [], []), sb, end)
    ways["PD", 5.0][0].append(None)  # two points long
    found, asked = follow_tree(monkeypatch, main, ways, symmetric=True, max_period=2)
    assert asked == [sb, one]
    assert [each.segments[0].label for each in found] == ["P111", "P112", "P112", "P224", "P224"]
    for first, image in ((1, 2), (3, 4)):
        pairs = zip(found[first].special, found[image].special, strict=True)
        assert all(np.array_equal(here.spot.sides, -there.spot.sides) for here, there in pairs)


@pytest.mark.parametrize("ends", [(End.START, End.CLOSED), (End.START, End.BOUND), (End.BOUND, End.MAX_POINTS)])
def test_symmetric_branches_leave_a_symmetry_breaking_on_an_asymmetric_branch(ends, monkeypatch):
    """The branch goes on into its mirror images, which are no other branch: a loop wherever it was started, one within
    bounds though more special points were seen on one side, and one that a limit cut before they were all met."""
    sb = point("SB", 3.0, [1.0], [1.0])
    start, fold = point("EP", 1.0, [0.5]), point("SN", 2.0, [2.0])
    others = {End.CLOSED: (point("SN", 2.0, (), [2.0]), start), End.BOUND: (point("EP", 1.0, (), [0.5]),)}
    loop = Walk("P101", start, fold, sb, *others.get(ends[1], ()), ends=ends)
    halves = [
        Walk("P111", point("EP", 3.0, [1.0], [1.0]), point("EP", end, [end], [end])) for end in (0.0, 9.0)
    ]  # symmetric
    found, asked = follow_tree(monkeypatch, loop, {("SB", 3.0): halves}, symmetric=True)
    images = 1 if End.MAX_POINTS in ends else 0
    assert asked == [sb] and len(found) == 3 + images
    assert found[0] is loop and found[-2:] == tuple(halves)


def test_a_loop_that_goes_through_its_mirror_images_is_followed_once(monkeypatch):
    """Both ways that leave an SB go round the same loop; the second ends in the mirror image of the first's end."""
    sb, end = point("SB", 3.0, [1.0], [1.0]), point("GR", 4.0, [4.0, 1.0], [5.0])
    begin, fold = point("EP", 3.0, [1.0], [1.0]), point("SN", 2.0, [2.0])
    loop = Walk("P112", begin, fold, sb, end, ends=(End.LEFT, End.CLOSED))
    main = Walk("P111", point("EP", 0.0, [0.5], [0.5]), sb, point("EP", 9.0, [9.0], [9.0]))
    found, _ = follow_tree(monkeypatch, main, {("SB", 3.0): [loop, reflected(loop)]}, symmetric=True)
    assert found == (main, loop)
    other = Walk("P112", begin, fold, sb, point("GR", 4.0, [4.0, 1.0], [6.0]), ends=(End.LEFT, End.CLOSED))
    found, _ = follow_tree(monkeypatch, main, {("SB", 3.0): [loop, other]}, symmetric=True)
    assert found == (main, loop, other)


def test_there_are_64_branches_at_most_and_a_branch_has_a_length(monkeypatch):
    def half(k):
        return Walk(
            "P101", point("EP", k - 1.0, [0.5]), point("BP", float(k), [k + 1.0]), point("EP", k + 0.5, [k + 1])
        )

    ways = {("BP", float(k)): [half(k + 1), Walk("P101", point("EP", float(k), [1.0]))] for k in range(100)}
    found, _ = follow_tree(monkeypatch, half(0), ways)
    assert len(found) == branch_tree.MAX_BRANCHES == 64
