"""Properties of derivatives of special points, of margins, of placement, and of fits."""

from functools import cache

import jax
import numpy as np
import pytest
from mpmath import mpf, workdps

import jaxvibro as jv
from tests.kinds import LANES
from tests.tiers import generator, of_numbers

from . import special_points
from .special_points import TRIES, exact_value, find_loci, find_points, free_names, wall_of

OWN_KINDS = special_points.OWN_KINDS
STEP = 1e-4  # of differences
WAYS = np.array([-2.0, -1.0, 1.0, 2.0]) * STEP
WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * STEP)  # of a derivative of order four
APART = mpf(10) ** -12  # of values in high precision
SIGMA = 1e-3
IMPACTS, SAMPLES = 10, 60  # of a record
PERIODS, SLOTS = 10, 64  # in which the impacts of a record are looked for
UNITS = {"frequency": 0.05, "damping": 0.01, "position": 0.05, "restitution": 0.05, "stiffness": 0.5, "amplitude": 0.05}


def unit_of(name):
    """Return the unit of a number that may change."""
    return UNITS.get(name.rpartition(".")[2], 0.05)


def value_of(point):
    """Return the value of a special point as a function of scenes."""
    return jv.located(point, wall=wall_of(point))


def shifted(scene, change):
    """Return a scene whose numbers have changed, as far as their domains allow."""
    numbers = {name: float(scene.parameter(name)) + by for name, by in change.items()}
    for name in numbers:
        own = name.rpartition(".")[2]
        if own in ("damping", "dissipation", "restitution"):
            numbers[name] = max(numbers[name], 0.0) if own != "restitution" else min(numbers[name], 1.0)
    return scene.replace(**numbers)


@of_numbers
def test_gradient(kind, number):
    """The derivatives of a special point by each number of its scene are differences of points that are located anew.

    `sensitivity` and the gradient of `located` agree.
    """
    allowed = 1e3 * kind.tolerance / STEP
    for point in find_points(kind.name, number)[1].values():
        value = value_of(point)
        table = jv.sensitivity(point, wall=value.wall)
        gradient, away = jax.grad(value)(point.scene), []
        assert table.attrs["amplitude"] == point.value and len(table) >= 2
        for name in table["number"].values.tolist():
            here, slope = float(point.scene.parameter(name)), float(table.sel(number=name))
            assert float(table["value"].sel(number=name)) == here
            side, _, own = name.partition(".")
            if own != "restitution" or getattr(point.scene, side).restitution is not None:  # else the scene's has it
                assert float(gradient.parameter(name)) == pytest.approx(slope, rel=1e-8, abs=allowed), name
            moved = value.solve(point.scene.replace(**{name: here + WAYS}))
            if (np.asarray(moved.status) == jv.SolutionStatus.OK).all():
                away.append(abs(WEIGHTS @ np.asarray(moved.value) - slope) / (1.0 + abs(slope)))
        assert len(away) >= 1 and max(away) < allowed + 1e-7


@of_numbers
def test_exact_gradient(kind, number):
    """The derivatives are those of the reference in high precision."""
    rng = generator(kind, number)
    for name, point in find_points(kind.name, number)[1].items():
        value = value_of(point)
        table = jv.sensitivity(point, wall=value.wall)
        for other in rng.choice(free_names(point), 2, replace=False):
            moves = [[(str(other), way * APART)] for way in (1, -1)]
            given = point.scene, name, "amplitude", point.value, point.spot
            up, down = (exact_value(*given, move, value.wall) for move in moves)
            with workdps(40):
                expected = float((up - down) / (2 * APART))
            assert float(table.sel(number=other)) == pytest.approx(expected, rel=1e-10, abs=1e-10), (name, other)


@of_numbers
def test_second_derivative(kind, number):
    """The second derivative along a random change of the scene is the difference of first ones."""
    rng = generator(kind, number)
    name, point = sorted(find_points(kind.name, number)[1].items())[-1]
    value, names = value_of(point), free_names(point)[:3]
    weights = dict(zip(names, rng.normal(size=len(names)), strict=True))

    def along(step):
        return value(
            point.scene.replace(**{key: float(point.scene.parameter(key)) + step * by for key, by in weights.items()})
        )

    slope = jax.grad(along)
    slopes = np.array([float(slope(way)) for way in WAYS])
    bend = float(jax.grad(slope)(0.0))
    assert bend == pytest.approx(WEIGHTS @ slopes, rel=1e-6, abs=1e-6), name


@of_numbers
def test_located(kind, number):
    """A special point in the scene of another point of its locus is that point."""
    compared = 0
    points = find_points(kind.name, number)[1]
    for name, locus in find_loci(kind.name, number).items():
        value = value_of(points[name])
        here = [float(points[name].scene.parameter(each)) for each in locus.names]
        start = int(np.argmin(abs(locus.values - here).max(axis=1)))
        for place in {max(start - 2, 0), min(start + 2, len(locus) - 1)}:
            found = value.solve(locus.located(place)[0])
            if found.status == jv.SolutionStatus.OK:
                compared += 1
                expected = locus.values[place, 0]
                assert abs(float(found.value) - expected) < 1e3 * kind.tolerance * (1.0 + abs(expected)), name
    assert compared >= 1


@of_numbers
def test_margin(kind, number):
    """The nearest special point is on the boundary of its kind, perpendicular to it, no farther than a known one."""
    branch, points = find_points(kind.name, number)
    name, point = sorted(points.items())[-1]  # an SN or SB if there is one: its orbits lie on one side
    rows = [place for place in (point.place - 2, point.place + 2) if 0 <= place < len(branch)]
    orbit = branch.orbit(max(rows, key=lambda place: abs(branch.values[place] - point.value)))
    other = str(generator(kind, number).choice(free_names(point)))
    free = {"amplitude": 0.1, other: unit_of(other)}
    near = jv.margin(orbit, free)
    assert list(near.free) == list(free) and near.points
    known = abs(float(orbit.scene.amplitude) - point.value) / free["amplitude"]
    assert near.distance <= known * (1.0 + 1e-9)
    assert [one.distance for one in near.points] == sorted(one.distance for one in near.points)
    for one in near.points:
        offset = np.array([one.change[key] / unit for key, unit in free.items()])
        assert np.linalg.norm(offset) == pytest.approx(one.distance, rel=1e-12)
        assert one.distance * np.array(list(one.direction.values())) == pytest.approx(offset, rel=1e-9, abs=1e-12)
        for key, change in one.change.items():
            assert float(one.scene.parameter(key)) == pytest.approx(float(orbit.scene.parameter(key)) + change)
    for one in near.points:
        if one.kind != name or one.edge or one.at_bound:
            continue
        value = value_of(point)
        there = value.solve(one.scene)
        if there.status == jv.SolutionStatus.OK and abs(float(there.value) - float(one.scene.amplitude)) < 1e-6:
            normal = np.array([-free["amplitude"], free[other] * float(jax.grad(value)(one.scene).parameter(other))])
            direction = np.array(list(one.direction.values()))
            assert abs(normal[0] * direction[1] - normal[1] * direction[0]) < 1e-6 * np.linalg.norm(normal)


@of_numbers
def test_place(kind, number):
    """A point is moved to a value that it has in a scene that is known, by no greater a change."""
    rng = generator(kind, number)
    met = 0
    for name, point in find_points(kind.name, number)[1].items():
        names, value = free_names(point), value_of(point)
        if value.wall:
            continue
        free = {str(key): unit_of(key) for key in rng.choice(names, min(2, len(names)), replace=False)}
        change = {key: unit * rng.uniform(-0.4, 0.4) for key, unit in free.items()}
        known = value.solve(shifted(point.scene, change))
        if known.status != jv.SolutionStatus.OK:
            continue
        placed = jv.place(point, "amplitude", float(known.value), free)
        size = 1.0 + abs(float(known.value))
        assert placed.met, (name, placed.why)
        assert abs(float(value(placed.scene)) - float(known.value)) < 1e3 * kind.tolerance * size
        assert placed.at_bound or placed.distance <= np.linalg.norm([change[key] / free[key] for key in free]) + 1e-7
        met += 1
        key = next(iter(free))
        here, slope = float(point.scene.parameter(key)), float(jv.sensitivity(point, [key])[0])
        bounds = {key: (here - 1e-3 * free[key], here + 1e-3 * free[key])}
        far = point.value + 10.0 * max(abs(slope), 1e-3) * 1e-3 * free[key]
        stopped = jv.place(point, "amplitude", far, {key: free[key]}, bounds)
        assert not stopped.met and stopped.why
    assert met >= 1


@cache
def record_of(kind_name, number):
    """Return a scene, a start with impacts that are neither slow nor close, their times and sides, and free numbers."""
    for attempt in range(TRIES):
        scene, state = OWN_KINDS[kind_name].draw_single(TRIES * number + attempt)
        impacts = jv.strobe(scene, state, PERIODS, SLOTS)[1]
        times, sides, speeds = (np.asarray(part)[:IMPACTS] for part in (impacts.time, impacts.side, impacts.speed))
        walls = [name for name, side in (("left", -1), ("right", 1)) if (sides == side).sum() > 2]
        if impacts.count >= IMPACTS and walls and np.diff(times).min() > 20.0 * SIGMA and speeds.min() > 0.05:
            number = "stiffness" if getattr(scene, walls[0]).soft else "position"
            return scene, state, times, sides, ("damping", f"{walls[0]}.{number}")
    raise AssertionError(f"no record in {TRIES} scenes of {kind_name}, draw {number}")


def covariance_of(scene, state, free, measured):
    """Return the covariance of numbers by differences of what is measured; measured: of batches, (lanes, values)."""
    names, size = list(free), len(free) + 2
    steps = np.concatenate([1e-6 * np.eye(size), -1e-6 * np.eye(size)])
    assert len(steps) == LANES
    moved = {name: float(scene.parameter(name)) + steps[:, k] for k, name in enumerate(names)}
    start = jv.State(state.x + steps[:, -2], state.v + steps[:, -1], 0.0 * steps[:, 0], 0.0 * steps[:, 0])
    values = np.asarray(measured(scene.replace(**moved), start))
    matrix = (values[:size] - values[size:]).T / 2e-6 / SIGMA
    return np.linalg.inv(matrix.T @ matrix)[: len(names), : len(names)]


def assert_fitted(fitted, scene, free, covariance):
    """Check a fit of a record without noise."""
    assert fitted.status == jv.FitStatus.OK and fitted.chi2 < 1e-6
    for name in free:
        assert abs(fitted.values[name] - float(scene.parameter(name))) < 1e-3 * fitted.sigma[name], name
    assert fitted.covariance.values == pytest.approx(covariance, rel=1e-3)


def near_start(scene, free, rng):
    """Return the scene with its free numbers some tenths of their units off."""
    return scene.replace(
        **{name: float(scene.parameter(name)) + 0.3 * unit * rng.uniform(-1, 1) for name, unit in free.items()}
    )


@of_numbers
def test_fit_of_impacts(kind, number):
    """A fit of the times of impacts has the numbers that made them, their covariance, and finds one that is missing."""
    scene, state, times, sides, names = record_of(kind.name, number)
    rng, free = generator(kind, number), {name: unit_of(name) for name in names}

    def measured(scenes, states):
        return jv.strobe(scenes, states, PERIODS, SLOTS)[1].time[:, :IMPACTS]

    found = jv.fit(near_start(scene, free, rng), jv.ImpactRecord(times, sides, SIGMA), free)
    assert_fitted(found, scene, free, covariance_of(scene, state, free, measured))
    assert found.missed == () and found.spurious == ()
    place = int(rng.integers(3, IMPACTS - 3))
    without = jv.ImpactRecord(np.delete(times, place), np.delete(sides, place), SIGMA)
    found = jv.fit(near_start(scene, free, rng), without, free)
    ((time, side),) = found.missed
    assert abs(time - times[place]) < 5.0 * SIGMA and side == sides[place]


@of_numbers
def test_fit_of_samples(kind, number):
    """A fit of samples of the motion has the numbers that made them and their covariance."""
    scene, state, impacts, _, names = record_of(kind.name, number)
    rng, free = generator(kind, number), {name: unit_of(name) for name in names}
    times = np.linspace(0.0, 0.5 * (impacts[-2] + impacts[-1]), SAMPLES)  # at an impact the derivative jumps
    states, status = jv.sample(scene, state, times)
    assert status == 0
    velocities = np.asarray(states.v) if number % 2 else None

    def measured(scenes, starts):
        seen = jv.sample(scenes, starts, np.tile(times, (LANES, 1)))[0]
        return seen.x if velocities is None else np.stack([seen.x, seen.v], axis=2).reshape(LANES, -1)

    record = jv.SampleRecord(times, np.asarray(states.x), SIGMA, velocities)
    found = jv.fit(near_start(scene, free, rng), record, free)
    assert_fitted(found, scene, free, covariance_of(scene, state, free, measured))


@of_numbers
def test_fit_of_points(kind, number):
    """A fit of the values of special points has the numbers that made them, and the covariance of their derivatives."""
    points = tuple(point for point in find_points(kind.name, number)[1].values() if not wall_of(point))
    rng, names = generator(kind, number), sorted(set.intersection(*(set(free_names(point)) for point in points)))
    free = {str(key): unit_of(key) for key in rng.choice(names, min(len(points), 2, len(names)), replace=False)}
    scene = shifted(points[0].scene, {key: unit * rng.uniform(-0.2, 0.2) for key, unit in free.items()})
    functions = [value_of(point) for point in points]
    found = [value.solve(scene) for value in functions]
    assert all(one.status == jv.SolutionStatus.OK for one in found)
    values = [float(one.value) for one in found]
    fitted = jv.fit(points[0].scene, jv.PointRecord(points, values, 1e-7), free)
    matrix = np.array([[jax.grad(value)(scene).parameter(key) for key in free] for value in functions]) / 1e-7
    covariance = np.linalg.inv(matrix.T @ matrix)
    assert fitted.status == jv.FitStatus.OK and fitted.dof == len(points) - len(free)
    for key in free:
        assert abs(fitted.values[key] - float(scene.parameter(key))) < 1e-3 * fitted.sigma[key] + 1e-10
    assert fitted.covariance.values == pytest.approx(covariance, rel=1e-4)
