"""The numerics that know no oscillator, piece by piece; whole branches are in test_arclength.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from continuation import arclength, follow, newton, problem, switch
from continuation.linear import solve
from tests.test_arclength import CIRCLE, CUSP, HENON, KNOTS, PITCHFORK, TRANSCRITICAL, close, control_of, place_of, walk


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
    assert solve(jnp.ones((3, 3)), jnp.arange(3.0)).worst == 0


def test_newton_finds_a_point_to_rounding():
    found = newton.newton(on_circle, jnp.array([3.0, 0.5]))
    assert found.status == newton.OK
    assert np.allclose(found.unknowns, np.sqrt(2.0), rtol=0, atol=1e-15)
    assert found.residual < 1e-14


def test_newton_says_why_it_failed():
    def none(point):  # x^2 + 1 = 0
        return point * point + 1.0, jnp.diag(2.0 * point)

    def double(point):  # x^2 = 0, y = 0: each step halves x
        x, y = point
        return jnp.stack([x * x, y]), jnp.diag(jnp.stack([2.0 * x, 1.0]))

    def flat(point):
        return jnp.stack([point[0] - 1.0, point[0] - 1.0]), jnp.array([[1.0, 0.0], [1.0, 0.0]])

    assert newton.newton(none, jnp.array([0.3])).status == newton.SLOW
    assert newton.newton(double, jnp.array([1.0, 1.0]), most=25).status == newton.SINGULAR
    assert newton.newton(flat, jnp.array([0.0, 0.0])).status == newton.SINGULAR
    assert newton.newton(on_circle, jnp.array([jnp.nan, 1.0])).status == newton.NONFINITE


def test_a_step_is_cut_and_lanes_do_not_disturb_each_other():
    starts = jnp.array([[3.0, 0.5], [jnp.nan, 1.0], [-5.0, -4.0]])
    found = jax.vmap(lambda start: newton.newton(on_circle, start, longest=0.5))(starts)
    assert np.array_equal(found.status, [newton.OK, newton.NONFINITE, newton.OK])
    assert np.allclose(found.unknowns[2], -np.sqrt(2.0), rtol=0, atol=1e-15)


def same_tangents(found, true, scale):
    """Whether two tangents are two directions' unit tangents, in any order, with any sign, to 1e-12."""
    true = np.array(true) / np.linalg.norm(scale * np.array(true), axis=1)[:, None]
    apart = [[min(abs(one - two).max(), abs(one + two).max()) for two in true] for one in found]
    return set(np.argmin(apart, axis=1)) == {0, 1} and np.min(apart, axis=1).max() < 1e-12


def test_marks_on_a_branch():
    control = control_of(2)
    points, _ = next(follow.stretches(CIRCLE, place_of([1.0, 0.0], [0.0, 1.0]), control, 1.0))
    on, off = np.array([0.28, 0.96]), np.array([0.28, 0.96 + 1e-4])
    assert follow.passes_mark(CIRCLE, points, [off], control, 1.0) is None
    after, length = follow.passes_mark(CIRCLE, points, [off, on], control, 1.0)
    here = jax.tree.map(lambda leaf: leaf[after], points)
    assert close(follow.step(CIRCLE, here, length, control, 1.0).z, on, 1e-12)
    assert {k for _, _, k in follow.meets(points, np.array([off, on, [0.0, 0.0]]), control)} == {0, 1}


def test_tangents():
    assert close(follow.tangent(CIRCLE, np.array([0.6, 0.8]), np.ones(2), 1.0), [-0.8, 0.6], 1e-15)
    assert close(follow.tangent(CIRCLE, np.array([0.6, 0.8]), np.ones(2), 1.0, [1, 0]), [0.8, -0.6], 1e-15)
    weighted = follow.tangent(CIRCLE, np.array([0.6, 0.8]), np.array([2.0, 0.5]), 1.0)
    assert close(weighted, np.array([-0.8, 0.6]) / np.hypot(1.6, 0.3), 1e-15)
    left_out = follow.oriented(np.array([[1.0, 7.0, -2.0]]), np.array([1.0, 0.0, 1.0]))
    assert close(left_out, np.array([2.0, 0.0, 1.0]) / np.sqrt(5), 1e-15)


@pytest.mark.parametrize("scale", [np.ones(2), np.array([2.0, 0.5])])
def test_directions_at_crossings(scale):
    zero = np.zeros(2)
    fork = switch.directions(PITCHFORK, zero, scale, 0.0)
    assert same_tangents(fork, [[1, 0], [0, 1]], scale)
    assert close(abs(switch.other(fork, np.array([0.1, 1.0]), scale)), [1 / scale[0], 0], 1e-14)
    assert same_tangents(switch.directions(TRANSCRITICAL, zero, scale, None), [[1, 1], [0, 1]], scale)
    crossing, wide = np.array([3, 3, 27 * np.exp(-3)]), np.append(scale, 3.0)
    both = switch.directions(KNOTS, crossing, wide, None)
    assert same_tangents(both, [[1, 1, -18 * np.exp(-3)], [1, -1, 0]], wide)
    with pytest.raises(ValueError, match="no branches cross"):
        switch.directions(CIRCLE, zero, scale, 0.0)


@pytest.mark.parametrize("size", [2, 3, 4, 5])
def test_pairs_have_the_products_of_eigenvalues(size):
    for matrix in np.random.default_rng(size).normal(size=(5, size, size)):
        values = np.linalg.eigvals(matrix)
        products = [values[i] * values[k] - 1 for i in range(size) for k in range(i)]
        found = np.linalg.eigvals(np.asarray(problem.pairs(jnp.array(matrix))))
        assert len(found) == len(products)
        assert close(np.poly(found).real, np.poly(products).real, 1e-9 * abs(np.poly(products)).max())


def test_lanes_of_branches_do_not_disturb_each_other():
    a = np.array([1.0, -0.5, 2.5, 1.0, 1.0])
    starts = np.stack([np.full(5, -2.0), -8.0 + 2.0 * a], 1)
    starts[4, 1] = np.nan
    highs = np.array([-5.0, -3.0, 5.0, 0.0, 3.0])
    tangents = np.stack([follow.tangent(CUSP, z, np.ones(2), one) for z, one in zip(starts[:4], a, strict=False)])
    places = [place_of(z, t) for z, t in zip(starts, [*tangents, tangents[0]], strict=True)]
    controls = [control_of(2, low=-9.0, high=high) for high in highs]

    def track(place, control, a):
        return arclength.track(CUSP.function, CUSP.solve, place, control, a, 80)

    def stacked(trees):
        return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)

    together = jax.jit(jax.vmap(track))(stacked(places), stacked(controls), a)
    alone = stacked([jax.jit(track)(*each) for each in zip(places, controls, a, strict=True)])
    (place, points), (true_place, true) = together, alone
    assert np.array_equal(points.kept, true.kept)
    assert len(set(points.kept.sum(axis=1).tolist())) == 5
    assert np.array_equal(place.status, true_place.status)
    assert list(place.status) == [arclength.OUT] * 2 + [arclength.ON, arclength.OUT, arclength.NONFINITE]
    for found, expected in ((points.z, true.z), (points.tangent, true.tangent), (points.step, true.step)):
        assert close(np.where(points.kept.T, found.T, 0), np.where(true.kept.T, expected.T, 0), 1e-12)
    assert np.allclose(place.z, true_place.z, rtol=0, atol=1e-12, equal_nan=True)


def test_branches_together_are_as_one_by_one():
    a = [1.0, -0.5, 2.5]
    starts = [np.array([-2.0, -8.0 + 2.0 * each]) for each in a]
    places = [place_of(z, follow.tangent(CUSP, z, np.ones(2), each)) for z, each in zip(starts, a, strict=True)]
    controls = [control_of(2, largest=0.02, low=-9.0, high=high) for high in (-8.5, 40.0, 20.0)]
    taken = [[], [], []]

    def goes_on(lane, *chunk):
        taken[lane].append(chunk)
        return lane != 1 or len(taken[lane]) < 2

    follow.together(CUSP, places, controls, a, goes_on)
    alone = [list(follow.stretches(CUSP, *each)) for each in zip(places, controls, a, strict=True)]
    assert len(alone[0]) == 1 and len(alone[1]) > 2 and len(alone[2]) > len(taken[1]) == 2
    for mine, theirs in zip(taken, (alone[0], alone[1][:2], alone[2]), strict=True):
        for (points, status), (true, true_status) in zip(mine, theirs, strict=True):
            assert status == true_status and points.kept.all()
            for found, expected in zip(points[:4], true[:4], strict=True):
                assert np.shape(found) == np.shape(expected) and close(found, expected, 1e-12)


@pytest.mark.parametrize("scale", [np.ones(2), np.array([4.0, 0.2])])
def test_a_point_with_one_number_given(scale):
    control = control_of(2, scale=scale, tolerance=1e-3)  # of steps alone
    for index, value, true in (
        (0, 0.6, [0.6, 0.8]),
        (1, 0.6, [0.8, 0.6]),
        (0, 0.0, [0, 1]),
        (-1, -0.28, [0.96, -0.28]),
    ):
        found = follow.pinned(CIRCLE, np.array([0.7, 0.7]), index, value, control, 1.0)
        assert found.met
        assert found.z[index] == value
        assert close(found.z, true, 1e-15)
    assert not follow.pinned(CIRCLE, np.array([0.7, 0.7]), 0, 1.1, control, 1.0).kept
    found = follow.pinned(HENON, np.array([0.3, 0.4, 0.0]), 2, 0.3675, control_of(3), 0.3)
    assert close(found.z, [0.35, 0.35, 0.3675], 1e-15)


def test_lengths_are_weighted():
    scale = np.array([3.0, 0.5])
    found = walk(CIRCLE, [0.6, 0.8], 1.0, largest=0.1, scale=scale)
    assert found.kinds == ["SN", "SN"]
    assert close(found.met, [[0, 1], [0, -1]], 1e-14)
    assert close(np.sum(found.z**2, axis=1), 1, 1e-12)
    assert found.closed
    lengths = np.linalg.norm(scale * np.diff(found.z, axis=0), axis=1)
    assert 0.09 < lengths.max() < 0.11
