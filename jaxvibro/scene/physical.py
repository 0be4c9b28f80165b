"""A scene from dimensional quantities: M X'' + C X' + K X = F cos(Omega T) between walls (paper, section 1)."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jax import numpy as jnp
from jaxtyping import ArrayLike, Real
from numpy.typing import DTypeLike

from . import check, input_warnings
from .scales import Scales
from .scene import SIDES, Scene, Walls, drive_terms, make_scene, resolve_restitution
from .scene_rules import check_value
from .wall import Motion, Wall

RECORD_LENGTH = 100  # values of a force: so many look like a record in time


@check.raise_scene_errors
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
    float_dtype = check.float_type(dtype)
    walls = check.wall_pair(_choose_alternative("walls", walls, "gap", _gap_positions(gap)))
    arguments = {"mass": mass, "stiffness": stiffness, "force": force}
    for key, value in arguments.items():
        _require_given(key, value)
    arguments |= {
        "restitution": resolve_restitution(restitution, walls),
        "damping": _choose_alternative("damping", damping, "damping_ratio", damping_ratio),
        "frequency": _choose_alternative("frequency", frequency, "frequency_hz", frequency_hz),
        "length": _default_length(walls, float_dtype) if length is None else length,
    }
    quantities = {key: check.scene_quantity(key, value, float_dtype) for key, value in arguments.items()}
    check.require_broadcast(quantities.items())
    for key, value in quantities.items():
        if key == "stiffness" and not check.is_traced(value) and np.any(value == 0):
            rule = "must be greater than 0: times are measured in sqrt(mass / stiffness)"
            raise check.SceneError(key, f"{rule}; for a mass without a spring use make_scene with a Force", 0.0)
        check_value(key, value)
    _require_amplitude(quantities["force"])
    xp = jnp if check.is_traced(*quantities.values()) else np
    natural_frequency = xp.sqrt(quantities["stiffness"] / quantities["mass"])
    scene = make_scene(
        amplitude=quantities["force"] / (quantities["stiffness"] * quantities["length"]),
        frequency=(quantities["frequency"] if frequency_hz is None else 2.0 * np.pi * quantities["frequency"])
        / natural_frequency,
        damping=quantities["damping"] / (2 * quantities["mass"] * natural_frequency)
        if damping_ratio is None
        else quantities["damping"],
        restitution=quantities["restitution"],
        walls=tuple(
            _scale_wall(side, wall, quantities, natural_frequency, float_dtype)
            for side, wall in zip(SIDES, walls, strict=True)
        ),
        dtype=float_dtype,
        drive=[
            _scale_drive_term(f"drive.{k}", quantities, float_dtype, *term) for k, term in enumerate(drive_terms(drive))
        ],
    )
    if not check.is_traced(*jax.tree.leaves(scene)) and not scene.shape:
        input_warnings.warn_about_scene(scene, frequency_hz is None, damping_ratio, gap)
    return replace(scene, scales=_make_scales(quantities))


def _require_given(key, value):
    if value is None:
        raise check.SceneError(key, "must be given", None)


def _choose_alternative(key, value, other_key, other_value):
    """The one of two ways to give a quantity that is given."""
    if (value is None) == (other_value is None):
        raise check.SceneError(key, f"must be given, or {other_key}, and not both", value)
    return other_value if value is None else value


def _gap_positions(gap):
    """(left, right), the walls' positions that a gap means; None without."""
    if gap is None:
        return None
    left, right = gap if isinstance(gap, tuple | list) and len(gap) == 2 else (gap, gap)
    for distance in (left, right):
        if isinstance(distance, Wall | list | tuple) or (
            distance is not None and check.real_array("gap", distance, np.float64).ndim
        ):
            raise check.SceneError("gap", "must be a number, or (left, right), each a number or None", gap)
    return None if left is None else -check.scene_quantity("gap", left, np.float64), right


def _require_amplitude(force):
    """Refuse a record of a force in time where the drive's amplitude is due: an array is a batch of scenes, and no
    amplitude of a batch needs to be below 0. Warn where an array is as long as a record."""
    if check.is_traced(force) or force.size < 2:
        return
    if force.min() < 0 < force.max():
        rule = "is the drive's amplitude, not a force in time: give a number, or further harmonics as drive; an array "
        raise check.SceneError("force", rule + "makes a batch of scenes and must not change its sign", force)
    if force.size >= RECORD_LENGTH:
        message = f"force is the drive's amplitude: its {force.size} values make as many scenes, one each"
        warnings.warn(f"{message}; a force in time is given by its harmonics, drive=", UserWarning, stacklevel=4)


def _make_scales(quantities):
    """The `Scales` of single numbers that are known, else None."""
    values = {key: quantities[key] for key in ("mass", "stiffness", "length")}
    if check.is_traced(*values.values()) or any(np.ndim(value) for value in values.values()):
        return None
    return Scales(**{key: float(value) for key, value in values.items()})


def _default_length(walls, float_dtype):
    """Return the right wall's position, the default unit of length."""
    right = walls[1]
    position = right.position if isinstance(right, Wall) else right
    if position is None:
        raise check.SceneError("length", "must be given where there is no right wall", None)
    position = check.real_array("right.position", position, float_dtype)
    if not check.is_traced(position) and np.any(position == 0):
        rule = "must be given where the gap, or the right wall's position, is 0: lengths are measured in it otherwise"
        raise check.SceneError("length", rule, None)
    if not check.is_traced(position) and np.any(position < 0):
        rule = "must be given where the right wall is not right of 0: are the walls the wrong way round?"
        raise check.SceneError("length", rule, None)
    return position


def _scale_drive_term(key, quantities, float_dtype, amplitude, harmonic, phase):
    """A term of the drive in the unit K d."""
    amplitude = check.scene_quantity(f"{key}.amplitude", amplitude, float_dtype)
    return amplitude / (quantities["stiffness"] * quantities["length"]), harmonic, phase


def _scale_wall(side, wall, quantities, natural_frequency, float_dtype):
    """The wall with its lengths in the unit of length, its stiffness in K, its damping in 2 M w0."""
    if wall is None:
        return None
    if not isinstance(wall, Wall):
        return Wall(check.scene_quantity(f"{side}.position", wall, float_dtype) / quantities["length"])
    units = {
        "position": quantities["length"],
        "stiffness": quantities["stiffness"],
        "damping": 2 * quantities["mass"] * natural_frequency,
    }
    arguments = {name: getattr(wall, name) for name in units if getattr(wall, name) is not None}
    scaled_values = {
        name: check.scene_quantity(f"{side}.{name}", value, float_dtype) / units[name]
        for name, value in arguments.items()
    }
    if isinstance(wall.motion, Motion):
        amplitude = (
            check.scene_quantity(f"{side}.motion.amplitude", wall.motion.amplitude, float_dtype) / quantities["length"]
        )
        scaled_values["motion"] = replace(wall.motion, amplitude=amplitude)
    return replace(wall, **scaled_values)
