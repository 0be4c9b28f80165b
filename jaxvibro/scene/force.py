"""A force of the user's own, in place of the spring and the damper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jax.extend import core
from jaxtyping import ArrayLike, Real

TOLERANCE = 1e-13
TIGHTEST, LOOSEST = 1e-15, 1e-3
INNER = ("jaxpr", "call_jaxpr")  # the operations of one that is a function of its own
LOOPS = ("while", "scan", "cond")  # functions of their own that are not simply run once


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Force:
    """The acceleration that a mass has beside the drive's: function(t, x, v, numbers), in place of -x - 2 damping v.

    function: of numbers, with jax.numpy, or the name of one of ours: "duffing", "polynomial", "pendulum", "stribeck",
    "van_der_pol" (docs/force.md). numbers: {name: number or array}, which it takes, and which are parameters of the
    scene, "force.<name>". t is the drive's phase over its frequency: the force must repeat with the drive's period.
    tolerance: of a step's error, over the largest of x, v, the walls' distances and the drive's amplitude.

    What is compiled is kept for the function itself: define it once, and not anew for each call.
    """

    function: Callable[..., Any] | str = field(metadata={"static": True})
    numbers: Mapping[str, Real[ArrayLike, "..."]] = field(default_factory=dict)
    tolerance: float = field(default=TOLERANCE, metadata={"static": True})


def of_row(function, names):
    """function(t, x, v, *numbers), the numbers of these names in a row."""

    def plain(t, x, v, *numbers):
        return function(t, x, v, dict(zip(names, numbers, strict=True)))

    return plain


def trace(function, names, dtype):
    """The `ClosedJaxpr` of a force, traced anew, of scalars of a type."""
    return jax.make_jaxpr(of_row(function, names))(*[jax.ShapeDtypeStruct((), dtype)] * (3 + len(names)))


def inner(eqn):
    """The `ClosedJaxpr` of an operation that is a function of its own, run once, else None."""
    if eqn.primitive.name in LOOPS:
        return None
    for name in INNER:
        found = eqn.params.get(name)
        if found is not None:
            return found if isinstance(found, core.ClosedJaxpr) else core.ClosedJaxpr(found, ())
    return None
