"""The numerics that know no oscillator, piece by piece; whole branches are in test_trace.py."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
from continuation.arclength import make_start_point
from continuation.augmented_systems import branch_tangents, less_aligned_tangent, solve_newton
from continuation.branch_segment import SpecialIndex, first_rows, insert_row, join_rows, reverse_rows
from continuation.continuation_loop import (
    End,
    EventDetector,
    Termination,
    _diagnose_new_points,
    follow_branch,
)
from continuation.event_search import _event_between, find_jump, take_step, truncate_at_length, unit_tangent
from continuation.newton import ADVICE, newton, solve
from continuation.one_parameter import make_task
from continuation.problem import SystemConstants, bialternate_product, bialternate_sum
from tests.test_trace import close

CIRCLE = co.equilibria(lambda u, p, square: u * u + p["p"] ** 2 - square)
PITCHFORK = co.equilibria(lambda u, p, e: p["p"] * u - u**3 + e)
CUSP = co.equilibria(lambda u, p, a: p["p"] + a * u - u**3)
TWICE = co.equilibria(lambda u, p, args: (u - p["p"] ** 2) ** 2)


def task_from(system, z, args, bounds=(-3.0, 3.0), scale=None, **changes):
    """Return a task along p, and its start: the solution z with the tangent there."""
    z = np.array(z, float)
    task = make_task(system, z, {"p": bounds}, SystemConstants({}, args), 0.05, 0.1, 1e-10)
    if scale is not None:
        task = task._replace(control=task.control._replace(scale=scale))
    task = task._replace(**({"detector": EventDetector()} | changes))
    return task, make_start_point(z, unit_tangent(task.problem, z, task.control.scale, task.args))


def test_linear_systems_against_lapack():
    rng = np.random.default_rng(0)
    matrices, rights = rng.normal(size=(50, 6, 6)), rng.normal(size=(50, 6))
    matrices[:, 0, 0] = 0.0  # rows have to be exchanged
    found, worst, determinant = jax.vmap(solve)(matrices, rights)
    assert np.allclose(found, np.linalg.solve(matrices, rights[..., None])[..., 0], rtol=1e-10, atol=1e-10)
    assert np.all(worst > 0)
    assert np.allclose(determinant, np.linalg.det(matrices), rtol=1e-10)
    assert solve(jnp.ones((3, 3)), jnp.arange(3.0)).pivot_ratio == 0


def on_circle(point):
    """x^2 + y^2 = 4, y = x, and the Jacobian."""
    x, y = point
    return jnp.stack([x * x + y * y - 4.0, y - x]), jnp.stack([jnp.stack([2 * x, 2 * y]), jnp.array([-1.0, 1.0])])


def no_zero(point):
    return point * point + 1.0, jnp.diag(2.0 * point)


def double_zero(point):
    """x^2 = 0, y = 0: each step halves x."""
    x, y = point
    return jnp.stack([x * x, y]), jnp.diag(jnp.stack([2.0 * x, 1.0]))


def flat(point):
    return jnp.stack([point[0] - 1.0, point[0] - 1.0]), jnp.array([[1.0, 0.0], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("function", "start", "reason"),
    [
        (on_circle, [3.0, 0.5], ""),
        (on_circle, [np.nan, 1.0], "not finite"),
        (no_zero, [0.3], "did not converge"),
        (double_zero, [1.0, 1.0], "singular"),
        (flat, [0.0, 0.0], "singular"),
    ],
)
def test_newton_says_why_it_failed(function, start, reason):
    solution = newton(function, jnp.array(start), max_steps=25)
    told = ADVICE[int(solution.status)]
    assert reason in told and bool(reason) == bool(told)
    assert reason or (close(solution.unknowns, np.sqrt(2.0), 1e-15) and solution.residual < 1e-14)


def test_steps_of_newton_are_cut_in_all_their_entries_alike_and_lanes_are_independent():
    starts = jnp.array([[3.0, 0.5], [jnp.nan, 1.0], [-5.0, -4.0]])
    lanes = jax.vmap(lambda start: newton(on_circle, start, max_change=0.5))(starts)
    assert [bool(ADVICE[status]) for status in lanes.status] == [False, True, False]
    assert close(lanes.unknowns[jnp.array([0, 2])], [[np.sqrt(2.0)] * 2, [-np.sqrt(2.0)] * 2], 1e-15)
    whole, cut = (newton(on_circle, starts[0], most, max_steps=1).unknowns - starts[0] for most in (jnp.inf, 0.5))
    assert abs(whole).max() > 1.0 and close(abs(cut).max(), 0.5, 1e-15)
    assert close(cut * abs(whole).max(), whole * 0.5, 1e-15)


@pytest.mark.parametrize("size", [2, 5])
def test_pairs_have_the_products_and_sums_of_eigenvalues(size):
    for matrix in np.random.default_rng(size).normal(size=(5, size, size)):
        values = np.linalg.eigvals(matrix)
        pairs = [(values[i], values[k]) for i in range(size) for k in range(i)]
        for function, true in (
            (bialternate_product, [a * b - 1 for a, b in pairs]),
            (bialternate_sum, [a + b for a, b in pairs]),
        ):
            found = np.linalg.eigvals(np.asarray(function(jnp.array(matrix))))
            assert len(found) == len(true)
            assert close(np.poly(found).real, np.poly(true).real, 1e-9 * abs(np.poly(true)).max())


def test_directions_at_crossings_with_weighted_lengths():
    scale, zero = np.array([2.0, 0.5]), np.zeros(2)
    task, _ = task_from(PITCHFORK, zero, 0.0)
    first, second = branch_tangents(task.problem, zero, scale, task.args)
    first, second = (first, second) if abs(first[0]) > abs(second[0]) else (second, first)
    assert close(abs(first), [0.5, 0.0], 1e-12) and close(abs(second), [0.0, 2.0], 1e-12)
    assert close(less_aligned_tangent((first, second), np.array([0.1, 1.0]), scale), first, 0)
    with pytest.raises(ValueError, match="no branches cross"):
        branch_tangents(task_from(CIRCLE, [1.0, 0.0], 1.0)[0].problem, zero, scale, SystemConstants({}, 1.0))


def test_lengths_are_weighted():
    scale, z = np.array([3.0, 0.5]), np.array([0.6, 0.8])
    branch = follow_branch(*task_from(CIRCLE, z, 1.0, scale=scale, starts=(z,)))
    assert branch.end is End.CLOSED
    assert [one.kind for one in branch.specials] == ["SN", "SN"]
    assert close([branch.points.z[one.row] for one in branch.specials], [[0, 1], [0, -1]], 1e-14)
    assert close(np.sum(branch.points.z**2, axis=1), 1, 1e-12)
    lengths = np.linalg.norm(scale * np.diff(branch.points.z, axis=0), axis=1)
    assert 0.09 < lengths.max() < 0.11


class RefusesOnce(EventDetector):
    """A detector that refuses the first points beyond -7.9; those of another step are good."""

    refused: frozenset = frozenset()

    def is_admissible(self, zs, diagnostics):
        self.refused = self.refused or frozenset(z.tobytes() for z in zs[zs[:, 1] >= -7.9])
        return np.array([z.tobytes() not in self.refused for z in zs])


def test_a_branch_ends_at_a_bound_retries_stops_and_does_not_start_where_nothing_is_finite():
    rows = ((1.0, -5.0, {}), (-0.5, 3.0, {"detector": RefusesOnce()}), (2.5, 3.0, {"stop": ("SN",)}))
    tasks = [task_from(CUSP, [-2.0, -8.0 + 2.0 * a], a, (-9.0, high), **more) for a, high, more in rows]
    branches = [follow_branch(*task) for task in tasks]
    assert [branch.end for branch in branches] == [End.BOUND, End.BOUND, End.STOPPED]
    last_row = len(branches[2].points.z) - 1
    assert [[special[:2] for special in branch.specials] for branch in branches] == [[], [], [(last_row, "SN")]]
    fold = np.sqrt(2.5 / 3.0)
    assert close(branches[2].points.z[last_row], [-fold, 2.0 * fold**3], 1e-12)
    assert branches[1].points.step[1:].min() < 0.05 <= branches[0].points.step[1:-1].min()
    task, _ = task_from(CUSP, [-2.0, -6.0], 1.0)
    nowhere = follow_branch(task, make_start_point(np.array([-2.0, np.nan]), np.array([0.0, 1.0])))
    assert nowhere.end is End.NUMBER


class SeesAhead(EventDetector):
    """A detector that sees an end at p = 0.7 on the circle from each point within half a unit of it."""

    def find_early_end(self, task, points):
        (near,) = np.nonzero(abs(0.45 - points.z[:, 1]) < 0.25)
        if not len(near):
            return None
        row = int(near[-1])
        length = (np.array([np.sqrt(1 - 0.7**2), 0.7]) - points.z[row]) @ points.tangent[row]
        return Termination(truncate_at_length(task, points, row, length), SpecialIndex(0, "X", 0.0), End.STOPPED)


@pytest.mark.parametrize(("bound", "end"), [(0.5, "BOUND"), (0.8, "STOPPED")])
def test_an_end_seen_ahead_beyond_a_bound_is_none(bound, end):
    branch = follow_branch(*task_from(CIRCLE, [1.0, 0.0], 1.0, (-3.0, bound), detector=SeesAhead()))
    assert branch.end is End[end]
    assert close(branch.points.z[-1, 1], min(bound, 0.7), 1e-9)
    assert [one.kind for one in branch.specials] == ["X"] * (bound > 0.7)


def test_a_step_is_kept_only_where_newton_s_method_ended():
    """It is slow on a branch of double zeros."""
    task, _ = task_from(TWICE, [1.0, 1.0], None, (0.0, 1.3))
    branch = follow_branch(task, make_start_point(np.ones(2), np.array([2.0, 1.0]) / np.sqrt(5)))
    assert len(branch.points.z) > 5
    assert abs(branch.points.z[:, 0] - branch.points.z[:, 1] ** 2).max() < 1e-8


def test_a_zero_out_of_reach_is_not_looked_for():
    """Of the parabola's two zeros the nearer one is 0.3 away, and the first step from beside its turning point 3.3."""
    asked = []

    def parabola(y):
        asked.append(y)
        return y**2 - 1.0, 2.0 * np.diag(y)

    assert close(solve_newton(parabola, np.array([0.7]), 0.4).z, [1.0], 1e-14)
    assert close(solve_newton(parabola, np.array([0.15])).z, [1.0], 1e-14)
    asked.clear()
    assert solve_newton(parabola, np.array([0.15]), 1.0).z is None and len(asked) == 1


def test_a_change_of_sign_is_a_jump_beyond_a_known_singularity_alone():
    """From p = -0.2 to 0.2 on u = 0; jumps without a singularity are in test_trace."""
    task, start = task_from(PITCHFORK, [0.0, -0.2], 0.0)
    given = task.control, task.args
    rows = [take_step(task.problem, start, length, *given)._replace(step=np.float64(length)) for length in (0.0, 0.4)]
    points = type(start)(*map(np.stack, zip(*rows, strict=True)))
    place, known = find_jump(task.problem, points, *given)
    assert place is None and list(known) == [0] and known[0].kind == "BP" and close(known[0].z, [0, 0], 1e-12)
    assert find_jump(task.problem, points, *given, np.array([True, False]))[0] is None
    assert find_jump(task.problem, points, *given, np.array([False, True])) == (1, {})


@pytest.mark.parametrize(("far", "seen"), [(0.1, False), (0.5, False), (1.0, True)])
def test_an_event_lies_within_its_interval(far, seen):
    """The fold of the circle, 0.6 ahead along the tangent."""
    task, start = task_from(CIRCLE, [0.6, 0.8], 1.0)
    near = take_step(task.problem, start, 0.1, task.control, task.args)
    event = _event_between(task.problem, "SN", start, 3, (0.0, far), near, 0.1, task.control, task.args)
    assert (event is not None) == seen
    assert not seen or (close(event.z, [0.0, 1.0], 1e-14) and close(event.length, 0.6, 1e-14))


class Rows(NamedTuple):
    z: np.ndarray
    step: np.ndarray


def listed(points):
    return [(*z, step) for z, step in zip(points.z.tolist(), points.step.tolist(), strict=True)]


def test_rows_are_those_of_lists():
    rng = np.random.default_rng(11)
    points, one = Rows(rng.normal(size=(5, 3)), rng.normal(size=5)), Rows(rng.normal(size=3), np.float64(0.5))
    plain = listed(points)
    assert listed(first_rows(points, 3)) == plain[:3] and listed(reverse_rows(points)) == plain[::-1]
    assert listed(join_rows([points, points, first_rows(points, 2)])) == plain + plain[1:] + plain[1:2]
    for place in range(1, 6):
        expected = [*plain[:place], (*one.z.tolist(), 0.5), *plain[place:]]
        if place < 5:  # what is left of the step to the row after it
            expected[place + 1] = (*plain[place][:-1], plain[place][-1] - 0.5)
        assert listed(insert_row(points, place, one)) == expected
    assert listed(points) == plain
    assert join_rows([None, None]) is None


class Counts(EventDetector):
    """A detector that counts the points which it diagnoses."""

    asked = 0

    def diagnose(self, zs):
        self.asked += len(zs)
        return Rows(zs[:, ::-1, None] * np.arange(2.0), (zs * zs).sum(axis=1))


def test_steps_end_at_a_bound():
    detector = Counts()
    branch = follow_branch(*task_from(CUSP, [-2.0, -6.0], 1.0, (-7.0, -5.9), detector=detector))
    assert branch.points.z[-1, 1] == -5.9
    assert detector.asked <= len(branch.points.z) + 1


@pytest.mark.parametrize(("kept", "new"), [([0, 1, 2, 3], 0), ([0, 2, 3], 1), ([], 3), ([0, 1], 0), ([3], 2)])
def test_new_points_alone_are_diagnosed(kept, new):
    rng, detector = np.random.default_rng(11), Counts()
    before = rng.normal(size=(4, 3))
    known = detector.diagnose(before)
    held = [leaf.copy() for leaf in known]
    zs, detector.asked = rng.permutation(np.concatenate([before[kept], rng.normal(size=(new, 3))]), axis=0), 0
    diagnosed = _diagnose_new_points(detector, zs, before, known)
    assert detector.asked == new
    for computed, expected in zip((*diagnosed, *known), (*detector.diagnose(zs), *held), strict=True):
        np.testing.assert_array_equal(computed, expected)


@pytest.mark.parametrize("start", [0.0, 1.2])
def test_a_pitchfork_moves_alike_from_both_of_its_branches(start):
    """a + b^2 = 0 at the pitchfork, whether it is met along u = 0 or along u^2 = a + b^2."""
    system = co.equilibria(lambda u, p, _: (p["a"] + p["b"] ** 2) * u - u**3, symmetry=lambda u: -u)
    branch = co.trace(system, [start], {"a": 1.0, "b": 0.3}, "a", bounds=(-1.0, 2.0))
    (pitchfork,) = branch.points("SB")
    assert abs(pitchfork.p["a"] + 0.09) < 1e-9 and abs(co.sensitivity(pitchfork, "b") + 0.6) < 1e-9
