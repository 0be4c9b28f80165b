"""Limits of points and of time: partial results with their reason, continued later; a clock that the test moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
import jaxvibro as jv
from continuation import event_search
from continuation.arclength import Point, StepControl, TrackState, correct_step, solve_bordered
from continuation.branch_segment import BranchSegment, SlowProgressWarning, warn_if_slow
from jaxvibro.branches.explore import EXPIRED_REASON
from jaxvibro.problem import curve_ends

from .properties.branches import end_names

CLOCK = "continuation.branch_segment.clock"


def cubic(u, p, args):
    return jnp.stack([p["a"] * u[0] - u[0] ** 3 + p["b"]])


def traced(**more):
    return co.trace(co.equilibria(cubic), [1.0], {"a": 1.0, "b": 0.0}, "b", (-3.0, 3.0), **more)


@pytest.fixture
def ticking(monkeypatch):
    """A clock that is a second later each time that it is read."""
    read = iter(range(100_000))
    monkeypatch.setattr(CLOCK, lambda: float(next(read)))


@pytest.fixture(scope="module")
def orbit():
    """An orbit of one impact in each period, at one wall."""
    scene = jv.make_scene(1.0, 2.7, 0.05, 0.8, (None, 1.0e-3))
    return jv.find_orbit(scene, jv.State(-0.3, 0.1), settle=200)


@pytest.fixture(scope="module")
def ball():
    """The orbit of a ball that bounces once in each period of a table, y = sin(1.6 t)."""
    table, force = (
        jv.Wall(0.0, 0.15, motion=jv.Motion(1.0, -np.pi / 2)),
        jv.Force("polynomial", {"c0": 1.0, "damping": 0.0}),
    )
    scene = jv.make_scene(0.0, 1.6, restitution=0.15, walls=(table, None), force=force)
    return jv.find_orbit(scene, jv.State(0.9174407804174134, -1.6918867008325806), settle=0)


def test_a_branch_has_at_most_so_many_points_and_is_a_part_of_the_whole():
    whole, counts = traced(), []
    for most in (2, 3, 10, 25):
        part = traced(max_points=most, progress=counts.append)
        assert len(part.u) == most and counts[-1] == most
        assert all("max_points reached" in each for each in part.reasons)
        places = [np.flatnonzero((whole.u == u).all(axis=1)) for u in part.u]
        assert np.diff(np.concatenate(places)).tolist() == [1] * (most - 1)
    assert len(traced(max_points=len(whole.u) + 1000).u) == len(whole.u)
    forward = traced(max_points=7, direction="forward")
    assert len(forward.u) == 7 and forward.reasons[0] == "the start"


def test_the_time_ends_a_branch_between_chunks(ticking):
    short, longer = traced(max_seconds=0.5), traced(max_seconds=4.5)
    assert 2 < len(short.u) < len(longer.u) < len(traced().u)
    assert all("max_seconds reached" in each for each in short.reasons)
    assert any("max_seconds reached" in each for each in longer.reasons)
    (fold, *_) = [one for one in traced().special if one.kind == "SN"]
    box = {"a": (-1.0, 5.0), "b": (-9.0, 9.0)}
    curve = co.curve(fold, ("a", "b"), box, max_points=11)
    assert len(curve.u) == 11 and all("max_points reached" in each for each in curve.reasons)
    assert np.allclose(4.0 * curve.p["a"] ** 3, 27.0 * curve.p["b"] ** 2, atol=1e-9)


def test_a_branch_of_orbits_is_continued_from_its_limits(orbit):
    bounds = (2.5, 2.9)
    whole, part = jv.follow(orbit, "frequency", bounds), jv.follow(orbit, "frequency", bounds, max_points=4)
    assert len(part) <= 4 < len(whole) and end_names(part) == ["MAX_POINTS"] * 2
    assert part.reasons[0] == f"max_points reached at {part.values[0]:.12g}" and part.reasons[0] in part.table()
    again = jv.extend(part, bounds)
    assert again.ends == whole.ends
    assert [one.kind for one in again.special] == [one.kind for one in whole.special]
    assert len(jv.extend(part, bounds, max_points=2)) == len(part) + 1


def test_time_ends_branches_of_orbits(orbit, ticking):
    part = jv.follow(orbit, "frequency", (1.0, 5.0), max_seconds=0.5)
    assert end_names(part) == ["MAX_SECONDS"] * 2 and 1 < len(part) < 9
    assert part.reasons[0] == "max_seconds reached at 2.7"
    assert len(jv.follow_all([orbit, orbit], "frequency", (2.5, 2.9), max_seconds=0.5)) == 1


def test_a_search_for_a_touch_is_given_up_when_the_time_is_over(orbit, monkeypatch):
    looks, now = [], [0.0]
    monkeypatch.setattr(CLOCK, lambda: now[0])

    def nowhere(task, *given):
        looks.append(task)
        now[0] = 9.0

    monkeypatch.setattr(curve_ends, "_locate_first_grazing", nowhere)
    branch = jv.follow(orbit, "frequency", (1.0, 5.0), max_seconds=5.0, direction="forward")
    assert len(looks) == 1 and end_names(branch)[1] == "MAX_SECONDS"


def test_no_branch_point_is_looked_for_when_the_time_is_over(ticking, monkeypatch):
    """The branch ends before it, and a later run goes on from there."""

    def begun(**more):
        return co.trace(co.equilibria(cubic), [0.0], {"a": -0.1, "b": 0.0}, "a", (-1.0, 1.0), **more)

    (point,) = [one for one in begun(direction="forward").special if one.kind == "BP"]
    assert abs(point.p["a"]) < 1e-12
    asked, plain = [], event_search._locate_event
    monkeypatch.setattr(event_search, "_locate_event", lambda *given: asked.append(given[1]) or plain(*given))
    part = begun(max_seconds=0.5, direction="forward")
    assert "BP" not in asked and part.p["a"][-1] < 0.0 and "max_seconds reached" in part.reasons[1]


def test_an_exploration_is_resumed_where_its_time_was_over(orbit, ticking):
    task = orbit.scene, "frequency", (2.5, 2.9), 1
    whole = jv.explore(*task)
    part = jv.explore(*task, max_seconds=2.5)
    assert not part.complete and part.reason == EXPIRED_REASON == "max_seconds reached"
    again = jv.explore(*task, resume=part)
    assert again.complete and [one.ends for one in again.branches] == [one.ends for one in whole.branches]


@pytest.mark.parametrize(
    "given", [{"max_points": each} for each in (1, 2.5, True, "9", np.ones(2))]
    + [{"max_seconds": each} for each in (0, -1.0, np.nan, np.inf, True, "9", np.ones(2))] + [{"progress": 3}],
)  # fmt: skip
def test_limits_that_cannot_be_are_refused(orbit, given):
    (key,) = given
    calls = (lambda **more: jv.follow(orbit, "frequency", (1.5, 1.7), **more), traced)
    for call, error in zip(calls, (jv.ArgumentError, co.ContinuationError), strict=True):
        with pytest.raises(error) as caught:
            call(**given)
        assert caught.value.key == key and "must be" in caught.value.rule and caught.value.value is given[key]


def test_newton_far_from_its_guess_is_given_up():
    """Flights of an iterate far away may be of any length: a step that would be refused is no longer worked out."""
    count = 0

    def function(z, args):
        nonlocal count
        count += 1
        return jnp.tanh(z[:1]) - z[1:], jnp.array([[1.0 - jnp.tanh(z[0]) ** 2, -1.0]])

    control = StepControl(np.ones(2), 1e-8, 1.0, 1e-12, -9.0, 9.0)
    here = np.array([2.0, np.tanh(2.0)])
    with jax.disable_jit():
        across = TrackState(jnp.array(here), jnp.array([0.0, 1.0]), jnp.array(0.5), 0)  # the branch is flat there
        point, _, _ = correct_step(function, solve_bordered, across, across.step, control, None)
        assert count == 1 and not point.converged
        along = across._replace(tangent=jnp.array([1.0, 1.0 - np.tanh(2.0) ** 2]))
        point, _, _ = correct_step(function, solve_bordered, along, along.step, control, None)
        assert count > 2 and point.converged and abs(np.tanh(point.z[0]) - point.z[1]) < 1e-15
        still = across._replace(step=jnp.array(0.0), z=jnp.array([2.0, 0.9]))  # a point that is looked for has no limit
        assert correct_step(function, solve_bordered, still, still.step, control, None)[0].converged


def test_a_cascade_of_grazings_takes_few_steps(ball, monkeypatch):
    """A ball on a table has ten grazings towards its complete chatter: of each piece a few steps more are attempted
    than points are kept. SN and PD are closed forms (docs: G = pi (1 - R) / (1 + R); PD at G^2 + (2 (1 + R^2) / (1 +
    R)^2)^2; the frequency is the root of G)."""
    steps, track = [], event_search._track_chunk

    def counted(*args):
        found = track(*args)
        steps.append(int((found[1].step != 0).sum()))
        return found

    monkeypatch.setattr(event_search, "_track_chunk", counted)
    branch = jv.follow(ball, "frequency", (1.37, 1.84))
    assert end_names(branch) == ["BOUND"] * 2 and len(branch) > 80
    least = np.pi * 0.85 / 1.15
    known = {"SN": np.sqrt(least), "PD": np.sqrt(np.hypot(least, 2.0 * (1.0 + 0.15**2) / 1.15**2))}
    for kind, value in known.items():
        assert min(abs(one.value - value) for one in branch.points(kind) if one.label == "P110") < 1e-11
    assert sum(steps) < 300  # of 93 points; more where chunks went on to the bound


def test_slow_progress_is_reported():
    points = Point(*[np.zeros((120, 2))] * 2, *[np.full(120, 1e-8)] * 3, *[np.ones(120, bool)] * 2)
    control = StepControl(np.ones(2), 1e-8, 0.1, 1e-10, -1.0, 1.0)
    some = BranchSegment(None, points, None, (), None, -1, 0.0)
    with pytest.warns(SlowProgressWarning, match=r"119 points lie within 0.0e\+00 of the parameter value 0"):
        warn_if_slow(control, some)


def test_a_study_stops_between_chunks_and_a_later_run_goes_on(tmp_path, ticking):
    """No cell of a chunk that was done differs from the whole, and a store is continued."""
    scene = jv.make_scene(3.0, 1.5, 0.1, 0.7, (-1.0, 1.0))
    x, v = np.linspace(-0.9, 0.9, 8), np.linspace(-1.0, 1.0, 8)
    grid, few = {"amplitude": np.linspace(2.0, 3.0, 12)}, {"settle": 5, "patience": 40, "chunk": 3}
    whole = jv.map_parameters(scene, grid, **few, quantities=("label",))
    store = jv.Store(tmp_path / "map.zarr", jv.LocalEngine(workers=1))
    part = jv.map_parameters(scene, grid, **few, quantities=("label",), store=store, max_seconds=1.5)
    done = part["label"].values != -1
    assert 0 < done.sum() < 12 and part.attrs["stopped"] == f"max_seconds reached: {done.sum()} of 12 cells done"
    assert np.array_equal(part["label"].values[done], whole["label"].values[done])
    again = jv.map_parameters(scene, grid, **few, quantities=("label",), store=store)
    assert np.array_equal(again["label"].values, whole["label"].values) and "stopped" not in again.attrs
    for call in (lambda **more: jv.map_parameters(scene, grid, **more), lambda **more: jv.basins(scene, x, v, **more)):
        with pytest.raises(jv.ArgumentError, match="max_seconds: must be a positive number"):
            call(max_seconds=-1.0)
