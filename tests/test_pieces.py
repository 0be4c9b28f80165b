"""What a branch is told where one of its pieces ends: what goes on, chatter, the signs of tests, kinds of points."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from continuation.arclength import Point
from continuation.branch_segment import BranchSegment, SpecialIndex
from jaxvibro.branches import itinerary_segment, largest_position, user_monitors
from jaxvibro.branches.itinerary_segment import BranchEventDetector, _choose_exit, _is_same_grazing
from jaxvibro.orbits.orbit import impacts_as_points
from jaxvibro.problem.curve_ends import End
from jaxvibro.problem.grazing_contact import BranchFromGrazing, GrazingContact, GrazingPoint
from jaxvibro.problem.orbit_problem import make_orbit_problem

TOUCHES = (GrazingContact(0, -1, 0.3, False), GrazingContact(1, 1, 0.0, True))  # the branch has the second as an impact
AHEAD = np.array([0.6, 0.8])


def orbits(sides=(1.0, -1.0)):
    """Equations of orbits with impacts on these sides."""
    return SimpleNamespace(sequence=SimpleNamespace(sides=np.array(sides), releases=None))


def way(first, second, tangent=AHEAD, along=None):
    """An exit that has some of the touches as impacts."""
    none = np.zeros(())
    point = Point(np.zeros(2), np.asarray(tangent), none, none, none, np.True_, np.True_)
    return BranchFromGrazing(along or orbits(), point, np.zeros(2), None, (first, second))


@pytest.mark.parametrize("sure", [True, False])
def test_a_branch_goes_on_as_it_came_or_else_with_the_touches_exchanged(sure):
    back, forward, exchanged, both = way(False, True, -AHEAD), way(False, True), way(True, False), way(True, True)
    other = way(False, True, -AHEAD, orbits((1.0, 1.0)))  # none to be compared with by its tangent
    for exits, expected in (
        ([back, exchanged, forward], forward),
        ([both, back, exchanged], exchanged),
        ([back, both], both),
        ([other], other),
        ([back], None),
    ):
        rows = np.stack([AHEAD, AHEAD])
        points = Point(rows, rows, *[np.zeros(2)] * 5)
        mark = SpecialIndex(1, "GR", 0.0, GrazingPoint(TOUCHES, tuple(exits), sure))
        one, chosen = _choose_exit(orbits(), BranchSegment(None, points, None, (mark,), End.GRAZE, -1, 0.0), np.ones(2))
        assert chosen is expected
        assert one.specials[-1].detector_details.not_followed == tuple(
            each is not expected and each is not back for each in exits
        )
        assert one.end is (End.GRAZE if expected or sure else End.STEP)


def test_a_grazing_is_met_again_where_value_and_impacts_are_the_same():
    time, side = np.array([0.3, 1.2]), np.array([1, -1])
    points, others = (impacts_as_points(2.1, time, side, np.array([speed, 1.4]), 2.0) for speed in (0.8, 0.9))
    assert _is_same_grazing((1.0, points), (1.0 + 1e-9, points))
    assert not _is_same_grazing((1.0, points), (1.1, points)) and not _is_same_grazing((1.0, points), (1.0, others))


@pytest.mark.parametrize("pressed", [True, False])
@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_touch_on_which_the_mass_is_pressed_is_chatter_unless_a_branch_goes_through(count, pressed, monkeypatch):
    points = Point(np.zeros((3, 2)), np.ones((3, 2)), *[np.zeros(3)] * 5)
    monkeypatch.setattr(itinerary_segment, "truncate_at_grazing", lambda *_: (points, 1e-14))
    known = GrazingPoint(TOUCHES, (way(True, True),) * count, True)
    monkeypatch.setattr(itinerary_segment.soft_wall_grazing, "find_all_exits", lambda *_: known)
    monkeypatch.setattr(itinerary_segment, "is_pressed_on_wall", lambda *_: pressed)
    monkeypatch.setattr(itinerary_segment.curve_ends, "sticking_limit_kind", lambda *_: "")
    met = BranchEventDetector(orbits(), {}).find_boundary_end(None, points, None, 2)
    expected = ("CH", End.REST) if pressed and count < 2 else ("GR", End.GRAZE)
    assert (met.special.kind, met.end) == expected


def looked_at(scene, impacts, determinants, traces, monkeypatch, end=None):
    """(the tests' values, the tangents) in which a branch looks for special points."""
    seen = []
    keep = lambda _, points, values, *__: seen.append((values, points)) or []  # noqa: E731
    monkeypatch.setattr(itinerary_segment.event_search, "locate_events", keep)
    along, z = make_orbit_problem(scene, "amplitude", periods=1).with_impacts(np.array([0.3, 0.1, 2.0]), impacts)
    flip, tangent = np.linspace(1.0, 2.0, len(traces)), np.ones((len(traces), len(z)))
    points = Point(np.tile(z, (len(traces), 1)), tangent, *[np.zeros(len(traces))] * 5)
    view = SimpleNamespace(flip_test=flip, trace=np.array(traces), determinant=np.array(determinants))
    task = SimpleNamespace(problem=None, control=None, args=along)
    BranchEventDetector(along, {}).find_events(task, points, view, None, end)
    ((values, points),) = seen
    return values, points.tangent[:, -1]


@pytest.mark.parametrize("traces, signs", [((-1.0, -2.0), (-1, 1)), ((1.0, 2.0), (1, -1)), ((0.1, 0.2), (1, 1))])
def test_at_a_contact_without_speed_tests_have_the_sign_that_the_multipliers_come_with(traces, signs, monkeypatch):
    """Multipliers m and 0.4 / m: their sum passes -1.4 where one of them is -1, and 1.4 where one is 1."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (None, jv.Wall(1.0, stiffness=30.0)))
    end = SimpleNamespace(
        special=SimpleNamespace(detector_details=SimpleNamespace(grazing_contacts=(GrazingContact(0, 1, 0.0, True),)))
    )
    values, tangent = looked_at(scene, [(0.3, 0.0, 1.0)], [0.4] * 3, [0.0, *traces], monkeypatch, end)
    assert np.array_equal(values["PD"], [1.0, 1.5, 1.5 * signs[0]]) and np.array_equal(tangent, [1.0, 1.0, signs[1]])


def test_a_motion_without_impacts_doubles_its_period_where_a_multiplier_is_minus_1(monkeypatch):
    force = jv.Force("duffing", {"cubic": 0.5, "damping": 0.05})
    scene = jv.make_scene(2.0, 2.1, restitution=0.7, walls=(None, None), force=force)
    values, _ = looked_at(scene, [], [0.4] * 3, [1.4, -1.4, -2.0], monkeypatch)
    assert values["PD"] == pytest.approx([2.8, 0.0, -0.6], abs=1e-15)
    spring = jv.make_scene(2.0, 2.1, 0.05, 0.7, (None, None))
    assert looked_at(spring, [], [0.4] * 3, [1.4, -1.4, -2.0], monkeypatch)[0] == {}


@pytest.mark.parametrize("trace, kind", [(1.9, "NS"), (-1.9, "NS"), (2.1, "NSA"), (-2.1, "NSA")])
def test_multipliers_whose_product_is_1_are_complex_at_a_neimark_sacker_point(trace, kind, monkeypatch):
    monkeypatch.setattr(user_monitors, "diagnose", lambda *_: None)
    monkeypatch.setattr(user_monitors, "row_at", lambda *_: SimpleNamespace(trace=trace))
    assert user_monitors._event_kind(None, SimpleNamespace(z=np.zeros(3))) == kind


def test_a_turning_point_within_a_cell_is_found_by_false_position():
    rng = np.random.default_rng(7)
    place, bend = rng.uniform(0.05, 0.95, 300), rng.uniform(-0.4, 0.4, 300)

    def at(time):
        late = time - place
        return time, late + bend * late * late

    low, high = jnp.zeros(300), jnp.ones(300)
    assert abs(np.asarray(largest_position._turning_time(at, low, high, at(low)[1], at(high)[1])) - place).max() < 1e-9
