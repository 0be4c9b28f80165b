"""Make a scene from SI quantities, ``M X'' + C X' + K X = F cos(Omega T)`` between walls (paper, section 1)."""

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
from .scene import SIDES, Motion, Scene, Wall, Walls, drive_term_tuples, make_scene, restitution_or_default
from .scene_checks import check_value

RECORD_LENGTH = 100  # number of force values from which an array looks like a record in time


@check.convert_to_scene_errors
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
    """Make the nondimensional scene of a mass on a spring from SI quantities.

    The scene remembers the quantities as its `Scales`. Give one each of `damping` or `damping_ratio`, `frequency` or
    `frequency_hz`, and `walls` or `gap`.

    Parameters
    ----------
    mass : array_like
        Mass M > 0, in kg.
    damping : array_like, optional
        Damping C >= 0, in N s/m.
    stiffness : array_like, optional
        Stiffness K > 0 of the spring, in N/m. Must be given.
    force : array_like, optional
        Amplitude F of the drive, in N. Must be given.
    frequency : array_like, optional
        Frequency Omega > 0 of the drive, in rad/s.
    restitution : array_like, optional
        Coefficient of restitution R from 0 to 1. May be left out if each rigid wall has its own.
    walls : tuple of (array_like, Wall or None), optional
        Left and right wall as in `make_scene`, positions in m. The stiffness of a soft wall, in N/m, is its additional
        force divided by the depth of the mass in the wall. Its damping, in N s/m, takes the place of C.
    length : array_like, optional
        Unit of length d of the scene, in m. None takes the position of the right wall, which must then be above 0, so
        that the right wall of the scene is at 1.
    dtype : dtype, optional
        Either float64 (default, needs ``jax_enable_x64``) or float32.
    drive : sequence of Motion or tuple, optional
        Further terms of the drive as in `make_scene`, amplitudes in N.
    damping_ratio : array_like, optional
        Damping ratio ``C / (2 sqrt(K M))``.
    frequency_hz : array_like, optional
        Frequency ``Omega / (2 pi)`` of the drive, in Hz.
    gap : array_like or tuple, optional
        Distance of the walls from the rest position, in m: one number for both sides, or (left, right) with None for no
        wall.

    Returns
    -------
    Scene
        The scene, with `Scales` if mass, stiffness and length are single known numbers.

    Raises
    ------
    SceneError
        If a quantity breaks its rule, or the scene breaks one as in `make_scene`.

    Warns
    -----
    UserWarning
        If a frequency looks like Hz, positions look like mm, a damping ratio looks like per cent, a gap looks like
        positions, or `force` is so long an array that it looks like a record in time.

    See Also
    --------
    make_scene : Make a scene from nondimensional numbers.

    Notes
    -----
    Numbers or arrays broadcast to a batch of scenes. With ``w0 = sqrt(K / M)`` the scene has amplitude ``F / (K d)``,
    frequency ``Omega / w0`` and damping ``C / (2 M w0)``. Its time is w0 T, its x is X / d and its velocity is
    ``(dX/dT) / (w0 d)``. The damping follows from the equation of motion; our copy of the paper reads ``C / (M w0)``,
    which contradicts this equation.

    Other consistent units give the same scene, but results in physical units then have wrong unit names.

    Examples
    --------
    >>> made = jv.scene_from_physical(
    ...     mass=0.5, stiffness=200.0, damping=1.0, force=4.0, frequency_hz=6.7, restitution=0.7, gap=0.01
    ... )
    >>> float(made.amplitude), float(made.damping)
    (2.0, 0.05)
    >>> round(float(made.frequency), 4), made.scales.length
    (2.1049, 0.01)
    """
    float_dtype = check.check_float_type(dtype)
    walls = check.check_walls_are_pair(_choose_alternative("walls", walls, "gap", _gap_positions(gap)))
    raw_quantities = {"mass": mass, "stiffness": stiffness, "force": force}
    for key, value in raw_quantities.items():
        _require_quantity(key, value)
    raw_quantities |= {
        "restitution": restitution_or_default(restitution, walls),
        "damping": _choose_alternative("damping", damping, "damping_ratio", damping_ratio),
        "frequency": _choose_alternative("frequency", frequency, "frequency_hz", frequency_hz),
        "length": _length_from_right_wall(walls, float_dtype) if length is None else length,
    }
    checked_quantities = _check_quantities(raw_quantities, float_dtype)
    _refuse_force_record(checked_quantities["force"])
    array_module = jnp if check.is_traced(*checked_quantities.values()) else np
    natural_frequency = array_module.sqrt(checked_quantities["stiffness"] / checked_quantities["mass"])
    scene = make_scene(
        amplitude=checked_quantities["force"] / (checked_quantities["stiffness"] * checked_quantities["length"]),
        frequency=(
            checked_quantities["frequency"] if frequency_hz is None else 2.0 * np.pi * checked_quantities["frequency"]
        )
        / natural_frequency,
        damping=checked_quantities["damping"] / (2 * checked_quantities["mass"] * natural_frequency)
        if damping_ratio is None
        else checked_quantities["damping"],
        restitution=checked_quantities["restitution"],
        walls=tuple(
            _scale_wall(side, wall, checked_quantities, natural_frequency, float_dtype)
            for side, wall in zip(SIDES, walls, strict=True)
        ),
        dtype=float_dtype,
        drive=[
            _scale_drive_term(f"drive.{term_index}", checked_quantities, float_dtype, *drive_term)
            for term_index, drive_term in enumerate(drive_term_tuples(drive))
        ],
    )
    if not check.is_traced(*jax.tree.leaves(scene)) and not scene.shape:
        input_warnings.warn_about_scene_units(scene, frequency_hz is None, damping_ratio, gap)
    return replace(scene, scales=_make_scales(checked_quantities))


def _require_quantity(key, value):
    """Raise SceneError if a quantity is None."""
    if value is None:
        raise check.SceneError(key, "must be given", None)


def _check_quantities(raw_quantities, float_dtype):
    """Return the quantities as checked arrays; raise ArgumentError if one breaks its rule."""
    checked_quantities = {
        key: check.check_number_or_array(key, value, float_dtype) for key, value in raw_quantities.items()
    }
    check.require_broadcast(checked_quantities.items())
    for key, value in checked_quantities.items():
        if key == "stiffness" and not check.is_traced(value) and np.any(value == 0):
            stiffness_rule = "must be greater than 0: the unit of time is sqrt(mass / stiffness)"
            raise check.SceneError(
                key, f"{stiffness_rule}; for a mass without a spring use make_scene with a Force", 0.0
            )
        check_value(key, value)
    return checked_quantities


def _choose_alternative(key, value, alternative_key, alternative_value):
    """Return the value of one of two alternative arguments, of which exactly one must be given."""
    if (value is None) == (alternative_value is None):
        raise check.SceneError(key, f"must be given, or {alternative_key}, but not both", value)
    return alternative_value if value is None else value


def _gap_positions(gap):
    """Return the wall positions (left, right) for a gap, or None if `gap` is None."""
    if gap is None:
        return None
    left_gap, right_gap = gap if isinstance(gap, tuple | list) and len(gap) == 2 else (gap, gap)
    for distance in (left_gap, right_gap):
        if isinstance(distance, Wall | list | tuple) or (
            distance is not None and check.check_real_array("gap", distance, np.float64).ndim
        ):
            raise check.SceneError("gap", "must be a number, or (left, right), each a number or None", gap)
    return None if left_gap is None else -check.check_number_or_array("gap", left_gap, np.float64), right_gap


def _refuse_force_record(force_amplitude):
    """Raise SceneError if `force_amplitude` looks like a time series of the force; warn about a long array.

    An array of amplitudes makes a batch of scenes. An array with values of both signs looks like a time series, because
    a batch does not need amplitudes of both signs.
    """
    if check.is_traced(force_amplitude) or force_amplitude.size < 2:
        return
    if force_amplitude.min() < 0 < force_amplitude.max():
        rule = (
            "must be the drive amplitude, not a force in time: give a number, and further harmonics as drive; an array "
        )
        raise check.SceneError("force", rule + "is a batch of scenes and must not change its sign", force_amplitude)
    if force_amplitude.size >= RECORD_LENGTH:
        message = (
            f"force is the drive amplitude: its {force_amplitude.size} values make a batch of"
            f" {force_amplitude.size} scenes"
        )
        warnings.warn(f"{message}; give a force in time by its harmonics, drive=", UserWarning, stacklevel=4)


def _make_scales(checked_quantities):
    """Return the `Scales`, or None if mass, stiffness or length is an array or traced."""
    values = {key: checked_quantities[key] for key in ("mass", "stiffness", "length")}
    if check.is_traced(*values.values()) or any(np.ndim(value) for value in values.values()):
        return None
    return Scales(**{key: float(value) for key, value in values.items()})


def _length_from_right_wall(walls, float_dtype):
    """Return the position of the right wall, the default unit of length; raise SceneError unless it is positive."""
    right_wall = walls[1]
    position = right_wall.position if isinstance(right_wall, Wall) else right_wall
    if position is None:
        raise check.SceneError("length", "must be given without a right wall", None)
    position = check.check_real_array("right.position", position, float_dtype)
    if not check.is_traced(position) and np.any(position == 0):
        rule = "must be given if the gap, or the right wall's position, is 0, as that is the default unit"
        raise check.SceneError("length", rule, None)
    if not check.is_traced(position) and np.any(position < 0):
        rule = "must be given if the right wall is not right of 0: are the walls in the wrong order?"
        raise check.SceneError("length", rule, None)
    return position


def _scale_drive_term(key, checked_quantities, float_dtype, amplitude, harmonic, phase):
    """Return a term of the drive with its amplitude in the unit K d."""
    amplitude = check.check_number_or_array(f"{key}.amplitude", amplitude, float_dtype)
    return amplitude / (checked_quantities["stiffness"] * checked_quantities["length"]), harmonic, phase


def _scale_wall(side, wall, checked_quantities, natural_frequency, float_dtype):
    """Return the wall with lengths in the unit of length, stiffness in K and damping in 2 M w0."""
    if wall is None:
        return None
    if not isinstance(wall, Wall):
        return Wall(check.check_number_or_array(f"{side}.position", wall, float_dtype) / checked_quantities["length"])
    unit_sizes = {
        "position": checked_quantities["length"],
        "stiffness": checked_quantities["stiffness"],
        "damping": 2 * checked_quantities["mass"] * natural_frequency,
    }
    si_values = {name: getattr(wall, name) for name in unit_sizes if getattr(wall, name) is not None}
    scaled_values = {
        name: check.check_number_or_array(f"{side}.{name}", value, float_dtype) / unit_sizes[name]
        for name, value in si_values.items()
    }
    if isinstance(wall.motion, Motion):
        amplitude = (
            check.check_number_or_array(f"{side}.motion.amplitude", wall.motion.amplitude, float_dtype)
            / checked_quantities["length"]
        )
        scaled_values["motion"] = replace(wall.motion, amplitude=amplitude)
    return replace(wall, **scaled_values)
