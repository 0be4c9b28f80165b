"""A force of the user's own, in place of the spring and the damper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jaxtyping import ArrayLike, Real

TOLERANCE = 1e-13
TIGHTEST, LOOSEST = 1e-15, 1e-3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Force:
    """The acceleration that a mass has beside the drive's: function(t, x, v, numbers), in place of -x - 2 damping v.

    function: of numbers, with jax.numpy, or the name of one of ours: "duffing", "polynomial", "pendulum", "stribeck",
    "van_der_pol" (docs/force.md). numbers: {name: number or array}, which it takes, and which are parameters of the
    scene, "force.<name>". t is the drive's phase over its frequency: the force must repeat with the drive's period.
    tolerance: of a step's error, over the largest of x, v, the walls' distances and the drive's amplitude.
    solver: one of diffrax's that estimate their errors, or its name; None takes Taylor steps where all operations of
    the force have a Taylor series, else "Dopri8". A stiff force needs an implicit one, "Kvaerno5".

    What is compiled is kept for the function itself: define it once, and not anew for each call.
    """

    function: Callable[..., Any] | str = field(metadata={"static": True})
    numbers: Mapping[str, Real[ArrayLike, "..."]] = field(default_factory=dict)
    tolerance: float = field(default=TOLERANCE, metadata={"static": True})
    solver: Any = field(default=None, metadata={"static": True})


def of_row(function, names, given=3):
    """function(t, x, v, *numbers), the numbers of these names in a row; given: how many it takes besides."""

    def plain(*row):
        return function(*row[:given], dict(zip(names, row[given:], strict=True)))

    return plain


def trace(function, names, dtype, given=3):
    """The `ClosedJaxpr` of a force, traced anew, of scalars of a type; given: as of `of_row`."""
    return jax.make_jaxpr(of_row(function, names, given))(*[jax.ShapeDtypeStruct((), dtype)] * (given + len(names)))
