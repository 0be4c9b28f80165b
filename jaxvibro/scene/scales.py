"""What a scene's numbers are measured in: a mass, a stiffness and a length, in SI units."""

from dataclasses import dataclass

import numpy as np

from . import check
from .scene_rules import check_value


@dataclass(frozen=True)
class Scales:
    """The physical quantities that are 1 in a scene: the mass M (kg), the spring's stiffness K (N/m) and a length d
    (m). The scene's time is w0 T, w0 = sqrt(K / M); its lengths are in d, its forces in K d.

    Raises ArgumentError for what is no number greater than 0.
    """

    mass: float
    stiffness: float
    length: float

    def __post_init__(self) -> None:
        for key, value in self.numbers.items():
            number = check.finite_array(key, value, np.dtype(float))
            if np.ndim(number):
                raise check.ArgumentError(key, "must be one number", value)
            check_value(key, number)
            object.__setattr__(self, key, float(number))

    @property
    def numbers(self) -> dict[str, float]:
        """{"mass": M, "stiffness": K, "length": d}."""
        return {key: getattr(self, key) for key in ("mass", "stiffness", "length")}

    @property
    def natural_frequency(self) -> float:
        """w0, radians per second."""
        return float(np.sqrt(self.stiffness / self.mass))


def require_scales(scene):
    """The `Scales` of a scene. Raises ArgumentError where it has none."""
    if scene.scales is None:
        rule = "must have scales to be told in physical units: scene_from_physical makes such a scene"
        raise check.ArgumentError("units", rule, "a scene without scales")
    return scene.scales
