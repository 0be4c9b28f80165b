"""A force of the user's own, in place of the spring and the damper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jaxtyping import ArrayLike, Real

DEFAULT_TOLERANCE = 1e-13
MIN_TOLERANCE, MAX_TOLERANCE = 1e-15, 1e-3


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
    tolerance: float = field(default=DEFAULT_TOLERANCE, metadata={"static": True})
    solver: Any = field(default=None, metadata={"static": True})


def flat_function(function, names, n_arguments=3):
    """function(t, x, v, *numbers), the numbers of these names in a row; n_arguments: how many it takes besides."""

    def call_flat(*arguments):
        return function(*arguments[:n_arguments], dict(zip(names, arguments[n_arguments:], strict=True)))

    return call_flat


def trace_jaxpr(function, names, dtype, n_arguments=3):
    """The `ClosedJaxpr` of a force, traced anew, of scalars of a type; n_arguments: as of `flat_function`."""
    return jax.make_jaxpr(flat_function(function, names, n_arguments))(
        *[jax.ShapeDtypeStruct((), dtype)] * (n_arguments + len(names))
    )
