"""Systems with a declared symmetry: where solutions lose it, the branches that leave, and their curves."""

import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
from tests.test_trace import close, kinds


def two_wells(u, p, args):
    """x' = -x + p + q y^2, y' = y (x - 1 + e y^2) in the coordinates (x + y, x - y): at y = 0 x = p, which loses its
    symmetry at p = 1; y comes in as p - 1 + (q + e) y^2 = 0."""
    x, y = 0.5 * (u[0] + u[1]), 0.5 * (u[0] - u[1])
    along, across = -x + p["p"] + p["q"] * y * y, y * (x - 1.0 + p["e"] * y * y)
    return jnp.stack([along + across, along - across])


def swapped(u):
    return u[::-1]


WELLS = co.equilibria(two_wells, symmetry=swapped)
AT = {"p": 0.5, "q": -0.3, "e": -0.5}


def test_where_a_symmetry_is_lost_and_what_leaves_there():
    found = co.trace(WELLS, [0.4, 0.4], AT, "p", (0.0, 1.5))
    assert kinds(found) == ["SB"] and close(found.points("SB")[0].z, [1, 1, 1], 1e-14)
    assert np.array_equal(found.u[:, 0], found.u[:, 1])
    twins = co.switch(found.points("SB")[0])
    for one in twins:
        y = 0.5 * (one.u[:, 0] - one.u[:, 1])
        assert kinds(one) == [] and close(one.p["p"] - 1.0, 0.8 * y * y, 1e-11) and one.stable[1:].all()
    assert twins[0].u[-1, 0] - twins[0].u[-1, 1] < 0 < twins[1].u[-1, 0] - twins[1].u[-1, 1] or np.allclose(
        twins[0].u, twins[1].u[:, ::-1]
    )
    back = co.trace(WELLS, twins[0].u[-1], AT | {"p": 1.5}, "p", (0.9, 1.6))
    assert kinds(back) == ["SB"] and close(back.points("SB")[0].z, [1, 1, 1], 1e-12)


def test_its_curve_and_where_it_turns_from_soft_to_hard():
    (point,) = co.trace(WELLS, [0.4, 0.4], AT, "p", (0.0, 1.5)).points("SB")
    curve = co.curve(point, ("p", "q"), {"p": (0.0, 2.0), "q": (-1.0, 1.0)})
    assert close(curve.p["p"], 1.0, 1e-12) and kinds(curve) == ["DSB"]
    assert close(curve.points("DSB")[0].z, [1, 1, 1, 0.5], 1e-12)
    assert close(co.sensitivity(point, ["q", "e"]), [0, 0], 1e-12)


def test_a_map_with_a_symmetry():
    cubic = co.fixed_points(lambda u, p, args: p["p"] * u - u**3, symmetry=jnp.negative)
    found = co.trace(cubic, [0.0], {"p": 0.0}, "p", (-3.0, 3.0))
    assert kinds(found) == ["PD", "SB"] and close([one.p["p"] for one in found.special[1:3]], [-1, 1], 1e-14)
    assert [len(kinds(one)) for one in co.switch(found.points("SB")[0])] == [1, 1]  # a doubling each, at p = 2


def test_what_is_no_symmetry_is_refused():
    for wrong in (lambda u: 2.0 * u, lambda u: jnp.stack([u[0], -u[1]])):
        with pytest.raises(co.ContinuationError) as told:
            co.trace(co.equilibria(two_wells, symmetry=wrong), [0.4, 0.4], AT, "p", (0.0, 1.5))
        assert told.value.key == "symmetry"
