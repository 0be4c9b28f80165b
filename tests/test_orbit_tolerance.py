"""Periodic orbits by an integrator of any tolerance: from the Hopf point on, against SciPy's."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import continuation as co
from continuation.shooting import periodic_orbits


def brusselator(u, p, args):
    x, y = u
    return jnp.stack([p["a"] - (p["b"] + 1.0) * x + x * x * y, p["b"] * x - x * x * y])


def predators(u, p, args):
    """Rosenzweig and MacArthur's predator and prey."""
    x, y = u
    eaten = x * y / (0.3 + x)
    return jnp.stack([x * (1.0 - x / p["k"]) - eaten, eaten - 0.4 * y])


CASES = {
    "brusselator": (brusselator, [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0)),
    "predators": (predators, [0.2, 0.3], {"k": 0.5}, "k", (0.45, 1.2)),
}


def hopf(name):
    field, start, at, along, bounds = CASES[name]
    (found,) = co.trace(co.equilibria(field), start, at, along, bounds).points("HB")
    return found


def settled_period(name, value):
    """The period of the cycle that a long run of SciPy's settles on."""
    field, start, at, along, _ = CASES[name]
    p = at | {along: value}

    def rate(t, u):
        return np.asarray(field(u, p, None))

    run = solve_ivp(rate, (0.0, 600.0), np.array(start) * 1.2, method="DOP853", rtol=1e-11, atol=1e-12)
    middle = 0.5 * (run.y[0, len(run.t) // 2 :].max() + run.y[0, len(run.t) // 2 :].min())
    crossing = lambda t, u: u[0] - middle  # noqa: E731
    crossing.direction = 1.0
    last = solve_ivp(rate, (0.0, 100.0), run.y[:, -1], "DOP853", events=crossing, rtol=1e-11, atol=1e-12)
    return float(np.diff(last.t_events[0])[-1])


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("tolerance", [1e-7, 1e-9])
def test_orbits_leave_a_hopf_point_whatever_the_integrators_tolerance(name, tolerance):
    point, (field, _, _, along, bounds) = hopf(name), CASES[name]
    orbits = periodic_orbits(field, segments=4, tolerance=tolerance)
    (cycles,) = co.switch(point, orbits=orbits, largest_step=0.2)
    assert abs(cycles.p[along][0] - point.p[along]) < 1e-3
    assert cycles.p[along][-1] == pytest.approx(bounds[1], abs=1e-6) and "bound" in cycles.reasons[1]
    assert cycles.u[-1, -1] == pytest.approx(settled_period(name, bounds[1]), rel=100 * tolerance)


@pytest.mark.parametrize("name", CASES)
def test_a_tolerance_below_that_of_the_integrator_is_refused(name):
    orbits = periodic_orbits(CASES[name][0], tolerance=1e-9)
    with pytest.raises(co.ContinuationError, match=r"tolerance: must be at least 1e-08, 10 times .*periodic_orbits"):
        co.switch(hopf(name), orbits=orbits, tolerance=1e-10)
