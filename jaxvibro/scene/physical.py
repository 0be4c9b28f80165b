"""A scene from dimensional quantities: M X'' + C X' + K X = F cos(Omega T) between walls (paper, section 1)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jax import numpy as jnp
from jaxtyping import ArrayLike, Real
from numpy.typing import DTypeLike

from . import check
from .scene import SIDES, Scene, Walls, make_scene, terms_of
from .scene_rules import obey
from .wall import Motion, Wall


@check.of_scene
def scene_from_physical(
    mass: Real[ArrayLike, "..."],
    damping: Real[ArrayLike, "..."],
    stiffness: Real[ArrayLike, "..."],
    force: Real[ArrayLike, "..."],
    frequency: Real[ArrayLike, "..."],
    restitution: Real[ArrayLike, "..."],
    walls: Walls,
    length: Real[ArrayLike, "..."] | None = None,
    dtype: DTypeLike | None = None,
    drive: Sequence[Motion | tuple[Real[ArrayLike, "..."], int, Real[ArrayLike, "..."]]] = (),
) -> Scene:
    """The nondimensional scene of a mass on a spring, in any consistent set of units.

    mass M > 0, damping C >= 0, stiffness K > 0, force F, frequency Omega > 0 in radians per unit of time, restitution
    R: numbers or arrays that broadcast. walls: (left, right) as in `make_scene`, in the units of M, C, K and F: a
    soft wall's stiffness is the force it adds over how far the mass is beyond it, its damping takes the place of C.

    drive: as in `make_scene`, its amplitudes in the unit of F.

    length d is what the scene measures lengths in; None takes the right wall's position, which must then be above 0:
    the scene's right wall stands at 1. With w0 = sqrt(K / M) the scene has amplitude F / (K d), frequency Omega / w0,
    damping C / (2 M w0); its time is w0 T, its x is X / d, its velocity (dX/dT) / (w0 d). The damping follows from the
    equation of motion; our copy of the paper reads C / (M w0), which does not fit it.

    Raises SceneError for a quantity that breaks its rule; the scene itself is then checked as in `make_scene`.
    """
    kind = check.float_type(dtype)
    walls = check.pair(walls)
    given = {"mass": mass, "damping": damping, "stiffness": stiffness, "force": force, "frequency": frequency}
    given["length"] = _length(walls) if length is None else length
    of = {key: check.quantity(key, value, kind) for key, value in given.items()}
    check.shapes_agree(of.items())
    for key, value in of.items():
        obey(key, value)
    xp = jnp if check.is_traced(*of.values()) else np
    natural = xp.sqrt(of["stiffness"] / of["mass"])
    return make_scene(
        amplitude=of["force"] / (of["stiffness"] * of["length"]),
        frequency=of["frequency"] / natural,
        damping=of["damping"] / (2 * of["mass"] * natural),
        restitution=restitution,
        walls=tuple(_scaled(side, wall, of, natural, kind) for side, wall in zip(SIDES, walls, strict=True)),
        dtype=kind,
        drive=[_weighed(f"drive.{k}", of, kind, *term) for k, term in enumerate(terms_of(drive))],
    )


def _length(walls):
    right = walls[1]
    position = right.position if isinstance(right, Wall) else right
    if position is None:
        raise check.SceneError("length", "must be given where there is no right wall", None)
    return position


def _weighed(key, of, kind, amplitude, harmonic, phase):
    """A term of the drive in the unit K d."""
    amplitude = check.quantity(f"{key}.amplitude", amplitude, kind)
    return amplitude / (of["stiffness"] * of["length"]), harmonic, phase


def _scaled(side, wall, of, natural, kind):
    """The wall with its lengths in the unit of length, its stiffness in K, its damping in 2 M w0."""
    if wall is None:
        return None
    if not isinstance(wall, Wall):
        return Wall(check.quantity(f"{side}.position", wall, kind) / of["length"])
    units = {"position": of["length"], "stiffness": of["stiffness"], "damping": 2 * of["mass"] * natural}
    given = {name: getattr(wall, name) for name in units if getattr(wall, name) is not None}
    scaled = {name: check.quantity(f"{side}.{name}", value, kind) / units[name] for name, value in given.items()}
    if isinstance(wall.motion, Motion):
        amplitude = check.quantity(f"{side}.motion.amplitude", wall.motion.amplitude, kind) / of["length"]
        scaled["motion"] = replace(wall.motion, amplitude=amplitude)
    return replace(wall, **scaled)
