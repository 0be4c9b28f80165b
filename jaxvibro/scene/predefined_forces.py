"""Define the predefined forces, which scene files may name: accelerations as functions of (t, x, v, numbers).

All quantities are in units of the scene.
"""

import re

import jax.numpy as jnp


def duffing(t, x, v, params):
    """Evaluate a spring that stiffens or softens: ``-x - cubic x^3 - 2 damping v``."""
    return -x - params["cubic"] * x**3 - 2.0 * params["damping"] * v


def polynomial(t, x, v, params):
    """Evaluate a polynomial spring with the given coefficients: ``-(c0 + c1 x + c2 x^2 + ...) - 2 damping v``."""
    spring_force = sum((params[name] * x ** int(name[1:]) for name in sorted(params) if name != "damping"), 0.0 * x)
    return -spring_force - 2.0 * params["damping"] * v


def pendulum(t, x, v, params):
    """Evaluate a pendulum, x being its angle in rad: ``-sin x - 2 damping v``."""
    return -jnp.sin(x) - 2.0 * params["damping"] * v


def stribeck(t, x, v, params):
    """Evaluate a block on a belt with smoothed dry friction.

    The acceleration is ``-x - (low + (high - low) exp(-(u / slip)^2)) tanh(u / smooth)`` with ``u = v - belt``.
    """
    slip_velocity = v - params["belt"]
    friction = params["low"] + (params["high"] - params["low"]) * jnp.exp(-((slip_velocity / params["slip"]) ** 2))
    return -x - friction * jnp.tanh(slip_velocity / params["smooth"])


def van_der_pol(t, x, v, params):
    """Evaluate a self-excited oscillator: ``-x + gain (1 - x^2) v``."""
    return -x + params["gain"] * (1.0 - x * x) * v


def tabulated(t, x, v, params):
    """Evaluate a measured spring and a damper: ``-f(x) - 2 damping v``.

    f interpolates the forces f0, f1, ... at three or more positions x0 < x1 < ... by cubics. The slope
    at a position is that of the parabola through three neighbouring points. Beyond the ends f is linear.
    """
    knot_positions, knot_forces = (
        jnp.stack([params[f"{name_letter}{knot_index}"] for knot_index in range(count_knots(params))])
        for name_letter in "xf"
    )
    knot_distances, secant_slopes = jnp.diff(knot_positions), jnp.diff(knot_forces) / jnp.diff(knot_positions)
    inner_parabola_slopes = (knot_distances[1:] * secant_slopes[:-1] + knot_distances[:-1] * secant_slopes[1:]) / (
        knot_distances[1:] + knot_distances[:-1]
    )
    knot_slopes = jnp.concatenate(
        [
            2.0 * secant_slopes[:1] - inner_parabola_slopes[:1],
            inner_parabola_slopes,
            2.0 * secant_slopes[-1:] - inner_parabola_slopes[-1:],
        ]
    )
    interval_index = jnp.sum(x >= knot_positions[1:-1])
    interval_width, secant_slope, left_slope, right_slope = (
        knot_distances[interval_index],
        secant_slopes[interval_index],
        knot_slopes[interval_index],
        knot_slopes[interval_index + 1],
    )
    interval_fraction = jnp.clip((x - knot_positions[interval_index]) / interval_width, 0.0, 1.0)
    spring_force = knot_forces[interval_index] + interval_width * interval_fraction * (
        left_slope
        + interval_fraction
        * (
            3.0 * secant_slope
            - 2.0 * left_slope
            - right_slope
            + interval_fraction * (left_slope + right_slope - 2.0 * secant_slope)
        )
    )
    extrapolated_force = knot_slopes[0] * jnp.minimum(x - knot_positions[0], 0.0) + knot_slopes[-1] * jnp.maximum(
        x - knot_positions[-1], 0.0
    )
    return -(spring_force + extrapolated_force) - 2.0 * params["damping"] * v


def count_knots(params):
    """Return the number of positions of a `tabulated` force."""
    return sum(name[0] == "x" for name in params)


NAMED_FORCES = {force.__name__: force for force in (duffing, polynomial, pendulum, stribeck, van_der_pol, tabulated)}

PARAMETER_NAMES = {
    duffing: ("cubic", "damping"),
    pendulum: ("damping",),
    stribeck: ("belt", "low", "high", "slip", "smooth"),
    van_der_pol: ("gain",),
}
COEFFICIENT_PATTERN = re.compile(r"c(0|[1-9]\d?)")


def expected_names_if_wrong(function, names):
    """Return the expected parameter names as a text; None if `names` are valid or the force is user-defined."""
    if function is polynomial:
        noncoefficient_names = [name for name in names if not COEFFICIENT_PATTERN.fullmatch(name)]
        return None if noncoefficient_names == ["damping"] else "c0, c1, c2, ... c99, those that are to be, and damping"
    expected_names = PARAMETER_NAMES.get(function)
    return None if expected_names is None or set(names) == set(expected_names) else ", ".join(expected_names)


def force_name(function):
    """Return the name of the function of a force.

    Parameters
    ----------
    function : callable
        The force.

    Returns
    -------
    str
        The name.
    """
    return getattr(function, "__name__", "force")
