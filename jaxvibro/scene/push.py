"""What a soft wall does with a law of its own, in place of a stiffness and a damping."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jaxtyping import ArrayLike, Real


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Push:
    """The acceleration with which a soft wall pushes a mass that is beyond it back: function(depth, rate, numbers).

    function: of numbers, with jax.numpy, or the name of one of ours: "hertz", stiffness depth^1.5, or "hunt_crossley",
    that times (1 + dissipation rate) (Hunt and Crossley, J. Appl. Mech. 42, 440, 1975). depth: abs(x - x_b); rate: how
    fast it grows; numbers: {name: number or array}, which it takes, and which are parameters of the scene,
    "right.law.<name>". It is 0 where both are 0, and a power series in the root of the depth.

    What is compiled is kept for the function itself: define it once, and not anew for each call.
    """

    function: Callable[..., Any] | str = field(metadata={"static": True})
    numbers: Mapping[str, Real[ArrayLike, "..."]] = field(default_factory=dict)


def hertz(depth, rate, p):
    """Two elastic bodies of which one is round (Hertz): stiffness depth^1.5."""
    return p["stiffness"] * depth**1.5


def hunt_crossley(depth, rate, p):
    """The same with a loss that grows with the depth: stiffness depth^1.5 (1 + dissipation rate)."""
    return p["stiffness"] * depth**1.5 * (1.0 + p["dissipation"] * rate)


NAMED_PUSHES = {law.__name__: law for law in (hertz, hunt_crossley)}


def registered_push_name(function):
    """The name of a push, None where it has none."""
    return next((name for name, law in NAMED_PUSHES.items() if law is function), None)
