"""The nearest bifurcations, bifurcations that are placed or searched for: closed forms, edges, bounds, files, plots."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import minimize

import jaxvibro as jv
from continuation.branch_segment import UNLIMITED, Limits
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.design import place
from jaxvibro.design.bifurcation_gradients import FLIP, FOLD, ZERO_SPEED, evaluate_test_gradients
from jaxvibro.design.free_parameters import FreeParameters
from jaxvibro.design.parameter_rays import impact_sequence_of
from jaxvibro.design.special_point_equations import complete_scene, parameter_mask
from jaxvibro.problem.orbit_equations import diagnose
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
FREE = {"amplitude": 0.1, "frequency": 0.05, "damping": 0.01}
FILE = Path(__file__).parents[1] / "scenes" / "margin.toml"


@pytest.fixture(scope="module")
def orbit():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


@pytest.fixture(scope="module")
def near(orbit):
    return jv.margin(orbit, FREE)


def fold(frequency, damping):
    return float(closed.fold(damping, frequency, R, 1.0, symmetric=True).amplitude)


def distance_to_fold(start):
    """The least distance to the fold, and the change of frequency and damping, by another minimiser."""

    def square(change):
        frequency, damping = OMEGA + 0.05 * change[0], GAMMA + 0.01 * change[1]
        return ((fold(frequency, damping) - 2.0) / 0.1) ** 2 + change @ change

    found = minimize(square, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000})
    return np.sqrt(found.fun), found.x


def test_the_nearest_fold_is_that_of_the_closed_form(near):
    assert [point.kind for point in near.points] == ["SB", "SN"] and near.distance == near.points[0].distance
    lines = near.table().splitlines()
    assert lines[0].split() == ["kind", "distance", *FREE, "status"] and lines[1].startswith("SB    9.1")
    point = near.points[1]
    distance, change = distance_to_fold(np.array([4.0, 5.0]))
    assert point.distance == pytest.approx(distance, abs=1e-9) and point.status == "reached"
    assert point.change["frequency"] / 0.05 == pytest.approx(change[0], abs=1e-4)
    assert point.slope < 1e-12 and point.residual < 1e-12
    expected = fold(float(point.scene.frequency), float(point.scene.damping))
    assert float(point.scene.amplitude) == pytest.approx(expected, abs=1e-12)


def test_a_bound_holds_the_nearest_point(orbit):
    free = {"amplitude": 0.1, "frequency": 0.05}
    loose = jv.margin(orbit, free, kinds="SN").points[0]
    low = jv.margin(orbit, free, {"frequency": (2.0, 2.2)}, kinds="SN").points[0]
    assert float(loose.scene.frequency) > 2.25 and low.at_bound == ("frequency",)
    assert float(low.scene.frequency) == 2.2
    assert float(low.scene.amplitude) == pytest.approx(fold(2.2, GAMMA), abs=1e-12)


def test_a_motion_without_impacts_ends_where_it_touches_a_wall():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.5, 1.0))
    orbit = jv.find_orbit(scene, jv.State(-0.58, 0.05))
    (point,) = jv.margin(orbit, {"amplitude": 0.1, "right.position": 0.05}).points
    gain = 1.0 / float(closed.grazing(GAMMA, OMEGA, 1.0))
    normal = np.array([0.1 * gain, -0.05])  # of the line A gain = x, in units of each
    assert point.kind == "GR" and point.sides == (1,)
    assert point.distance == pytest.approx((1.0 - 2.0 * gain) / np.linalg.norm(normal), abs=1e-12)
    assert list(point.direction.values()) == pytest.approx(normal / np.linalg.norm(normal), abs=1e-12)


@pytest.mark.parametrize("case", ["amplitude known", "amplitude free", "amplitude bounded"])
def test_a_doubling_that_ends_on_a_grazing_has_its_nearest_point_there(case):
    """P101 near the resonant grazing; with the amplitude free the end is a line, wall = slope amplitude."""
    amplitude, frequency, place = 3.02, 1.93, 0.79
    orbit = jv.find_orbit(jv.make_scene(amplitude, frequency, 0.032, 0.79, (None, place)), jv.State(-9.66, 9.05))
    damping = np.sqrt(1.0 - (0.5 * frequency) ** 2)
    slope = 1.0 / np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)
    free, bounds, there = {"damping": 0.1, "right.position": 0.2}, {}, amplitude
    if case != "amplitude known":
        free["amplitude"] = 0.5
        there = (place * slope / 0.2**2 + amplitude / 0.5**2) / (slope**2 / 0.2**2 + 1.0 / 0.5**2)
    if case == "amplitude bounded":
        limit = 0.5 * (there + amplitude)
        bounds = {"amplitude": (limit, 4.0) if there < amplitude else (2.0, limit)}
        there = limit
    near = jv.margin(orbit, free, bounds)
    (point,) = (point for point in near.points if point.kind == "PD")
    assert point.edge == "an impact without speed" and point.status == "reached"
    assert "ends there in an impact without speed" in near.table()
    expected = {"damping": damping, "right.position": slope * there, "amplitude": there}
    for name, value in expected.items():
        assert float(point.scene.parameter(name)) == pytest.approx(value, abs=1e-9 if "free" in case else 1e-11)
    start = {"damping": 0.032, "right.position": place, "amplitude": amplitude}
    offset = [(expected[name] - start[name]) / unit for name, unit in free.items()]
    assert point.distance == pytest.approx(np.linalg.norm(offset), abs=1e-9)
    assert point.at_bound == (("amplitude",) if bounds else ())


@pytest.mark.parametrize(
    "amplitude, frequency, times",
    [
        (0.7233604331, 1.1749217932, (2.2598981, 4.9738107, 11.1848721)),
        (0.7432175560, 1.1773081508, (2.6730035, 5.1108067, 11.0407840)),
    ],
)
def test_the_tip_of_a_cusp_is_nearest_from_beside_it(amplitude, frequency, times):
    """P212, from either side of the cusp of test_locus.py."""
    scene = jv.make_scene(amplitude, frequency, 0.02, 0.9, (-1.5, 1.0))
    found = jv.solve_orbits(scene, (np.array(times), np.array([0.73, 0.95, 1.52])), ("", "LRR"))
    orbit = jv.find_orbit(scene, jv.State(float(found.state.x), float(found.state.v)), 2, settle=0)
    unit = 0.01
    near = jv.margin(orbit, {"amplitude": unit, "frequency": unit}, kinds="SN", directions=32)
    (point,) = near.points
    tip = 0.732811723456128, 1.180086394958394
    assert point.edge == "a cusp" and point.status == "reached"
    assert [float(point.scene.amplitude), float(point.scene.frequency)] == pytest.approx(tip, abs=1e-11)
    assert point.distance == pytest.approx(np.hypot(tip[0] - amplitude, tip[1] - frequency) / unit, abs=1e-9)


@pytest.fixture(scope="module")
def fold_point(orbit):
    return jv.follow(orbit, "amplitude", (0.0, 3.0)).points("SN")[0]


def test_a_fold_is_placed_by_the_least_change(fold_point):
    free = {"damping": 0.05, "frequency": 0.1}
    placed = jv.place(fold_point, "amplitude", 0.6, free)
    frequency, damping = float(placed.scene.frequency), float(placed.scene.damping)
    assert placed.met and fold(frequency, damping) == pytest.approx(0.6, abs=1e-13) and placed.slope < 1e-12
    step = 1e-6
    normal = [
        0.05 * (fold(frequency, damping + step) - fold(frequency, damping - step)),
        0.1 * (fold(frequency + step, damping) - fold(frequency - step, damping)),
    ]
    change = [placed.change["damping"] / 0.05, placed.change["frequency"] / 0.1]
    assert abs(normal[0] * change[1] - normal[1] * change[0]) < 1e-8 * np.linalg.norm(normal)
    bounded = jv.place(fold_point, "amplitude", 0.6, free, {"damping": (0.0, 0.06)})
    assert bounded.met and bounded.at_bound == ("damping",)
    assert float(bounded.scene.damping) == pytest.approx(0.06) and bounded.values[0] == pytest.approx(0.6, abs=1e-12)
    stopped = jv.place(fold_point, "amplitude", 2.0, {"damping": 0.05}, {"damping": (0.0, 0.06)})
    assert not stopped.met and "damping is at a bound" in stopped.why
    assert 0.057 < float(stopped.scene.damping) <= 0.06 and stopped.at_bound == ("damping",)
    assert stopped.values[0] == pytest.approx(fold(OMEGA, float(stopped.scene.damping)), abs=1e-12)


def asked(is_virtual, bound=np.inf):
    """A placement of one number whose change is the value; the orbit is impossible at some changes."""

    def values_and_slopes(changes):
        return changes.copy(), np.ones((len(changes), 1, 1))

    def impossible(change):
        return ["SN"] if is_virtual(float(change[0])) else []

    zero = np.zeros(1)
    scene = jv.make_scene(1.5, 1.7, 0.12, 0.6, (None, 0.8))
    parameters = FreeParameters(scene, {"damping": 1.0}, zero - np.inf, zero + bound)
    return place._PlacementProblem(parameters, values_and_slopes, impossible)


@pytest.mark.parametrize(
    "low, high, bound, fraction, why",
    [
        (0.003, np.inf, np.inf, 0.003, "the orbit of the SN passes through a wall beyond it"),
        (0.75, np.inf, np.inf, 0.75, "the orbit of the SN passes through a wall beyond it"),
        (0.999, np.inf, np.inf, 0.999, "the orbit of the SN passes through a wall beyond it"),
        (0.3, 0.6, np.inf, 1.0, ""),
        (2.0, 2.0, 0.4, 0.4, "damping is at a bound"),
    ],
)
def test_the_way_to_a_target_ends_at_the_last_possible_orbit(low, high, bound, fraction, why):
    problem = asked(lambda change: low < change < high, bound)
    last, held, kinds = place._follow_path_to_targets(problem, np.ones(1), UNLIMITED)
    assert fraction - 1.0 / 256.0 < last.fraction <= fraction
    assert last.change[0] == pytest.approx(last.fraction, abs=1e-12)
    assert held.any() == (bound < 1.0)
    reason = place._failure_reason(last.fraction, kinds, ("damping",) if held.any() else (), last.is_time_expired)
    assert why in reason and bool(why) == bool(reason)


def test_a_way_that_ends_by_the_clock_is_at_no_bound_that_was_only_tried():
    readings = iter([0.0, 2.0])  # the first attempt needs a change of 1, which the bound forbids
    limits = Limits(deadline=1.0, read_clock=lambda: next(readings))
    last, held, kinds = place._follow_path_to_targets(asked(lambda change: False, 0.4), np.ones(1), limits)
    assert (last.fraction, last.is_time_expired, held.tolist(), kinds) == (0.0, True, [False], [])


SEARCHED = {"amplitude": (0.9, 1.9), "frequency": (1.5, 1.9)}
SEARCH_UNITS = {"amplitude": 0.5, "frequency": 0.2}


@pytest.fixture(scope="module")
def one_wall():
    return jv.make_scene(1.5, 1.7, 0.12, 0.6, (None, 0.8))


def test_a_search_meets_a_known_boundary(one_wall):
    def grazing(scene):
        frequency, damping = float(scene.frequency), float(scene.damping)
        return float(scene.right.position) * np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)

    found = jv.search(one_wall, "GR", SEARCH_UNITS, SEARCHED, starts=60, max_period=1)
    (free,) = (point for point in found.points if point.label == "P100")
    assert free.kind == "GR"
    assert float(free.scene.amplitude) == pytest.approx(grazing(free.scene), abs=1e-12)
    for point, distance in zip(found.points, found.distances, strict=True):
        values = {name: float(point.scene.parameter(name)) for name in SEARCHED}
        apart = [(values[name] - float(one_wall.parameter(name))) / unit for name, unit in SEARCH_UNITS.items()]
        assert distance == pytest.approx(np.linalg.norm(apart), rel=1e-12)
        assert all(low <= values[name] <= high for name, (low, high) in SEARCHED.items())
    assert list(found.distances) == sorted(found.distances)
    assert found.starts == 60 and 0 < found.settled <= 60 and found.followed >= sum(found.met)
    assert "60 random scenes" in found.table() and "GR" in found.table()
    assert float(jv.located(free, "amplitude")(one_wall)) == pytest.approx(grazing(one_wall), abs=1e-12)


def test_a_search_that_finds_nothing_says_how_far_it_looked(one_wall):
    near = {"amplitude": (1.49, 1.51), "frequency": (1.69, 1.71)}
    found = jv.search(one_wall, ["PD", "SB"], SEARCH_UNITS, near, starts=8, max_period=1)
    assert found.points == () and found.table().startswith("nothing found\n8 random scenes, ")


def test_the_derivatives_that_a_search_aims_by():
    """Of the tests of fold, doubling and grazing: differences of orbits that are found anew."""
    scene = jv.make_scene(2.3, 2.15, 0.07, 0.75, (-1.1, jv.Wall(0.9, 0.6)))
    orbit, names, step = jv.find_orbit(scene, jv.State(0.8, -1.2)), ("amplitude", "right.position"), 1e-5
    numbers, units = complete_scene(scene), np.stack([parameter_mask(scene, name) * 0.1 for name in names])
    rows = np.stack([np.asarray(leaf) for leaf in jax.tree.leaves(numbers)])
    given = jax.tree.map(lambda leaf: np.asarray(leaf)[None], impact_sequence_of(orbit))
    tests, slopes = evaluate_test_gradients(jax.tree.structure(numbers), given, rows[None], units)

    def tests_of(scene):
        along, z = polish_orbit(jv.find_orbit(scene, jv.State(0.8, -1.2)), "amplitude")
        found, speeds = diagnose(along, z[None]), along.impact_rows + len(along.sequence.sides)
        return np.array([found.fold_test[0], found.flip_test[0], z[speeds].min()])

    chosen = [FOLD, FLIP, ZERO_SPEED]
    assert np.asarray(tests)[0, chosen] == pytest.approx(tests_of(scene), rel=1e-9)
    for k, name in enumerate(names):
        value = float(scene.parameter(name))
        up, down = (tests_of(scene.replace(**{name: value + way})) for way in (step, -step))
        assert np.asarray(slopes)[0, chosen, k] == pytest.approx(0.1 * (up - down) / (2.0 * step), rel=1e-5), name


def test_bad_arguments(orbit, fold_point, one_wall):
    for free, bounds, message in (
        ({}, None, "free: must be {name: unit}"),
        ({"amplitude": 0.0}, None, "free.amplitude: must be a positive number"),
        ({"mass": 1.0}, None, "mass"),
        ({"amplitude": 1.0}, {"damping": (0.0, 1.0)}, "bounds.damping: must belong to a free parameter"),
        ({"amplitude": 1.0}, {"amplitude": (3.0, 4.0)}, "bounds.amplitude: must be .* the value of the scene, 2"),
    ):
        with pytest.raises(jv.ArgumentError, match=message):
            jv.margin(orbit, free, bounds)
    for target, name, message in (
        (0.6, "amplitude", "free.amplitude: must not be a parameter that is placed"),
        (np.nan, "damping", "target: must be a finite number"),
        ([0.6, 0.7], "damping", "target: must be a finite number for each of 1"),
    ):
        with pytest.raises(jv.ArgumentError, match=message):
            jv.place(fold_point, "amplitude", target, {name: 1.0})
    outside = SEARCHED | {"frequency": (1.8, 1.9)}
    for kind, units, bounds, options, message in (
        ("HB", SEARCH_UNITS, SEARCHED, {}, "kinds: must be one or more of SN, SB, PD, GR"),
        ("PD", SEARCH_UNITS, {"frequency": (1.5, 1.9)}, {}, "bounds.amplitude: must be given"),
        ("PD", SEARCH_UNITS, outside, {}, "bounds.frequency: must be .* contain the value of the scene, 1.7"),
        ("PD", {"amplitude": 0.0}, SEARCHED, {}, "free.amplitude: must be a positive number"),
        ("PD", SEARCH_UNITS, SEARCHED, {"max_period": 0}, "max_period: "),
    ):
        with pytest.raises(jv.ArgumentError, match=f"^{message}"):
            jv.search(one_wall, kind, units, bounds, **options)


def test_a_run_writes_what_margin_finds(tmp_path):
    ran = jv.run(FILE, tmp_path)
    orbit = jv.find_orbit(jv.load_scene(FILE), jv.State(0.9, -1.1))
    near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.05, "right.position": 0.02})
    assert near.table() in ran.table
    written = ran.summary["margin"]
    assert [row["kind"] for row in written] == [point.kind for point in near.points]
    assert [row["distance"] for row in written] == [point.distance for point in near.points]
    data = jv.load_data(tmp_path / "margin.nc")
    assert data["free"].values.tolist() == list(near.free) and data["free_unit"].values.tolist() == [0.1, 0.05, 0.02]
    for k, point in enumerate(near.points):
        assert data["near_kind"].values[k] == point.kind and data["near_status"].values[k] == point.status
        assert data["near_change"].values[k].tolist() == [point.change[name] for name in near.free]
    assert {path.name for path in tmp_path.iterdir()} == {
        f"margin{end}" for end in (".png", ".nc", ".txt", ".margin.png")
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("free={amplitude=-1.0}", r"free.amplitude: must be a positive number"),
        ("free={size=1.0}", r"size: "),
        ("bounds={damping=[0.0,1.0]}", r"bounds.damping: must belong to a free parameter"),
        (
            "bounds={amplitude=[2.0,3.0]}",
            r"bounds.amplitude: must be \(low, high\) and contain the value of the scene, 1",
        ),
        ("kinds=['HB']", r"kinds\[0\]: must be one of SN, PD, SB, GR"),
        ("directions=3", r"directions: "),
        ("start={x=2.0,v=0.0}", r"start.x: must lie between the walls"),
        ("at={frequency=-1.0}", r"at.frequency: "),
    ],
)
def test_bad_tables_of_a_file(tmp_path, change, message):
    with pytest.raises(jv.SceneError, match=f"^margin.{message}"):
        jv.run(FILE, tmp_path, [f"margin.{change}"])
    assert not list(tmp_path.iterdir())


def made_up(orbit, free):
    """A margin of two made-up points: drawing asks for no more."""
    points = []
    for k, (kind, status) in enumerate((("SB", "reached"), ("SN", "behind another"))):
        change = {name: (0.5 + k) * unit * (-1) ** j for j, (name, unit) in enumerate(free.items())}
        scene = orbit.scene.replace(**{name: float(orbit.scene.parameter(name)) + by for name, by in change.items()})
        blank, distance = np.zeros(0), (0.5 + k) * len(free) ** 0.5
        point = jv.NearPoint(kind, distance, change, change, scene, blank, blank, (), 0.0, 0.0, status, ())
        points.append(point)
    return jv.Margin(orbit, free, tuple(points), (), (4.0, 8))


def test_a_margin_of_two_numbers_is_drawn_as_a_plane(orbit):
    margin = made_up(orbit, {"amplitude": 0.2, "frequency": 0.05})
    ax = jv.plot.margin(margin)
    lines = {line.get_label(): np.ravel(line.get_data()) for line in ax.lines if not line.get_label().startswith("_")}
    assert lines["P111"] == pytest.approx([2.0, 2.1])
    assert lines["SB: symmetry breaking"] == pytest.approx([2.1, 2.075])
    assert lines["SN: saddle-node, behind another"] == pytest.approx([2.3, 2.025])
    (ring,) = ax.patches
    assert (ring.width, ring.height) == pytest.approx((2 * 0.2 * margin.distance, 2 * 0.05 * margin.distance))
    styles = [line.get_linestyle() for line in ax.lines if line.get_label().startswith("_")]
    assert styles == ["-", ":"]
    assert "amplitude" in ax.get_xlabel() and "frequency" in ax.get_ylabel()
    empty = jv.plot.margin(jv.Margin(orbit, margin.free, (), (), (4.0, 8)))
    assert not empty.patches
    for drawn in (ax, empty):
        plt.close(drawn.figure)
    with pytest.raises(jv.ArgumentError, match=r"^plot.margin: must be given a Margin"):
        jv.plot.margin("near")


@pytest.mark.parametrize("free", [{"damping": 0.01}, {"amplitude": 0.2, "damping": 0.01, "right.position": 0.02}])
def test_a_margin_of_other_counts_is_drawn_as_changes_in_units(orbit, free):
    margin = made_up(orbit, free)
    fig, ax = plt.subplots()
    assert jv.plot.margin(margin, ax) is ax
    lines = [line for line in ax.lines if not line.get_label().startswith("_")]
    for line, (name, unit) in zip(lines, free.items(), strict=True):
        assert line.get_ydata() == pytest.approx([point.change[name] / unit for point in margin.points])
        assert line.get_label() == f"{name}, unit {unit:g}"
    assert [tick.get_text().split(":")[0] for tick in ax.get_xticklabels()] == ["SB", "SN"]
    plt.close(fig)
