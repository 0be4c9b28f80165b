"""Forces with names, which scene files may ask for: accelerations of (t, x, v, numbers), in units of w0."""

import re

import jax.numpy as jnp


def duffing(t, x, v, p):
    """A spring that stiffens, or softens: -x - cubic x^3 - 2 damping v."""
    return -x - p["cubic"] * x**3 - 2.0 * p["damping"] * v


def polynomial(t, x, v, p):
    """A spring that is a polynomial: -(c0 + c1 x + c2 x^2 + ...) - 2 damping v, of the c that are given."""
    pull = sum((p[name] * x ** int(name[1:]) for name in sorted(p) if name != "damping"), 0.0 * x)
    return -pull - 2.0 * p["damping"] * v


def pendulum(t, x, v, p):
    """A pendulum, x its angle in radians: -sin x - 2 damping v."""
    return -jnp.sin(x) - 2.0 * p["damping"] * v


def stribeck(t, x, v, p):
    """A block on a belt, with dry friction that is smoothed: -x - (low + (high - low) exp(-(u / slip)^2)) tanh(u /
    smooth), u = v - belt."""
    u = v - p["belt"]
    size = p["low"] + (p["high"] - p["low"]) * jnp.exp(-((u / p["slip"]) ** 2))
    return -x - size * jnp.tanh(u / p["smooth"])


def van_der_pol(t, x, v, p):
    """An oscillator that drives itself: -x + gain (1 - x^2) v."""
    return -x + p["gain"] * (1.0 - x * x) * v


def tabulated(t, x, v, p):
    """A spring that was measured: minus the pull f0, f1, ... at the places x0 < x1 < ..., three or more, less 2 damping
    v. Between places a cubic with the slopes of parabolas through three of them; beyond the ends straight on."""
    places, pulls = (jnp.stack([p[f"{letter}{k}"] for k in range(knots(p))]) for letter in "xf")
    gaps, rises = jnp.diff(places), jnp.diff(pulls) / jnp.diff(places)
    inner = (gaps[1:] * rises[:-1] + gaps[:-1] * rises[1:]) / (gaps[1:] + gaps[:-1])
    slopes = jnp.concatenate([2.0 * rises[:1] - inner[:1], inner, 2.0 * rises[-1:] - inner[-1:]])
    k = jnp.sum(x >= places[1:-1])
    gap, rise, low, high = gaps[k], rises[k], slopes[k], slopes[k + 1]
    s = jnp.clip((x - places[k]) / gap, 0.0, 1.0)
    pull = pulls[k] + gap * s * (low + s * (3.0 * rise - 2.0 * low - high + s * (low + high - 2.0 * rise)))
    beyond = slopes[0] * jnp.minimum(x - places[0], 0.0) + slopes[-1] * jnp.maximum(x - places[-1], 0.0)
    return -(pull + beyond) - 2.0 * p["damping"] * v


def knots(numbers):
    """How many places a `tabulated` force has."""
    return sum(name[0] == "x" for name in numbers)


NAMED = {each.__name__: each for each in (duffing, polynomial, pendulum, stribeck, van_der_pol, tabulated)}

NUMBERS = {
    duffing: ("cubic", "damping"),
    pendulum: ("damping",),
    stribeck: ("belt", "low", "high", "slip", "smooth"),
    van_der_pol: ("gain",),
}
COEFFICIENT = re.compile(r"c(0|[1-9]\d?)")


def takes(function, names):
    """None where a force of ours takes numbers of these names, and where it is none of ours; else which it takes."""
    if function is polynomial:
        others = [name for name in names if not COEFFICIENT.fullmatch(name)]
        return None if others == ["damping"] else "c0, c1, c2, ... c99, those that are to be, and damping"
    known = NUMBERS.get(function)
    return None if known is None or set(names) == set(known) else ", ".join(known)


def name_of(function):
    """The name of a force, None where it has none."""
    return next((name for name, named in NAMED.items() if named is function), None)


def named(function):
    """What a force is called: by its name, or as its function is."""
    return name_of(function) or getattr(function, "__name__", "force")
