"""Define the predefined forces, which scene files may name: accelerations of (t, x, v, numbers), in units of w0."""

import re

import jax.numpy as jnp


def duffing(t, x, v, p):
    """Evaluate a spring that stiffens or softens: ``-x - cubic x^3 - 2 damping v``."""
    return -x - p["cubic"] * x**3 - 2.0 * p["damping"] * v


def polynomial(t, x, v, p):
    """Evaluate a polynomial spring with the given coefficients: ``-(c0 + c1 x + c2 x^2 + ...) - 2 damping v``."""
    spring_force = sum((p[name] * x ** int(name[1:]) for name in sorted(p) if name != "damping"), 0.0 * x)
    return -spring_force - 2.0 * p["damping"] * v


def pendulum(t, x, v, p):
    """Evaluate a pendulum, x being its angle in rad: ``-sin x - 2 damping v``."""
    return -jnp.sin(x) - 2.0 * p["damping"] * v


def stribeck(t, x, v, p):
    """Evaluate a block on a belt with smoothed dry friction.

    The acceleration is ``-x - (low + (high - low) exp(-(u / slip)^2)) tanh(u / smooth)`` with ``u = v - belt``.
    """
    u = v - p["belt"]
    friction = p["low"] + (p["high"] - p["low"]) * jnp.exp(-((u / p["slip"]) ** 2))
    return -x - friction * jnp.tanh(u / p["smooth"])


def van_der_pol(t, x, v, p):
    """Evaluate a self-excited oscillator: ``-x + gain (1 - x^2) v``."""
    return -x + p["gain"] * (1.0 - x * x) * v


def tabulated(t, x, v, p):
    """Evaluate a measured spring and a damper: ``-f(x) - 2 damping v``.

    f interpolates the forces f0, f1, ... at three or more positions x0 < x1 < ... by cubics. Their slopes at the
    positions are those of parabolas through three of them. Beyond the ends f is linear.
    """
    positions, forces = (jnp.stack([p[f"{letter}{interval}"] for interval in range(count_knots(p))]) for letter in "xf")
    widths, secants = jnp.diff(positions), jnp.diff(forces) / jnp.diff(positions)
    inner_slopes = (widths[1:] * secants[:-1] + widths[:-1] * secants[1:]) / (widths[1:] + widths[:-1])
    knot_slopes = jnp.concatenate(
        [2.0 * secants[:1] - inner_slopes[:1], inner_slopes, 2.0 * secants[-1:] - inner_slopes[-1:]]
    )
    interval = jnp.sum(x >= positions[1:-1])
    width, secant, left_slope, right_slope = (
        widths[interval],
        secants[interval],
        knot_slopes[interval],
        knot_slopes[interval + 1],
    )
    fraction = jnp.clip((x - positions[interval]) / width, 0.0, 1.0)
    spring_force = forces[interval] + width * fraction * (
        left_slope
        + fraction
        * (3.0 * secant - 2.0 * left_slope - right_slope + fraction * (left_slope + right_slope - 2.0 * secant))
    )
    extrapolation = knot_slopes[0] * jnp.minimum(x - positions[0], 0.0) + knot_slopes[-1] * jnp.maximum(
        x - positions[-1], 0.0
    )
    return -(spring_force + extrapolation) - 2.0 * p["damping"] * v


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


def expected_parameters(function, names):
    """Return None if the parameter names fit the force, or if it is user-defined; else the expected names as a text."""
    if function is polynomial:
        other_names = [name for name in names if not COEFFICIENT_PATTERN.fullmatch(name)]
        return None if other_names == ["damping"] else "c0, c1, c2, ... c99, those that are to be, and damping"
    expected = PARAMETER_NAMES.get(function)
    return None if expected is None or set(names) == set(expected) else ", ".join(expected)


def registered_name(function):
    """Return the name of a predefined force, or None."""
    return next((name for name, force in NAMED_FORCES.items() if force is function), None)


def force_name(function):
    """Return the name of a force: the registered name, or the name of its function.

    Parameters
    ----------
    function : callable
        The force.

    Returns
    -------
    str
        The name.
    """
    return registered_name(function) or getattr(function, "__name__", "force")
