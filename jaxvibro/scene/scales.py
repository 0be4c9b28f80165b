"""Define the scales of a scene: a mass, a stiffness and a length in SI units."""

from dataclasses import dataclass

import numpy as np

from . import check
from .scene_checks import check_value


@dataclass(frozen=True)
class Scales:
    """Physical quantities that are 1 in a scene.

    At the physical time T the time of the scene is w0 T, with ``w0 = sqrt(K / M)``. Lengths of the scene are in units
    of d, and forces in units of K d.

    Parameters
    ----------
    mass : float
        Mass M, in kg.
    stiffness : float
        Stiffness K of the spring, in N/m.
    length : float
        Length d, in m.

    Raises
    ------
    ArgumentError
        If a value is not a number greater than 0.

    Examples
    --------
    >>> scales = jv.Scales(mass=0.5, stiffness=200.0, length=0.01)
    >>> scales.natural_frequency
    20.0
    """

    mass: float
    stiffness: float
    length: float

    def __post_init__(self) -> None:
        for key, value in self.numbers.items():
            checked_value = check.check_finite_float(key, value)
            check_value(key, checked_value)
            object.__setattr__(self, key, checked_value)

    @property
    def numbers(self) -> dict[str, float]:
        """Mass, stiffness and length by name: ``{"mass": M, "stiffness": K, "length": d}``."""
        return {key: getattr(self, key) for key in ("mass", "stiffness", "length")}

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency w0, in rad/s."""
        return float(np.sqrt(self.stiffness / self.mass))


def require_scales(scene):
    """Return the scales of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    Scales
        Its scales.

    Raises
    ------
    ArgumentError
        If the scene has no scales.
    """
    if scene.scales is None:
        rule = "physical units need scales: scene_from_physical makes a scene with scales"
        raise check.ArgumentError("units", rule, "a scene without scales")
    return scene.scales
