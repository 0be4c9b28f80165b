"""A scene from dimensional quantities: M X'' + C X' + K X = F cos(Omega T) between walls (paper, section 1)."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jax import numpy as jnp
from jaxtyping import ArrayLike, Real
from numpy.typing import DTypeLike

from . import check, questions
from .scales import Scales
from .scene import SIDES, Scene, Walls, make_scene, shared_restitution, terms_of
from .scene_rules import obey
from .wall import Motion, Wall

RECORD = 100  # values of a force: so many look like a record in time


@check.of_scene
def scene_from_physical(
    mass: Real[ArrayLike, "..."],
    damping: Real[ArrayLike, "..."] | None = None,
    stiffness: Real[ArrayLike, "..."] | None = None,
    force: Real[ArrayLike, "..."] | None = None,
    frequency: Real[ArrayLike, "..."] | None = None,
    restitution: Real[ArrayLike, "..."] | None = None,
    walls: Walls | None = None,
    length: Real[ArrayLike, "..."] | None = None,
    dtype: DTypeLike | None = None,
    drive: Sequence[Motion | tuple[Real[ArrayLike, "..."], int, Real[ArrayLike, "..."]]] = (),
    *,
    damping_ratio: Real[ArrayLike, "..."] | None = None,
    frequency_hz: Real[ArrayLike, "..."] | None = None,
    gap: Real[ArrayLike, "..."] | tuple[Real[ArrayLike, "..."] | None, Real[ArrayLike, "..."] | None] | None = None,
) -> Scene:
    """The nondimensional scene of a mass on a spring, from SI quantities, which it remembers as its `Scales`.

    mass M > 0 (kg), stiffness K > 0 (N/m), force F (N), restitution R: numbers or arrays that broadcast, the last left
    out where each rigid wall has its own. One each of: damping C >= 0 (N s/m) or damping_ratio C / (2 sqrt(K M));
    frequency Omega > 0 (rad/s) or frequency_hz Omega / (2 pi); walls, (left, right) as in `make_scene`, or gap, how far
    from the rest position they stand on both sides: a number, or (left, right), None where there is no wall. A soft
    wall's stiffness is the force it adds over how far the mass is beyond it, its damping takes the place of C.

    drive: as in `make_scene`, its amplitudes in N.

    length d (m) is what the scene measures lengths in; None takes the right wall's position, which must then be above
    0: the scene's right wall stands at 1. With w0 = sqrt(K / M) the scene has amplitude F / (K d), frequency
    Omega / w0, damping C / (2 M w0); its time is w0 T, its x is X / d, its velocity (dX/dT) / (w0 d). The damping
    follows from the equation of motion; our copy of the paper reads C / (M w0), which does not fit it. Any other
    consistent units do as well, but physical ones are then told by wrong names; batches of M, K or d leave no scales.

    Raises SceneError for a quantity that breaks its rule; the scene itself is then checked as in `make_scene`. Warns
    where a frequency looks like Hz, or positions like mm.
    """
    kind = check.float_type(dtype)
    walls = check.pair(_one_of("walls", walls, "gap", _around(gap)))
    given = {"mass": mass, "stiffness": stiffness, "force": force}
    for key, value in given.items():
        _require(key, value)
    given |= {
        "restitution": shared_restitution(restitution, walls),
        "damping": _one_of("damping", damping, "damping_ratio", damping_ratio),
        "frequency": _one_of("frequency", frequency, "frequency_hz", frequency_hz),
        "length": _length(walls, kind) if length is None else length,
    }
    of = {key: check.quantity(key, value, kind) for key, value in given.items()}
    check.shapes_agree(of.items())
    for key, value in of.items():
        if key == "stiffness" and not check.is_traced(value) and np.any(value == 0):
            rule = "must be greater than 0: times are measured in sqrt(mass / stiffness)"
            raise check.SceneError(key, f"{rule}; for a mass without a spring use make_scene with a Force", 0.0)
        obey(key, value)
    _require_amplitude(of["force"])
    xp = jnp if check.is_traced(*of.values()) else np
    natural = xp.sqrt(of["stiffness"] / of["mass"])
    scene = make_scene(
        amplitude=of["force"] / (of["stiffness"] * of["length"]),
        frequency=(of["frequency"] if frequency_hz is None else 2.0 * np.pi * of["frequency"]) / natural,
        damping=of["damping"] / (2 * of["mass"] * natural) if damping_ratio is None else of["damping"],
        restitution=of["restitution"],
        walls=tuple(_scaled(side, wall, of, natural, kind) for side, wall in zip(SIDES, walls, strict=True)),
        dtype=kind,
        drive=[_weighed(f"drive.{k}", of, kind, *term) for k, term in enumerate(terms_of(drive))],
    )
    if not check.is_traced(*jax.tree.leaves(scene)) and not scene.shape:
        questions.ask(scene, frequency_hz is None, damping_ratio, gap)
    return replace(scene, scales=_scales(of))


def _require(key, value):
    if value is None:
        raise check.SceneError(key, "must be given", None)


def _one_of(key, value, other, instead):
    """The one of two ways to give a quantity that is given."""
    if (value is None) == (instead is None):
        raise check.SceneError(key, f"must be given, or {other}, and not both", value)
    return instead if value is None else value


def _around(gap):
    """(left, right), the walls' positions that a gap means; None without."""
    if gap is None:
        return None
    left, right = gap if isinstance(gap, tuple | list) and len(gap) == 2 else (gap, gap)
    for one in (left, right):
        if isinstance(one, Wall | list | tuple) or (one is not None and check.real("gap", one, np.float64).ndim):
            raise check.SceneError("gap", "must be a number, or (left, right), each a number or None", gap)
    return None if left is None else -check.quantity("gap", left, np.float64), right


def _require_amplitude(force):
    """Refuse a record of a force in time where the drive's amplitude is due: an array is a batch of scenes, and no
    amplitude of a batch needs to be below 0. Warn where an array is as long as a record."""
    if check.is_traced(force) or force.size < 2:
        return
    if force.min() < 0 < force.max():
        rule = "is the drive's amplitude, not a force in time: give a number, or further harmonics as drive; an array "
        raise check.SceneError("force", rule + "makes a batch of scenes and must not change its sign", force)
    if force.size >= RECORD:
        told = f"force is the drive's amplitude: its {force.size} values make as many scenes, one each"
        warnings.warn(f"{told}; a force in time is given by its harmonics, drive=", UserWarning, stacklevel=4)


def _scales(of):
    """The `Scales` of single numbers that are known, else None."""
    found = {key: of[key] for key in ("mass", "stiffness", "length")}
    if check.is_traced(*found.values()) or any(np.ndim(each) for each in found.values()):
        return None
    return Scales(**{key: float(each) for key, each in found.items()})


def _length(walls, kind):
    """Return the right wall's position, the default unit of length."""
    right = walls[1]
    position = right.position if isinstance(right, Wall) else right
    if position is None:
        raise check.SceneError("length", "must be given where there is no right wall", None)
    position = check.real("right.position", position, kind)
    if not check.is_traced(position) and np.any(position == 0):
        rule = "must be given where the gap, or the right wall's position, is 0: lengths are measured in it otherwise"
        raise check.SceneError("length", rule, None)
    if not check.is_traced(position) and np.any(position < 0):
        rule = "must be given where the right wall is not right of 0: are the walls the wrong way round?"
        raise check.SceneError("length", rule, None)
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
