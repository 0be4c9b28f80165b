"""Properties of normal forms, of what follows a grazing, and of isolas: references in many digits, long simulations."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np

import jaxvibro as jv
from jaxvibro.problem.added_impact_orbits import SquareRootMap
from tests.kinds import KINDS
from tests.special_points import grazing_reference, reference_bend, reference_error
from tests.tiers import generator, of_numbers

from .branches import branch_with, significant, switched_branches
from .grazings import (
    GRADUAL,
    attractor_distance,
    draw_grazing,
    followed_window,
    orbit_with_added_impact,
    state_before,
)
from .isolas import draw_isola, draw_moving_isola, has_folds

RETURNS = 6
NAMES = "period_adding", "long_run", "exponents", "jump", "isola", "moving_isola"
OWN_KINDS = KINDS | {name: SimpleNamespace(name=name) for name in NAMES}


REFERENCE_KINDS = "one_wall", "two_walls", "moving_walls"


@of_numbers
def test_unfolding(kind, number):
    """The coefficient of an SN, PD or SB is the curvature of the branches, by orbits beside it and in many digits."""
    switched = switched_branches(kind, number)
    branches = [branch_with(kind, number, ("SN", "PD")), *(some[0] for _, some in switched)]
    points = [*(point for point, _ in switched), *(point for branch in branches for point in significant(branch))]
    points = [point for point in points if point.kind in ("SN", "PD", "SB") and point.normal_form]
    for point in [point for point in points if not point.orbit.rests][:4]:
        form = point.normal_form
        if kind.name in REFERENCE_KINDS:
            expected = reference_bend(point)
            assert abs(form.coefficient - expected) < 1e-7 * abs(expected) and form.side == np.sign(expected)
        if point.spot.speeds.min() < 1e-2:  # differences do not resolve the orbits so near to a grazing
            continue
        if point.kind != "SN":
            rate = _multiplier_rate(point, min(1e-4, 1e-3 / abs(form.rate)))
            assert abs(rate - form.rate) < 1e-4 * (abs(rate) + abs(point.multipliers).max())
        measured = _curvature(point)
        assert measured is None or abs(measured - form.coefficient) < 1e-2 * abs(form.coefficient)


def _multiplier_rate(point, step):
    """Return how fast the multiplier passes 1 or -1, by those of orbits beside the point, up to two steps away."""
    target, multipliers = -1.0 if point.kind == "PD" else 1.0, []
    walls = "".join("LR"[int(side > 0)] for side in point.spot.sides)
    for share in (-2.0, -1.0, 1.0, 2.0):
        scene = point.scene.replace(**{point.name: point.value + share * step})
        guess = point.spot.times, point.spot.speeds
        roots = np.asarray(jv.solve_orbits(scene, guess, (walls, *[""] * (point.spot.periods - 1))).multipliers)
        multipliers.append(roots[np.argmin(abs(roots - target))].real)
    return (8.0 * (multipliers[2] - multipliers[1]) - (multipliers[3] - multipliers[0])) / (12.0 * step)


def _curvature(point):
    """Return b by the orbits of Newton's method from both ends of the null vector; None where it comes to one orbit.

    The orbits of an SN, and the asymmetric ones of an SB, are twice s apart; those of a PD are their two halves.
    """
    form, spot = point.normal_form, point.spot
    s = 3e-3 * min(1.0, spot.speeds.min())
    scene = point.scene.replace(**{point.name: point.value + form.coefficient * s**2})
    times, speeds = s * form.null.reshape(2, -1)
    periods, length = spot.periods, 2.0 * np.pi * spot.periods / float(scene.frequency)
    if point.kind == "PD":
        late = np.append(spot.times + times, spot.times - times + length)
        guesses = [(late, np.append(spot.speeds + speeds, spot.speeds - speeds))]
    else:
        guesses = [(spot.times + sign * times, spot.speeds + sign * speeds) for sign in (1.0, -1.0)]
    repeated = len(guesses[0][0]) // len(spot.times)
    walls = "".join("LR"[int(side > 0)] for side in spot.sides)
    words = walls * repeated, *[""] * (periods * repeated - 1)
    rows = []
    for guess in guesses:
        solution = jv.solve_orbits(scene, guess, words)
        if solution.status == jv.SolutionStatus.NONE:
            return None
        rows.append(np.stack([solution.times, solution.speeds]))
    if point.kind == "PD":
        rows = [rows[0][:, : len(spot.times)], rows[0][:, len(spot.times) :] - np.array([[length], [0.0]])]
    half = 0.5 * (rows[0] - rows[1])
    along = np.sum(half.ravel() * form.null) / np.sum(form.null**2)
    return None if abs(along) < 0.1 * s else form.coefficient * s**2 / along**2


@of_numbers
def test_grazing_map(kind, number):
    """At a grazing the matrix, the jump of the velocity and the rate of the depth are those of references."""
    branch = branch_with(kind, number, ("GR",))
    for point in [point for point in branch.points("GR") if not point.orbit.rests][:3]:
        scenario = jv.scenario(point)
        _, acceleration, expected = grazing_reference(point, scenario.half)
        assert abs(scenario.matrix - expected).max() < 1e-8 * abs(expected).max()
        np.testing.assert_allclose(np.prod(scenario.multipliers), np.linalg.det(expected), rtol=1e-6, atol=1e-10)
        restitution = float(getattr(point.scene, scenario.wall).restitution)
        assert abs(scenario.acceleration - acceleration) < 1e-6 * (1.0 + abs(acceleration))
        np.testing.assert_allclose(scenario.root, (1.0 + restitution) * np.sqrt(2.0 * acceleration), rtol=1e-6)
        slope = _slope_of_depth(point)
        assert slope is None or abs(slope - scenario.rate) < 1e-4 * abs(scenario.rate)


def _slope_of_depth(point):
    """Return the rate of the depth by the clearances of orbits that keep off the wall; None without such an orbit."""
    orbit = min(point.meets, key=lambda other: other.impacts.count)
    way, slopes = np.sign(float(orbit.scene.parameter(point.name)) - point.value), []
    for k in range(3):
        value = point.value + way * 4e-4 * 0.5**k * (1.0 + abs(point.value))
        scene = orbit.scene.replace(**{point.name: value})
        near = jv.solve_orbits(scene, orbit.state, orbit.itinerary)
        if near.status != jv.SolutionStatus.OK:
            return None
        other = jv.find_orbit(scene, near.state, orbit.periods, settle=0)
        if other.label != orbit.label:
            return None
        slopes.append(other.least_clearance / (point.value - value))
    first, second = (2.0 * fine - coarse for coarse, fine in pairwise(slopes))
    return (4.0 * second - first) / 3.0


@of_numbers
def test_period_adding(kind, number):
    """The windows of period adding end where the branches of their orbits touch the wall, in many digits."""
    point = draw_grazing(generator(kind, number), (1.0, 2.0), GRADUAL)
    adding, compared = jv.period_adding(point, RETURNS), 0
    size = 1.0 + abs(point.value)
    for window in adding.windows:
        if window.orbit is None or abs(window.found - point.value) < 1e-7 * size:
            continue
        last = followed_window(point, window)
        assert last is not None and abs(last.value - window.found) < 1e-11 * size
        assert reference_error(last) < 1e-11 * size
        compared += 1
    assert compared


@of_numbers
def test_long_runs(kind, number):
    """Attractors leave a grazing with the root of the depth, or at once where the scenario is a jump."""
    rng = generator(kind, number)
    outcomes = ("JUMP",) if number % 2 else GRADUAL
    point = draw_grazing(rng, (0.3, 2.5), outcomes, is_free=True)
    scenario = jv.scenario(point)
    near = SquareRootMap(scenario.root, scenario.matrix)
    reach = min(0.1, abs(near.impact_responses(1)[1]))
    if scenario.deeper:
        reach = near.added_impact_window(scenario.deeper).linear_coefficient
    first, last = (attractor_distance(point, share * reach**2) for share in (1e-1, 1e-4))
    power = np.log10(first / last) / 3.0
    assert power < 0.1 if scenario.deeper else power > 0.3


@of_numbers
def test_exponents(kind, number):
    """Lyapunov exponents are negative in the windows of period adding, and mostly positive between them."""
    rng = generator(kind, number)
    point = draw_grazing(rng, (1.0, 2.5), ("ADDING", "CHAOS"), is_free=True)
    scenario = jv.scenario(point)
    near = SquareRootMap(scenario.root, scenario.matrix)
    n = next(n for n in range(2, 40) if near.added_impact_window(n).next_grazing_root < 0.02)
    top = near.added_impact_window(n).depth(near.added_impact_window(n).next_grazing_root)
    depths = top * scenario.ratio ** -rng.random(24)
    start = state_before(point)
    values = point.value + depths / scenario.rate
    computed = jv.spectrum(point.scene, point.name, values, start, settle=2000, most=2**14)
    positive = computed["exponent"].values[:, 0] > 0
    windows = [near.added_impact_window(k) for k in range(1, 60)]
    ends = [(one.depth(one.min_stable_root), one.depth(one.next_grazing_root)) for one in windows]
    inside = np.array([any(low < depth < high for low, high in ends) for depth in depths])
    assert positive[inside].mean() < 0.2 if inside.any() else True
    assert positive[~inside].mean() > 0.7 if (~inside).any() else True


@of_numbers
def test_jumps(kind, number):
    """Orbits with one impact in n returns fold where the square-root map says, to the next order of the root."""
    rng = generator(kind, number)
    orbit = None
    while orbit is None:
        point = draw_grazing(rng, (0.5, 0.97), ("JUMP",))
        scenario = jv.scenario(point)
        window = SquareRootMap(scenario.root, scenario.matrix).added_impact_window(scenario.deeper)
        speed = window.linear_coefficient * np.sqrt(2.0 * scenario.acceleration)
        if window.linear_coefficient < 0.1 and scenario.deeper <= len(scenario.orbits):
            orbit = orbit_with_added_impact(point, scenario.deeper, speed)
    size = scenario.orbits[scenario.deeper - 1].fold - point.value
    value = float(orbit.scene.parameter(point.name))
    ends = point.value + 3.0 * size, point.value - size, value + size, value - size
    branch = jv.follow(orbit, point.name, (min(ends), max(ends)), first_step=0.1 * speed, largest_step=0.1 * speed)
    share = min(abs((one.value - point.value) / size - 1.0) for one in branch.points("SN"))
    assert share < 10.0 * window.linear_coefficient


@of_numbers
def test_isolas(kind, number):
    """An isola that `explore` misses is found, closes, and has the folds of the closed form, on one branch."""
    isola = (draw_moving_isola if kind.name == "moving_isola" else draw_isola)(generator(kind, number))
    diagram = jv.explore(isola.scene, "frequency", isola.bounds, max_period=4)
    if any(has_folds(branch, isola) for branch in diagram.branches):
        return
    (branch,) = [branch for branch in jv.find_isolas(diagram) if has_folds(branch, isola)]
    assert branch.reasons[1].startswith("it closes")
    for fold in isola.folds:
        assert min(abs(point.value - fold) for point in branch.points("SN")) < 1e-9
