"""Define contact laws of soft walls, which take the place of stiffness and damping."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jaxtyping import ArrayLike, Real


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Push:
    """Contact law of a soft wall: the acceleration that pushes the mass back.

    Parameters
    ----------
    function : callable or str
        ``function(depth, rate, numbers)`` of scalars, written with jax.numpy, or the name of a predefined law:
        ``"hertz"``, ``stiffness depth^1.5``, or ``"hunt_crossley"``, ``stiffness depth^1.5 (1 + dissipation rate)``
        [1]_. The depth is ``|x - x_b|``, with the position x_b of the wall, and the rate is the time derivative of the
        depth. The function must be 0 at depth 0 and rate 0, and a power series in the square root of the depth.
    numbers : dict of str to array_like, optional
        Parameters of the function. They are parameters of the scene with names such as ``"right.law.<name>"``.

    Notes
    -----
    Compiled code is cached for the function object. Define the function once, not anew for each call.

    References
    ----------
    .. [1] K. H. Hunt and F. R. E. Crossley, J. Appl. Mech. 42, 440 (1975).

    Examples
    --------
    >>> law = jv.Push("hertz", {"stiffness": 400.0})
    >>> force = jv.Force("polynomial", {"c1": 1.0, "damping": 0.05})
    >>> scene = jv.make_scene(2.0, 2.1, walls=(None, jv.Wall(1.0, law=law)), force=force)
    >>> float(scene.parameter("right.law.stiffness"))
    400.0
    """

    function: Callable[..., Any] | str = field(metadata={"static": True})
    numbers: Mapping[str, Real[ArrayLike, "..."]] = field(default_factory=dict)


def hertz(depth, depth_rate, params):
    """Evaluate the law of Hertz for two elastic bodies, one of them round: ``stiffness depth^1.5``."""
    return params["stiffness"] * depth**1.5


def hunt_crossley(depth, depth_rate, params):
    """Evaluate the law of Hunt and Crossley: ``stiffness depth^1.5 (1 + dissipation rate)``."""
    return params["stiffness"] * depth**1.5 * (1.0 + params["dissipation"] * depth_rate)


PREDEFINED_CONTACT_LAWS = {law.__name__: law for law in (hertz, hunt_crossley)}
