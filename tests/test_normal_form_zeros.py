"""Curves of special points in two parameters whose points of codimension two are known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
from continuation.normal_forms import lyapunov_coefficient
from continuation.problem import SystemConstants
from tests.test_trace import brusselator, close, kinds

MIX = np.array([[1.0, 0.4], [-0.3, 2.0]])


def bent(w):
    """A change of coordinates in the plane; `unbent` takes it back."""
    x, y = w
    return jnp.stack([x, y + 0.3 * x * x])


def unbent(u):
    x, y = u
    return jnp.stack([x, y - 0.3 * x * x])


def oscillator(u, p, args):
    """z' = (m + i 1.3) z + q z |z|^2 - z |z|^4 in other coordinates."""
    x, y = unbent(jnp.asarray(np.linalg.inv(MIX)) @ u)
    size = x * x + y * y
    grow = p["m"] + p["q"] * size - size * size
    dx, dy = grow * x - 1.3 * y, grow * y + 1.3 * x
    return MIX @ jnp.stack([dx, dy + 0.6 * x * dx])


def turning(u, p, args):
    """The map z -> exp(0.9 i) (1 + m + q |z|^2) z in other coordinates."""
    x, y = unbent(jnp.asarray(np.linalg.inv(MIX)) @ u)
    size, cos, sin = 1.0 + p["m"] + p["q"] * (x * x + y * y), np.cos(0.9), np.sin(0.9)
    return MIX @ bent(size * jnp.stack([cos * x - sin * y, sin * x + cos * y]))


def linear_pair(u, p, args):
    """Multipliers at 0 with product s and sum t."""
    x, y = u
    return jnp.stack([y, -p["s"] * x + p["t"] * y + x * x])


def cubic(u, p, args):
    return -(1.0 + p["m"]) * u + p["a"] * u**2 - 0.49 * u**3


@pytest.mark.parametrize(
    ("system", "kind", "label"), [(co.equilibria(oscillator), "HB", "GH"), (co.fixed_points(turning), "NS", "CH")]
)
def test_where_what_is_born_changes_from_stable_to_unstable(system, kind, label):
    found = co.trace(system, np.zeros(2), {"m": -0.1, "q": 0.35}, "m", (-0.2, 0.3))
    (point,) = found.points(kind)
    curve = co.curve(point, ("m", "q"), {"m": (-0.5, 0.5), "q": (-1.0, 1.0)})
    assert kinds(curve) == [label]
    assert close(curve.points(label)[0].z, np.zeros(4), 1e-12)
    numbers = [
        lyapunov_coefficient(system, kind, ("m", "q"), np.array([0.0, 0.0, 0.0, q]), SystemConstants({}, None))
        for q in (0.5, -0.2)
    ]
    assert numbers[0] > 0 > numbers[1] and close(numbers[0] / numbers[1], -2.5, 1e-12)


def test_resonances_by_the_angle_of_the_multipliers():
    found = co.trace(co.fixed_points(linear_pair), np.zeros(2), {"s": 0.8, "t": 0.5}, "s", (0.7, 1.2))
    curve = co.curve(found.points("NS")[0], ("s", "t"), {"s": (0.5, 1.5), "t": (-2.5, 1.5)})
    assert sorted(kinds(curve)) == ["R2", "R3", "R4"]
    for label, value in (("R2", -2.0), ("R3", -1.0), ("R4", 0.0)):
        assert close(curve.points(label)[0].z, [0, 0, 1, value], 1e-11)


def test_generalized_period_doublings_of_a_cubic_map():
    """x -> -x + a x^2 + b x^3 has the coefficient a^2 + b."""
    found = co.trace(co.fixed_points(cubic), [0.0], {"m": -0.1, "a": 0.1}, "m", (-0.2, 0.2))
    curve = co.curve(found.points("PD")[0], ("m", "a"), {"m": (-0.5, 0.5), "a": (-1.0, 1.0)})
    assert kinds(curve) == ["GPD", "GPD"]
    assert close(sorted(one.p["a"] for one in curve.points("GPD")), [-0.7, 0.7], 1e-12)
    assert close([one.z[:2] for one in curve.points("GPD")], 0, 1e-12)


def test_the_lyapunov_coefficient_of_the_brusselator():
    """With q = (-a^2, a^2 + i a) over its length, a sqrt(1 + 2 a^2)."""
    for a in (0.5, 1.0, 1.7):
        z = np.array([a, (1 + a * a) / a, 1 + a * a])
        found = lyapunov_coefficient(co.equilibria(brusselator), "HB", ("b",), z, SystemConstants({"a": a}, None))
        assert close(found, -(2 + a * a) / (2 * a * (1 + 2 * a * a)), 1e-12)
