"""Properties of branches of orbits that hold for every kind of scene."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import jaxvibro as jv
from tests.kinds import LANES
from tests.special_points import completion_value, reference_error, zero_force_value
from tests.tiers import of_numbers

from .branches import (
    FAILURES,
    assert_same_points,
    bounds_of,
    branch_of,
    branch_with,
    end_names,
    is_on,
    is_whole,
    parameter,
    significant,
    switched_branches,
)
from .orbits import MOST_PERIODS, Simulation, assert_is_orbit, settled_orbit, size_of

REFERENCE_KINDS = "one_wall", "two_walls", "moving_walls", "inelastic"


def _tolerance(kind):
    """Return the allowed error of a special point: a grazing of a soft wall is known from a square root away."""
    return 1e-9 if kind.exact else 1e-7


@of_numbers
def test_points(kind, number):
    """The points of a branch are orbits: of their segment's label, with their row's multipliers, between the walls."""
    branch, checked = branch_of(kind, number), 0
    places = _regular_places(branch, LANES if number < 3 else len(branch))
    for group in (places[k : k + LANES] for k in range(0, len(places), LANES)):
        orbits = [branch.orbit(place) for place in group]
        simulation = Simulation(kind, orbits)
        for lane, (place, orbit) in enumerate(zip(group, orbits, strict=True)):
            segment = next(part for part in branch.segments if part.first <= place <= part.last)
            assert orbit.label == segment.label and float(orbit.scene.parameter(branch.name)) == branch.values[place]
            difference = abs(orbit.multipliers - branch.multipliers[place]).max()
            assert difference < 1e-4 * (1.0 + abs(orbit.multipliers[0]))
            assert branch.stable[place] == orbit.stable and orbit.least_clearance > -1e-9 * size_of(orbit)
            checked += assert_is_orbit(orbit, simulation, lane, max(kind.tolerance, 1e-12))
    assert checked >= 1


def _regular_places(branch, count):
    """Return so many indices of points of a branch that are not special and have finite multipliers."""
    special = {point.place for point in branch.special if point.kind != "EP"}
    finite = np.isfinite(branch.multipliers).all(axis=1)
    places = np.unique(np.linspace(0, len(branch) - 1, count).astype(int))
    return [int(place) for place in places if place not in special and finite[place]]


@of_numbers
def test_ends(kind, number):
    """A branch stays within its bounds, its special points are in order, and it ends where it says."""
    branch = branch_of(kind, number)
    low, high = branch.bounds
    assert not FAILURES & set(end_names(branch))
    assert low <= branch.values.min() and branch.values.max() <= high
    places = [point.place for point in branch.special]
    assert places == sorted(places) and {0, len(branch) - 1} <= set(places)
    assert all(point.value == branch.values[point.place] for point in branch.special)
    assert [part.first for part in branch.segments[1:]] == [part.last + 1 for part in branch.segments[:-1]]
    assert (branch.segments[0].first, branch.segments[-1].last) == (0, len(branch) - 1)
    for end, reason, value in zip(end_names(branch), branch.reasons, branch.values[[0, -1]], strict=True):
        if end == "BOUND":
            assert value in (low, high)
        if end == "DOMAIN":
            assert value == 0.0
        if end not in ("CLOSED", "START"):
            assert f"{value:.12g}" in reason
    if "CLOSED" in end_names(branch):
        speeds = [np.sort(branch.orbit(place).impacts.speed) for place in (0, len(branch) - 1)]
        np.testing.assert_allclose(*speeds, rtol=0, atol=1e-8)


@of_numbers
def test_special_points(kind, number):
    """Each special point has the property that its name says, and the value of the high-precision reference."""
    branch = branch_with(kind, number, ("SN", "PD", "GR", "CH", "RL"))
    special = {point.place for point in branch.special}
    unstable = (abs(branch.multipliers) > 1.0).sum(axis=1)
    for point in significant(branch):
        size = 1.0 + abs(point.value)
        assert point.residual < 1e-8 * size
        if point.kind in ("SN", "SB", "BP", "PD"):
            target = -1.0 if point.kind == "PD" else 1.0
            matrix = np.asarray(jv.monodromy(point.scene, point.orbit.state, point.orbit.periods))
            (a, b), (c, d) = matrix
            terms = 1.0, -target * a, -target * d, a * d, -b * c
            assert abs(sum(terms)) < 1e-6 * sum(map(abs, terms))
            assert abs(point.multipliers - target).min() < 1e-5 * (1.0 + abs(point.multipliers[0]))
            beside = point.place - 1, point.place + 1
            if not special & set(beside):
                assert abs(int(unstable[beside[0]]) - int(unstable[beside[1]])) == 1
        if point.kind == "GR":
            slowest = min(point.spot.speeds.tolist(), default=np.inf)
            clearance = abs(point.orbit.least_clearance)
            assert min(slowest, clearance) < 1e-6 * size_of(point.orbit)
            _assert_orbits_meet(kind, point)
        if kind.name not in REFERENCE_KINDS or (point.orbit.rests and point.kind == "GR"):
            continue
        if point.kind in ("SN", "SB", "BP", "PD", "GR"):
            assert reference_error(point) < 1e-10 * size
    if kind.name in REFERENCE_KINDS and branch.name == "amplitude":
        for point in (*branch.points("CH"), *branch.points("RL")):
            expected = zero_force_value(point)
            if expected is None and point.kind == "CH":
                expected = completion_value(point)
            assert expected is None or abs(point.value - expected) < 1e-11 * (1.0 + abs(point.value))


def _assert_orbits_meet(kind, point):
    """Check that the orbits beside a grazing are orbits, and close to it."""
    orbits = [orbit for orbit in point.meets if orbit.impacts.count <= LANES][:LANES]
    if orbits:
        simulation = Simulation(kind, orbits)
        for lane, orbit in enumerate(orbits):
            assert abs(float(orbit.scene.parameter(point.name)) - point.value) < 0.1 * (1.0 + abs(point.value))
            assert_is_orbit(orbit, simulation, lane, max(kind.tolerance, 1e-11))


@of_numbers
def test_return(kind, number):
    """Followed back from its last point with other steps, a branch has the same special points and ends."""
    branch = branch_of(kind, number)
    if not is_whole(branch):
        return
    special = {point.place for point in branch.special if point.kind != "EP"}
    place = max({len(branch) - 1, len(branch) - 2, 0} - special)
    back = jv.follow(branch.orbit(place), branch.name, branch.bounds, largest_step=0.07)
    assert_same_points(branch, back, _tolerance(kind))
    if not {"CLOSED", "HALVED", "GRAZE"} & {*end_names(branch), *end_names(back)}:
        assert sorted(end_names(back)) == sorted(end_names(branch))
        assert sorted(back.values[[0, -1]]) == sorted(branch.values[[0, -1]])


@of_numbers
def test_extension(kind, number):
    """A branch within narrow bounds, extended, is the branch followed at once; extended by nothing, itself."""
    branch, orbit, name = branch_of(kind, number), settled_orbit(kind, number), parameter(kind, number)
    if not is_whole(branch):
        return
    narrow = jv.follow(orbit, name, bounds_of(orbit.scene, name, 0.3))
    wide = jv.extend(narrow, branch.bounds)
    assert wide.bounds == branch.bounds and wide.scene.numbers == narrow.scene.numbers
    assert_same_points(branch, wide, _tolerance(kind))
    assert set(wide.ends) == set(branch.ends)
    same = jv.extend(wide, branch.bounds)
    assert len(same) == len(wide) and same.reasons == wide.reasons
    rows = [wide.data[key].fillna(0.0).values for key in ("time", "speed")] + [wide.values[:, None]]
    apart = abs(np.diff(np.concatenate(rows, axis=1), axis=0)).max(axis=1)
    assert (apart[np.diff(wide.data["segment"]) == 0] > 1e-10).all()


@of_numbers
def test_file(kind, number):
    """A branch that is saved and loaded is the same branch."""
    branch = branch_of(kind, number)
    with TemporaryDirectory() as folder:
        branch.save(Path(folder) / "branch.nc")
        loaded = jv.load_branch(Path(folder) / "branch.nc")
    assert loaded.table() == branch.table() and loaded.segments == branch.segments
    assert loaded.data.identical(branch.data.assign_attrs(loaded.data.attrs)) and loaded.ends == branch.ends
    place = len(branch) // 2
    assert repr(loaded.orbit(place).state) == repr(branch.orbit(place).state)


@of_numbers
def test_switch(kind, number):
    """A branch that leaves a PD or SB begins at it, on the side of the normal form, and leads back to it."""
    for point, branches in switched_branches(kind, number):
        form = point.normal_form
        assert len(branches) == (1 if point.kind == "PD" else 2)
        for branch in branches:
            assert abs(branch.values[0] - point.value) < 1e-8 * (1.0 + abs(point.value))
            assert end_names(branch)[0] == "LEFT" and point.kind in branch.reasons[0]
            if len(branch) < 4:
                continue
            gaps = branch.values - point.value
            first = int(np.argmax(abs(gaps) > 1e-9 * (1.0 + abs(point.value))))
            assert form is None or np.sign(gaps[first]) == form.side
            assert form is None or branch.stable[first] == (form.criticality == "supercritical")
            orbit = branch.orbit(3)
            assert orbit.periods == point.orbit.periods * (2 if point.kind == "PD" else 1)
            back = jv.follow(orbit, point.name, branch.bounds)
            values = [
                value for value, end in zip(back.values[[0, -1]], end_names(back), strict=True) if end == "HALVED"
            ]
            values += [other.value for other in back.points("SB")]
            assert min(abs(value - point.value) for value in values) < 1e-6 * (1.0 + abs(point.value))


@of_numbers
def test_diagram(kind, number):
    """The periodic attractors that random starts settle on lie on the branches of `explore`."""
    orbit, checked = settled_orbit(kind, number), 0
    bounds = bounds_of(orbit.scene, "amplitude", 0.3)
    diagram = jv.explore(orbit.scene, "amplitude", bounds, MOST_PERIODS)
    assert diagram.complete
    for value in np.linspace(*bounds, 5)[1:-1]:
        for attractor in jv.find_attractors(orbit.scene.replace(amplitude=value), 20, 5):
            if 0 < attractor.periods <= MOST_PERIODS:
                assert attractor.orbit is not None and is_on(attractor.orbit, diagram)
                checked += 1
    assert checked
