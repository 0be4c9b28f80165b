"""Periodic orbits: by flows in closed form, where all is known, and (slow) by diffrax against others' solvers."""

from math import factorial

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
from continuation.problem import ORBITS, System
from continuation.shooting import periodic_orbits, settled
from tests.test_trace import brusselator, close, kinds


def exprel(x):
    """(exp(x) - 1) / x, smooth at 0."""
    small = abs(x) < 0.02
    safe = jnp.where(small, 1.0, x)
    series = 1.0 + x / 2 * (1.0 + x / 3 * (1.0 + x / 4 * (1.0 + x / 5 * (1.0 + x / 6))))
    return jnp.where(small, series, jnp.expm1(safe) / safe)


def ring(u, time, speed):
    """(angle at the start, a circle of radius 1 that attracts, the angle at the end)."""
    size, angle = jnp.hypot(u[0], u[1]), jnp.arctan2(u[1], u[0])
    new = 1.0 / jnp.sqrt(1.0 + (1.0 / size**2 - 1.0) * jnp.exp(-2.0 * time))
    after = angle + speed * time
    return angle, new * jnp.stack([jnp.cos(after), jnp.sin(after)]), after


def band(u, time, p, args):
    """About the circle a strip that makes half a turn in a round, along which a' = m a - a^3, b' = -b."""
    before, middle, after = ring(u, time, p["w"])
    (e, n), (f, k) = (
        [jnp.stack([jnp.cos(h), jnp.sin(h)]), jnp.stack([-jnp.sin(h), jnp.cos(h)])] for h in (before / 2, after / 2)
    )
    a, b = u[2:] @ e, u[2:] @ n
    a = a * jnp.exp(p["m"] * time) / jnp.sqrt(1.0 + 2.0 * a * a * time * exprel(2.0 * p["m"] * time))
    return jnp.concatenate([middle, a * f + b * jnp.exp(-time) * k])


def spiral(u, time, p, args):
    """About the circle a spiral, c' = (m + i k) c."""
    middle = ring(u, time, 1.0)[1]
    cos, sin = jnp.cos(p["k"] * time), jnp.sin(p["k"] * time)
    return jnp.concatenate([middle, jnp.exp(p["m"] * time) * jnp.array([[cos, -sin], [sin, cos]]) @ u[2:]])


def flown(fly, segments):
    def field(u, p, args):
        return jax.jvp(lambda time: fly(u, time, p, args), (0.0,), (1.0,))[1]

    return System(field, ORBITS, 1, fly, segments)


def circle(segments, speed=1.0):
    angles = 2.0 * np.pi * np.arange(segments) / segments
    points = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles, 0.0 * angles], 1)
    return np.append(points.reshape(-1), 2.0 * np.pi / speed)


def test_a_period_doubling_and_the_doubled_orbit():
    found = co.trace(flown(band, 3), circle(3, 1.5), {"m": -0.2, "w": 1.5}, "m", (-0.3, 0.3))
    assert kinds(found) == ["PD"]
    (doubling,) = found.points("PD")
    assert close([doubling.p["m"], doubling.u[-1]], [0, 2 * np.pi / 1.5], 1e-12)
    rounds = 2 * np.pi / 1.5
    true = np.sort(
        [-np.exp(rounds * found.p["m"]), 0 * found.p["m"] - np.exp(-rounds), 0 * found.p["m"] + np.exp(-2 * rounds)],
        axis=0,
    )
    assert close(np.sort(found.eigenvalues.real, axis=1), true.T, 1e-12)
    assert (found.stable == (found.p["m"] < -1e-12)).all()
    (double,) = co.switch(doubling)
    assert kinds(double) == [] and close(double.u[:, -1], 2 * rounds, 1e-11)
    assert close(double.u[:, 2] ** 2 + double.u[:, 3] ** 2, double.p["m"], 1e-11)
    assert close(double.eigenvalues[:, 0].real, np.exp(-4 * rounds * double.p["m"]), 1e-10)


def test_a_neimark_sacker_point_of_an_orbit_and_its_curve():
    found = co.trace(flown(spiral, 1), circle(1), {"m": -0.1, "k": 0.29}, "m", (-0.2, 0.2))
    assert kinds(found) == ["NS"]
    (point,) = found.points("NS")
    assert found.eigenvalues.shape == (len(found), 3)  # without that of the field's own direction
    assert close(point.p["m"], 0, 1e-12)
    assert close(np.sort(np.angle(point.eigenvalues[:2])), 2 * np.pi * np.array([-0.29, 0.29]), 1e-11)
    curve = co.curve(point, ("m", "k"), {"m": (-1.0, 1.0), "k": (0.2, 0.4)})
    assert close(curve.p["m"], 0, 1e-12) and sorted(kinds(curve)) == ["R3", "R4"]
    assert close([curve.points(kind)[0].p["k"] for kind in ("R3", "R4")], [1 / 3, 1 / 4], 1e-11)


def rings(u, time, p, args):
    """Circles whose radii x + 2 move as x' = q - x^2, q = 1 / 4 - m^2, the angle by 1 + m / 5 + 3 x / 10."""
    x, angle = jnp.hypot(u[0], u[1]) - 2.0, jnp.arctan2(u[1], u[0])
    q = 0.25 - p["m"] ** 2
    even, odd = (np.array([1.0 / factorial(2 * k + one) for k in range(12, -1, -1)]) for one in (0, 1))
    c, s = jnp.polyval(even, q * time**2), jnp.polyval(odd, q * time**2)  # cosh(root of q, times time), sinh over that
    grown = c + x * s * time
    size, after = (x * c + q * s * time) / grown + 2.0, angle + (1.0 + p["m"] / 5.0) * time + 0.3 * jnp.log(grown)
    return size * jnp.stack([jnp.cos(after), jnp.sin(after)])


def test_an_isola_of_orbits_closes_whatever_its_phase():
    angles = np.pi * np.arange(2)
    points = 2.5 * np.stack([np.cos(angles), np.sin(angles)], 1)
    start = np.append(points.reshape(-1), 2.0 * np.pi / 1.15)
    branch = co.trace(flown(rings, 2), start, {"m": 0.0}, "m", (-2.0, 2.0))
    sizes, m = np.hypot(*branch.u.T[:2]), branch.p["m"]
    close(np.stack([(sizes - 2.0) ** 2 + m**2]), np.full((1, len(m)), 0.25), 1e-10)
    close(branch.u[:, -1], 2.0 * np.pi / (1.0 + m / 5.0 + 0.3 * (sizes - 2.0)), 1e-10)
    assert "closes" in branch.reason["last"]
    assert sorted(round(one.p["m"], 10) for one in branch.points("SN")) == [-0.5, 0.5]
    assert abs(sizes[-1] - sizes[0]) < 1e-9 and abs(branch.u[-1] - branch.u[0]).max() > 1e-5  # at another phase


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: periodic_orbits(brusselator, segments=0), "segments"),
        (lambda: periodic_orbits(brusselator, tolerance=2.0), "tolerance"),
        (lambda: settled(co.equilibria(brusselator), [1.0, 1.0], 6.0, {}), "system"),
        (lambda: settled(periodic_orbits(brusselator), [1.0, 1.0, 1.0], 6.0, {"a": 1.0, "b": 3.0}), "start"),
        (lambda: co.trace(flown(spiral, 2), np.ones(8), {"m": 0.0, "k": 0.3}, "m", (-1.0, 1.0)), "u"),
    ],
)
def test_what_cannot_be_is_refused(call, key):
    with pytest.raises(co.ContinuationError) as told:
        call()
    assert told.value.key == key


def taylor_orbit(u, period, b):
    """(u, the period, the multiplier) of the Brusselator's orbit near one, by Newton's method on heyoka's flow."""
    x, y, *changes = hy.make_vars("x", "y", "c", "d")
    field = [1.0 - (hy.par[0] + 1.0) * x + x * x * y, hy.par[0] * x - x * x * y]
    varied = [sum(hy.diff(each, one) * more for one, more in zip((x, y), changes, strict=True)) for each in field]
    flight = hy.taylor_adaptive(list(zip((x, y, *changes), [*field, *varied], strict=True)), [0.0] * 4, tol=1e-18)
    flight.pars[0] = b

    def at(u):
        return np.array([1.0 - (b + 1.0) * u[0] + u[0] ** 2 * u[1], b * u[0] - u[0] ** 2 * u[1]])

    start, across = u, at(u)
    for _ in range(8):
        columns = []
        for unit in np.eye(2):
            flight.time, flight.state[:] = 0.0, [*u, *unit]
            flight.propagate_until(period)
            end, column = flight.state[:2].copy(), flight.state[2:].copy()
            columns.append(column)
        monodromy = np.stack(columns, 1)
        matrix = np.block([[monodromy - np.eye(2), at(end)[:, None]], [across[None], np.zeros((1, 1))]])
        change = np.linalg.solve(matrix, np.append(end - u, across @ (u - start)))
        u, period = u - change[:2], period - change[2]
    return u, period, np.linalg.det(monodromy)


def test_the_brusselator_from_its_hopf_point_and_back():
    at, orbits = {"a": 1.0, "b": 1.0}, periodic_orbits(brusselator, segments=4)
    (hopf,) = co.trace(co.equilibria(brusselator), [1.0, 1.0], at, "b", (0.5, 3.0)).points("HB")
    (found,) = co.switch(hopf, orbits=orbits, first_step=0.05, largest_step=0.5)
    assert kinds(found) == [] and found.p["b"][-1] == 3.0 and found.stable.all()
    for k in range(0, len(found), 3):
        u, period, multiplier = taylor_orbit(found.u[k, :2], found.u[k, -1], found.p["b"][k])
        assert close(found.u[k, :2], u, 1e-10) and close(found.u[k, -1], period, 1e-10)
        assert close(found.eigenvalues[k].real, [multiplier], 1e-10)
    start = settled(orbits, [1.0, 1.0], 6.4, at | {"b": 2.3}, rounds=20)
    back = co.trace(orbits, start, at | {"b": 2.3}, "b", (1.5, 2.5), largest_step=0.5, direction="backward")
    assert kinds(back) == ["HB"] and back.reasons[0] == "it ends in the Hopf point at 2"
    assert close(back.points("HB")[0].z, [*[1, 2] * 4, 2 * np.pi, 2], 1e-12)
