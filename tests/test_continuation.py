"""The numerics that know no oscillator, piece by piece; whole branches are in test_trace.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from continuation import (
    arclength,
    augmented_systems,
    branch_point_tangents,
    continuation_loop,
    event_search,
    newton,
    problem,
)
from continuation.branch_segment import SpecialIndex
from continuation.linear_solver import solve
from continuation.point_rows import first_rows, insert_row, row_at
from continuation.problem import SystemConstants, equilibria, make_problem
from tests.test_trace import close

CIRCLE, PITCHFORK, TWICE, CUSP = (
    make_problem(equilibria(function), ("p",))
    for function in (
        lambda u, p, square: u * u + p["p"] ** 2 - square,
        lambda u, p, e: p["p"] * u - u**3 + e,
        lambda u, p, args: (u - p["p"] ** 2) ** 2,
        lambda u, p, a: p["p"] + a * u - u**3,
    )
)
LIMITS = {"max_step": 0.1, "tolerance": 1e-10, "lower": -3.0, "upper": 3.0}


def given(args=None):
    return SystemConstants({}, args)


def control_of(size, scale=None, **limits):
    numbers = {key: np.float64(value) for key, value in (LIMITS | limits).items()}
    return arclength.StepControl(scale=np.ones(size) if scale is None else scale, min_step=np.float64(1e-7), **numbers)


def point_of(z, tangent):
    none = np.zeros(())
    return arclength.Point(np.asarray(z, float), np.asarray(tangent, float), none, none, none, np.True_, np.True_)


def place_of(z, tangent, first=0.05):
    z, tangent = np.asarray(z, float), np.asarray(tangent, float)
    return arclength.TrackState(z, tangent, np.float64(first), np.int32(arclength.RUNNING))


def on_circle(point):
    """x^2 + y^2 = 4, y = x, and the Jacobian."""
    x, y = point
    return jnp.stack([x * x + y * y - 4.0, y - x]), jnp.stack([jnp.stack([2 * x, 2 * y]), jnp.array([-1.0, 1.0])])


def test_linear_systems_against_lapack():
    rng = np.random.default_rng(0)
    matrices, rights = rng.normal(size=(50, 6, 6)), rng.normal(size=(50, 6))
    matrices[:, 0, 0] = 0.0  # rows have to be exchanged
    found, worst, determinant = jax.vmap(solve)(matrices, rights)
    assert np.allclose(found, np.linalg.solve(matrices, rights[..., None])[..., 0], rtol=1e-10, atol=1e-10)
    assert np.all(worst > 0)
    assert np.allclose(determinant, np.linalg.det(matrices), rtol=1e-10)
    assert solve(jnp.ones((3, 3)), jnp.arange(3.0)).pivot_ratio == 0


def test_newton_says_why_it_failed():
    def none(point):  # x^2 + 1 = 0
        return point * point + 1.0, jnp.diag(2.0 * point)

    def double(point):  # x^2 = 0, y = 0: each step halves x
        x, y = point
        return jnp.stack([x * x, y]), jnp.diag(jnp.stack([2.0 * x, 1.0]))

    def flat(point):
        return jnp.stack([point[0] - 1.0, point[0] - 1.0]), jnp.array([[1.0, 0.0], [1.0, 0.0]])

    found = newton.newton(on_circle, jnp.array([3.0, 0.5]))
    assert found.status == newton.OK and found.residual < 1e-14
    assert np.allclose(found.unknowns, np.sqrt(2.0), rtol=0, atol=1e-15)
    assert newton.newton(none, jnp.array([0.3])).status == newton.NOT_CONVERGED
    assert newton.newton(double, jnp.array([1.0, 1.0]), max_steps=25).status == newton.SINGULAR
    assert newton.newton(flat, jnp.array([0.0, 0.0])).status == newton.SINGULAR
    starts = jnp.array([[3.0, 0.5], [jnp.nan, 1.0], [-5.0, -4.0]])
    found = jax.vmap(lambda start: newton.newton(on_circle, start, max_change=0.5))(starts)
    assert np.array_equal(found.status, [newton.OK, newton.NONFINITE, newton.OK])
    assert np.allclose(found.unknowns[2], -np.sqrt(2.0), rtol=0, atol=1e-15)


def same_tangents(found, true, scale):
    """Whether two tangents are two directions' unit tangents, in any order, with any sign, to 1e-12."""
    true = np.array(true) / np.linalg.norm(scale * np.array(true), axis=1)[:, None]
    apart = [[min(abs(one - two).max(), abs(one + two).max()) for two in true] for one in found]
    return set(np.argmin(apart, axis=1)) == {0, 1} and np.min(apart, axis=1).max() < 1e-12


def test_marks_on_a_branch():
    control = control_of(2)
    points, _ = next(event_search.track_chunks(CIRCLE, place_of([1.0, 0.0], [0.0, 1.0]), control, given(1.0)))
    on, off = np.array([0.28, 0.96]), np.array([0.28, 0.96 + 1e-4])
    assert event_search.find_first_pass(CIRCLE, points, [off], control, given(1.0)) is None
    assert event_search.find_first_pass(CIRCLE, first_rows(points, 1), [on], control, given(1.0)) is None
    begin = points.z[0] + 1e-15 * points.tangent[0]  # a rounding beyond where the branch begins
    assert event_search.find_first_pass(CIRCLE, points, [begin], control, given(1.0))[0] > 50  # once round
    after, length = event_search.find_first_pass(CIRCLE, points, [off, on], control, given(1.0))
    here = jax.tree.map(lambda leaf: leaf[after], points)
    assert close(event_search.take_step(CIRCLE, here, length, control, given(1.0)).z, on, 1e-12)
    assert {k for _, _, k in event_search.find_near_passes(points, np.array([off, on, [0.0, 0.0]]), control)} == {0, 1}


def test_directions_at_crossings():
    """With weighted lengths; without weights they are in the properties."""
    scale, zero = np.array([2.0, 0.5]), np.zeros(2)
    fork = branch_point_tangents.branch_tangents(PITCHFORK, zero, scale, given(0.0))
    assert same_tangents(fork, [[1, 0], [0, 1]], scale)
    assert close(
        abs(branch_point_tangents.less_aligned_tangent(fork, np.array([0.1, 1.0]), scale)), [1 / scale[0], 0], 1e-14
    )
    with pytest.raises(ValueError, match="no branches cross"):
        branch_point_tangents.branch_tangents(CIRCLE, zero, scale, given(0.0))


@pytest.mark.parametrize("size", [2, 5])
def test_pairs_have_the_products_and_sums_of_eigenvalues(size):
    for matrix in np.random.default_rng(size).normal(size=(5, size, size)):
        values = np.linalg.eigvals(matrix)
        pairs = [(values[i], values[k]) for i in range(size) for k in range(i)]
        for function, true in (
            (problem.bialternate_product, [a * b - 1 for a, b in pairs]),
            (problem.bialternate_sum, [a + b for a, b in pairs]),
        ):
            found = np.linalg.eigvals(np.asarray(function(jnp.array(matrix))))
            assert len(found) == len(true)
            assert close(np.poly(found).real, np.poly(true).real, 1e-9 * abs(np.poly(true)).max())


def test_branches_together_are_as_one_by_one():
    """A fourth branch, whose start is not finite, does not disturb them."""
    a = [1.0, -0.5, 2.5]
    starts = [np.array([-2.0, -8.0 + 2.0 * each]) for each in a]
    places = [
        place_of(z, event_search.unit_tangent(CUSP, z, np.ones(2), given(each)))
        for z, each in zip(starts, a, strict=True)
    ]
    places.append(place_of([-2.0, np.nan], places[0].tangent))
    controls = [control_of(2, max_step=0.02, lower=-9.0, upper=high) for high in (-8.5, 40.0, 20.0, 3.0)]
    taken = [[], [], [], []]

    def goes_on(lane, *chunk):
        taken[lane].append(chunk)
        return lane != 1 or len(taken[lane]) < 2

    event_search.track_branches(CUSP, places, controls, [given(each) for each in (*a, 1.0)], goes_on)
    assert taken.pop()[-1][-1] == arclength.NONFINITE
    alone = [
        list(event_search.track_chunks(CUSP, place, control, given(each)))
        for place, control, each in zip(places, controls, a, strict=False)
    ]
    assert len(alone[0]) == 1 and len(alone[1]) > 2 and len(alone[2]) > len(taken[1]) == 2
    for mine, theirs in zip(taken, (alone[0], alone[1][:2], alone[2]), strict=True):
        for (points, status), (true, true_status) in zip(mine, theirs, strict=True):
            assert status == true_status and points.accepted.all()
            for found, expected in zip(points[:4], true[:4], strict=True):
                assert np.shape(found) == np.shape(expected) and close(found, expected, 1e-12)


def test_lengths_are_weighted():
    scale, z = np.array([3.0, 0.5]), np.array([0.6, 0.8])
    control = control_of(2, max_step=0.1, scale=scale)
    ahead = event_search.unit_tangent(CIRCLE, z, scale, given(1.0))
    task = continuation_loop.ContinuationTask(CIRCLE, given(1.0), control, 0.05, ((-3.0, 3.0),), starts=(z,))
    found = continuation_loop.follow_branch(task, point_of(z, ahead))
    assert found.end is continuation_loop.End.CLOSED
    assert [one.kind for one in found.specials] == ["SN", "SN"]
    assert close([found.points.z[one.row] for one in found.specials], [[0, 1], [0, -1]], 1e-14)
    assert close(np.sum(found.points.z**2, axis=1), 1, 1e-12)
    lengths = np.linalg.norm(scale * np.diff(found.points.z, axis=0), axis=1)
    assert 0.09 < lengths.max() < 0.11


def test_runs_together_are_as_one_by_one_and_may_retry():
    """The lanes of one call, each with its own numbers; a point that a `Watch` refuses is tried again nearer."""

    class Short(continuation_loop.EventDetector):
        refused: frozenset = frozenset()  # the first points beyond -7.9: those of another step are good

        def is_admissible(self, zs, view):
            self.refused = self.refused or frozenset(z.tobytes() for z in zs[zs[:, 1] >= -7.9])
            return np.array([z.tobytes() not in self.refused for z in zs])

    a, highs = (1.0, -0.5, 2.5), (-5.0, 3.0, 3.0)
    starts = [np.array([-2.0, -8.0 + 2.0 * each]) for each in a]
    points = [
        point_of(z, event_search.unit_tangent(CUSP, z, np.ones(2), given(one)))
        for z, one in zip(starts, a, strict=True)
    ]

    def tasks():
        return [
            continuation_loop.ContinuationTask(
                CUSP, given(one), control_of(2, lower=-9.0, upper=high), 0.05, ((-9.0, high),), detector=watch
            )
            for one, high, watch in zip(
                a, highs, (continuation_loop.EventDetector(), Short(), continuation_loop.EventDetector()), strict=True
            )
        ]

    together = continuation_loop.follow_branches(tasks(), points)
    for mine, task, point in zip(together, tasks(), points, strict=True):
        alone = continuation_loop.follow_branch(task, point)
        assert mine.end is alone.end is continuation_loop.End.BOUND
        assert [one[:2] for one in mine.specials] == [one[:2] for one in alone.specials]
        assert close(mine.points.z, alone.points.z, 1e-12)
    assert together[1].points.step[1:].min() < 0.05 <= together[0].points.step[1:-1].min()


@pytest.mark.parametrize(("bound", "end"), [(0.5, "BOUND"), (0.8, "STOPPED")])
def test_an_end_seen_ahead_beyond_a_bound_is_none(bound, end):
    """A `Watch` that looks ahead sees the same end from each point within half a unit of it."""

    class Ahead(continuation_loop.EventDetector):
        def find_early_end(self, task, points):
            z = np.array([np.sqrt(1 - 0.7**2), 0.7])
            (near,) = np.nonzero(abs(z[1] - 0.25 - points.z[:, 1]) < 0.25)
            if not len(near):
                return None
            points = insert_row(first_rows(points, near[-1] + 1), near[-1] + 1, row_at(points, near[-1])._replace(z=z))
            return continuation_loop.Termination(points, SpecialIndex(0, "X", 0.0), continuation_loop.End.STOPPED)

    z = np.array([1.0, 0.0])
    task = continuation_loop.ContinuationTask(
        CIRCLE, given(1.0), control_of(2, max_step=0.1), 0.05, ((-3.0, bound),), detector=Ahead()
    )
    found = continuation_loop.follow_branch(
        task, point_of(z, event_search.unit_tangent(CIRCLE, z, np.ones(2), given(1.0)))
    )
    assert found.end is continuation_loop.End[end]
    assert close(found.points.z[-1, 1], min(bound, 0.7), 1e-15)
    assert [one.kind for one in found.specials] == ["X"] * (bound > 0.7)


def test_a_step_is_kept_only_where_newton_s_method_ended():
    place = place_of([1.0, 1.0], np.array([2.0, 1.0]) / np.sqrt(5))
    points, _ = next(event_search.track_chunks(TWICE, place, control_of(2), given()))
    assert len(points.z) > 5
    assert abs(points.z[:, 0] - points.z[:, 1] ** 2).max() < 1e-9


def test_a_zero_out_of_reach_is_not_looked_for():
    """Of the parabola's two zeros the nearer one is 0.3 away, and the first step from beside its turning point 3.3."""
    asked = []

    def parabola(y):
        asked.append(y)
        return y**2 - 1.0, 2.0 * np.diag(y)

    assert close(augmented_systems.solve_newton(parabola, np.array([0.7]), 0.4).z, [1.0], 1e-14)
    assert close(augmented_systems.solve_newton(parabola, np.array([0.15])).z, [1.0], 1e-14)
    asked.clear()
    assert augmented_systems.solve_newton(parabola, np.array([0.15]), 1.0).z is None and len(asked) == 1


def row_of(what, zs, args, step):
    """Points so far apart as if in a row, each with the tangent towards greater parameters; (points, control)."""
    control = control_of(2)
    rows = []
    for z in np.asarray(zs, float):
        ahead = event_search.unit_tangent(what, z, control.scale, args)
        rows.append(
            event_search.take_step(what, point_of(z, ahead), 0.0, control, args)._replace(step=np.float64(step))
        )
    return arclength.Point(*(np.stack(each) for each in zip(*rows, strict=True))), control


def test_a_jump_to_another_branch_is_told_from_a_crossing():
    _, middle, upper = np.sort(np.roots([-1.0, 0.0, 0.5, 0.01]).real)  # the sheets at p = 0.5: two meet in a fold
    points, control = row_of(PITCHFORK, [[upper - 0.001, 0.499], [middle, 0.5]], given(0.01), 0.8)
    assert event_search.find_jump(PITCHFORK, points, control, given(0.01)) == (1, {})
    points, control = row_of(PITCHFORK, [[upper - 0.001, 0.499], [upper, 0.5]], given(0.01), 0.01)
    assert event_search.find_jump(PITCHFORK, points, control, given(0.01)) == (None, {})
    points, control = row_of(PITCHFORK, [[0.0, -0.2], [0.0, 0.2]], given(0.0), 0.4)
    place, known = event_search.find_jump(PITCHFORK, points, control, given(0.0))
    assert place is None and list(known) == [0] and known[0].kind == "BP" and close(known[0].z, [0, 0], 1e-12)
    assert event_search.find_jump(PITCHFORK, points, control, given(0.0), np.array([True, False]))[0] is None
    assert event_search.find_jump(PITCHFORK, points, control, given(0.0), np.array([False, True])) == (1, {})


def test_a_step_is_cut_in_all_its_entries_alike():
    start, most = jnp.array([3.0, 0.5]), {"max_steps": 1}
    whole, cut = (newton.newton(on_circle, start, each, **most).unknowns - start for each in (jnp.inf, 0.5))
    assert abs(whole).max() > 1.0 and close(abs(cut).max(), 0.5, 1e-15)
    assert close(cut * abs(whole).max(), whole * 0.5, 1e-15)


@pytest.mark.parametrize("before, seen", [(1e-9, 0), (1e-7, 1), (0.1, 1)])
def test_a_crossing_in_which_a_branch_begins_is_not_met_again(before, seen):
    points, control = row_of(PITCHFORK, [[0.0, -before], [0.0, 0.2]], given(0.0), 0.2 + before)
    found = event_search.locate_events(PITCHFORK, points, {}, control, given(0.0))
    assert [one.kind for one in found] == ["BP"] * seen


@pytest.mark.parametrize("far, seen", [(0.1, False), (0.5, False), (1.0, True)])
def test_an_event_lies_within_its_interval(far, seen):
    """The fold of the circle, 0.6 ahead along the tangent."""
    control, z = control_of(2), np.array([0.6, 0.8])
    here = point_of(z, event_search.unit_tangent(CIRCLE, z, control.scale, given(1.0)))
    near = event_search.take_step(CIRCLE, here, 0.1, control, given(1.0))
    found = event_search._event_between(CIRCLE, "SN", here, 3, (0.0, far), near, 0.1, control, given(1.0))
    assert (found is not None) == seen
    if found:
        assert close(found.z, [0.0, 1.0], 1e-14) and close(found.length, 0.6, 1e-14)
