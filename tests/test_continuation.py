"""The numerics that know no oscillator: small linear systems, Newton's method and its statuses."""

import jax
import jax.numpy as jnp
import numpy as np

from continuation import newton
from continuation.linear import solve


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
