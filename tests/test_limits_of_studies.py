"""Limits of time of the studies: what is done is what a whole run gives, the rest is blank, and the reason is given."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci.loci_of_branches import follow_loci

from .scene_files import SCENE

START = jv.State(0.3, 0.1)


def scene(**changes):
    return jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0)).replace(**changes)


@pytest.fixture
def ticking(monkeypatch):
    """Return a function that makes the clock a second later each time that it is read, from then on."""

    def start():
        read = iter(range(1_000_000))
        monkeypatch.setattr("continuation.branch_segment.clock", lambda: float(next(read)))

    return start


def test_fractions_stop_between_values(ticking, monkeypatch):
    monkeypatch.setattr(
        "jaxvibro.surveys.fractions._compute_shock_size", lambda *given: 0.5
    )  # `least_shock` has its own test
    values = [4.6, 4.65, 4.7]
    whole = jv.fractions(scene(), "amplitude", values[:2], 2, settle=100, shocks=8)
    ticking()
    part = jv.fractions(scene(), "amplitude", values, 2, settle=100, max_seconds=1.5)
    assert part.attrs["stopped"] == "max_seconds reached: 2 of 3 values done"
    for key in part.data_vars:
        assert part[key].dtype == whole[key].dtype
        np.testing.assert_array_equal(part[key].values[:2], whole[key].values)
    assert np.isnan(part["share"].values[2]).all() and (part["label"].values[2] == "").all() and part["status"][2] == -1
    assert part["amplitude"].attrs == whole["amplitude"].attrs and part["amplitude"].values.tolist() == values
    ticking()
    part = jv.fractions(scene(), "amplitude", values[:2], 2, settle=100, shocks=8, max_seconds=2.5)
    assert part.attrs["stopped"] == "max_seconds reached: 1 of 2 values done"
    np.testing.assert_array_equal(part["least_shock"].values[0], whole["least_shock"].values[0])
    assert np.isnan(part["least_shock"].values[1]).all()


def test_the_least_shock_of_the_phases_that_are_done(ticking):
    attractors = jv.find_attractors(scene(), starts=60)
    few = {"shocks": 64, "phase": [0.0, 1.0]}
    whole = jv.least_shock(scene(), attractors, **few)
    assert not whole.stopped
    ticking()
    part = jv.least_shock(scene(), attractors, **few, max_seconds=0.5)
    assert part.stopped == "max_seconds reached: 0 of 2 phases done" and part.stopped in part.table()
    assert whole.size <= part.size < part.reach and np.isnan(part.by_phase["size"].values[1])
    assert part.safe == whole.safe and part.phase == 0.0 and part.below < whole.below
    ticking()
    assert jv.least_shock(scene(), attractors, **few, max_seconds=1e9).size == whole.size


def test_starts_that_have_not_settled_in_time_are_unresolved(ticking):
    whole = jv.find_attractors(scene(), 8, settle=5)
    assert whole.stopped == "" and isinstance(whole, tuple)
    ticking()
    part = jv.find_attractors(scene(), 8, settle=5, max_seconds=0.5)
    assert part.stopped == "max_seconds reached: 0 of 8 starts done"
    assert [(one.label, one.share, one.note) for one in part] == [("unresolved", 1.0, "8 starts: max_seconds reached")]
    ticking()
    most = jv.find_attractors(scene(), 8, settle=5, max_seconds=1e3)
    assert most.stopped == "" and [one.label for one in most] == [one.label for one in whole]


def empty(reason, amplitude=1.0):
    """A diagram without branches."""
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    return jv.Diagram("frequency", (1.0, 2.0), scene(amplitude=amplitude), (), (), True, reason, settings)


def test_isolas_stop_between_orders_of_walls(ticking, monkeypatch):
    monkeypatch.setattr("jaxvibro.branches.isolas._solve_wall_order", lambda *given: ())
    counts = []
    whole = jv.find_isolas(empty("all"), 1, 3, progress=counts.append)
    assert whole == () and whole.stopped == "" and counts[-1] == 9
    ticking()
    part = jv.find_isolas(empty("all"), 1, 3, max_seconds=2.5, progress=counts.append)
    assert part == () and part.stopped == "max_seconds reached: 2 orders of walls done" and counts[-1] == 2


def test_diagrams_in_a_store_stop_between_values(tmp_path, ticking, monkeypatch):
    monkeypatch.setattr("jaxvibro.branches.diagram_family.seed_orbits_of_requests", lambda tasks: [()])
    explored = "jaxvibro.branches.diagram_family.run_exploration"
    monkeypatch.setattr(explored, lambda task, some: empty("all", float(task.scene.amplitude)))
    task = scene(), "frequency", (1.0, 2.0), "amplitude", [1.0, 2.0, 3.0]
    store = jv.Store(tmp_path / "diagrams", jv.LocalEngine(workers=1))
    ticking()
    part = jv.diagrams(*task, store=store, max_seconds=2.5)
    late = [one for one in part if one.reason == "max_seconds reached"]
    assert 0 < len(late) < 3 == len(part) and not any(one.complete or one.branches for one in late)
    assert part.stopped == f"max_seconds reached: {3 - len(late)} of 3 values done"
    assert [float(one.scene.amplitude) for one in part] == [1.0, 2.0, 3.0]
    again = jv.diagrams(*task, store=store)
    assert again.stopped == "" and [one.reason for one in again] == ["all"] * 3
    with pytest.raises(jv.ArgumentError, match="max_points"):
        jv.diagrams(*task, store=store, max_points=1)
    with pytest.raises(jv.ArgumentError, match="differs"):
        jv.diagrams(*task, store=store, max_points=50)


@pytest.fixture(scope="module")
def fold():
    orbit = jv.find_orbit(scene(amplitude=2.0), jv.State(0.9, -1.1))
    return jv.follow(orbit, "amplitude", (0.0, 6.0)).points("SN")[0]


def assert_no_negative_time(function, *given):
    with pytest.raises(jv.ArgumentError, match="max_seconds: must be a positive number"):
        function(*given, max_seconds=-1.0)


def test_negative_times_are_refused():
    assert_no_negative_time(jv.find_isolas, empty("all"))
    assert_no_negative_time(jv.diagrams, scene(), "frequency", (1.0, 2.0), "amplitude", [1.0])
    assert_no_negative_time(jv.search, scene(), "GR", {"damping": 0.1}, {})
    assert_no_negative_time(jv.place, lambda scene: scene.damping, None, 1.0, {})


@pytest.mark.parametrize(("seconds", "fraction"), [(0.5, 0), (3.5, 0.25)])
def test_a_placement_stops_between_steps(ticking, seconds, fraction):
    """The value is the free parameter itself, which may change by 0.4 of the distance: steps of 1, 0.5 and 0.25."""
    task = {"free": {"damping": 1.0}, "bounds": {"damping": (0.01, 0.45)}, "scene": scene()}
    ticking()
    part = jv.place(lambda scene: scene.damping, None, 1.05, **task, max_seconds=seconds)
    assert not part.met and part.distance == fraction
    assert part.why == f"the path to the targets ends after {fraction} of its length: max_seconds reached"


def test_loci_of_a_family_stop_in_time(fold, ticking):
    task = fold, ("amplitude", "frequency"), {"amplitude": (0.0, 8.0), "frequency": (1.8, 2.4)}, "damping"
    assert_no_negative_time(jv.family, *task, [0.05])
    whole = jv.family(*task, [0.05, 0.06])
    assert whole.stopped == "" and all(len(one) > 12 for one in whole)
    few = jv.family(*task, [0.05, 0.06], max_points=9)
    assert [len(one) for one in few] == [9, 9] and few.stopped == ""
    for one, other in zip(few, whole, strict=True):
        places = [np.flatnonzero((abs(other.values - each) < 1e-9).all(axis=1))[0] for each in one.values]
        assert np.diff(places).tolist() == [1] * 8
    ticking()
    part = jv.family(*task, [0.05, 0.06], 5e-4, 1e-3, max_seconds=0.5)
    assert part.stopped == "max_seconds reached: 0 of 2 values done"
    assert part[0].reasons == ("max_seconds reached",) * 2 and len(part[0]) > 2
    assert part[1] is None or part[1].reasons == part[0].reasons


def test_search_and_margin_stop_between_rays(ticking):
    one_wall = jv.make_scene(1.5, 1.7, 0.12, 0.6, (None, 0.8))
    free, bounds = {"amplitude": 0.5, "frequency": 0.2}, {"amplitude": (0.9, 1.9), "frequency": (1.5, 1.9)}
    task = one_wall, "GR", free, bounds, 60, 1
    whole = jv.search(*task)
    assert whole.stopped == "" and whole.points
    followed = []
    for most in (0.5, 1.5, 3.5):
        ticking()
        part = jv.search(*task, max_seconds=most)
        assert part.stopped.startswith(f"max_seconds reached: {part.followed} rays") and part.stopped in part.table()
        assert len(part.points) < len(whole.points)
        followed.append(part.followed)
    assert followed[0] == 0 < followed[1] < followed[2] <= whole.followed
    orbit = jv.find_orbit(one_wall, jv.State(0.1, 0.2))
    assert_no_negative_time(jv.margin, orbit, free)
    near = jv.margin(orbit, free)
    assert near.stopped == "" and near.points
    ticking()
    part = jv.margin(orbit, free, max_seconds=1.5)
    assert part.stopped.startswith("max_seconds reached: 1 of ") and part.stopped in part.table()
    assert len(part.points + part.others) <= 1


def test_period_adding_stops_between_windows(ticking):
    orbit = jv.find_orbit(jv.make_scene(6.0, 2.1, 1.2, 0.7, (None, 1.0)), jv.State(0.0, 0.0))
    (grazing,) = jv.follow(orbit, "amplitude", (6.0, 6.2), stop="GR").points("GR")
    assert_no_negative_time(jv.period_adding, grazing)
    whole = jv.period_adding(grazing, 4)
    ticking()
    part = jv.period_adding(grazing, 4, max_seconds=1.5)
    assert part.stopped == "max_seconds reached: 1 of 3 windows done" and part.stopped in part.table()
    assert whole.stopped == "" and len(whole.windows) == 3 and part.windows[0].found == whole.windows[0].found


def test_a_manifold_stops_between_images(ticking):
    found = jv.find_orbits(scene(), 1, 64)
    saddle = next(one for one in found if one.label == "P111" and one.multipliers[0].real > 1)
    whole = jv.manifold(saddle, "unstable", 6.0, 0.0)
    ticking()
    part = jv.manifold(saddle, "unstable", 6.0, 0.0, max_seconds=2.5)
    assert part.attrs["stopped"] == "max_seconds reached: 0 of 2 sides done" and "stopped" not in whole.attrs
    for side in (-1, 1):
        mine, other = (each.sel(point=each["side"] == side) for each in (part, whole))
        assert 0 < mine.sizes["point"] < other.sizes["point"] and mine["image"].max() < other["image"].max()
        np.testing.assert_array_equal(mine["x"].values, other["x"].values[: mine.sizes["point"]])
    assert set(part["ended"].values.tolist()) >= {"max_seconds"}


def test_a_sweep_of_a_scene_file_stops_between_chunks(tmp_path, ticking):
    leg = '{name = "up", from = 4.5, to = 4.9, start = {x = 0.3, v = 0.1}}'
    table = f'parameter = "amplitude"\ncount = 40\nsettle = 3\nkeep = 2\nlegs = [{leg}]\nmax_seconds = 1.5\n'
    (tmp_path / "sweep.toml").write_text(f"{SCENE}\n[sweep]\n{table}")
    ticking()
    done = jv.run(tmp_path / "sweep.toml", tmp_path)
    assert "max_seconds reached: 32 of 40 values done" in done.table
    assert jv.load_data(tmp_path / "sweep.nc").sizes["step"] == 32


def test_loci_that_are_not_done_are_listed(ticking, monkeypatch):
    points = [SimpleNamespace(kind="SN", scene=scene(amplitude=each)) for each in (1.0, 2.0, 3.0)]
    given = []
    home = "jaxvibro.loci.loci_of_branches"
    monkeypatch.setattr(f"{home}.locus", lambda one, *rest, **more: given.append(more["max_seconds"]) or one)
    monkeypatch.setattr(f"{home}.passes_through_special", lambda *both: False)
    task = [SimpleNamespace(special=points)], ("amplitude", "damping"), {"amplitude": (0.0, 9.0), "damping": (0.0, 1.0)}
    ticking()
    found, refused = follow_loci(*task, max_seconds=3.5)
    assert list(found) == points[:2] and refused == ((points[2], "max_seconds reached"),) and given == [1.5, 1e-9]
    found, refused = follow_loci(*task)
    assert list(found) == points and refused == () and given[2:] == [None] * 3
