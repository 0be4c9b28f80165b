"""Base class of curves in the plane of two parameters: loci, and branches with a quantity held fixed."""

import json
import re
from abc import abstractmethod

import msgspec
import numpy as np
from jaxtyping import Float

from .. import __version__
from ..output.checksums import netcdf_bytes
from ..output.units import unit_in_system, unit_of
from ..scene.scene import Scene
from ..scene.scene_table import make_scene_table
from .end import End
from .orbit_curve import OrbitCurve, SpecialType, dataset_row, parse_orbit_point
from .orbit_point import OrbitPoint
from .orbit_problem import make_orbit_problem

REASON_TEXTS = {
    End.BOUND: "{name} reached its bound {value:.12g}",
    End.DOMAIN: "the domain of {name} ends at {value:.12g}",
    End.CLOSED: "it closes: the curve came back to its start",
    End.STEP: "the step became too small: Newton's method does not converge there",
    End.GRAZE: "an impact loses its speed there, a flight touches a wall, or a rest ends",
    End.POINTS: "it has too many points",
    End.MAX_POINTS: "max_points reached",
    End.MAX_SECONDS: "max_seconds reached",
}


class PlaneCurve(OrbitCurve[SpecialType]):
    """Base class of curves in the plane of two parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Bounds of each parameter.
    scene : Scene
        Scene at the start.
    """

    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    scene: Scene

    @property
    def values(self) -> Float[np.ndarray, "points 2"]:
        """Values of the two parameters at each point, array of shape (points, 2)."""
        return np.stack([self.data[name].values for name in self.names], axis=1)

    @property
    @abstractmethod
    def label(self) -> str:
        """Label P n p q of the orbits."""

    def located(self, place: int) -> tuple[Scene, OrbitPoint]:
        """Return the scene and the orbit at a point.

        Parameters
        ----------
        place : int
            Index of the point.

        Returns
        -------
        scene : Scene
            Scene with the values of the two parameters at the point.
        orbit_point : OrbitPoint
            The orbit.
        """
        row = dataset_row(self.data, place)
        scene = self.scene.replace(**{name: float(row[name]) for name in self.names})
        return scene, point_of_plane_row(scene, self.names[0], self.data, row)

    def _file_content(self, title, own_attributes, further_attributes):
        """Return the bytes of the file that `save` writes, with attributes of the class in two places."""
        attributes = {
            "title": title,
            "source": f"jaxvibro {__version__}",
            **own_attributes,
            "bounds": json.dumps({name: self.bounds[name] for name in self.names}),
            "scene": msgspec.toml.encode(make_scene_table(self.scene)).decode(),
            **further_attributes,
            "reasons": json.dumps(self.reasons),
        }
        return netcdf_bytes(self.data.assign_attrs(attributes))

    def _end_lines(self, units):
        """Return the lines of a table that state the reasons for the ends."""
        unit_factors = {name: unit_in_system(self.scene, unit_of(name), units)[1] for name in self.names}
        return [f"{end_name} point: {rescale_end_text(text, unit_factors)}" for end_name, text in self.reason.items()]


def point_of_plane_row(scene, name, data, row):
    """Return the orbit of one point of a curve, as an orbit along its first parameter.

    Parameters
    ----------
    scene : Scene
        Scene at the point.
    name : str
        First parameter.
    data : xarray.Dataset
        Data of the curve.
    row : dict of str to ndarray
        Entries from `dataset_row`.

    Returns
    -------
    OrbitPoint
        The orbit.
    """
    periods = len(row["x"]) if "x" in row else data.attrs["periods"]
    return parse_orbit_point(make_orbit_problem(scene, name, periods=1), name, row, periods)


def describe_segment_end(segment, names):
    """Describe the end of a segment of a curve in the plane of two parameters.

    Parameters
    ----------
    segment : BranchSegment
        Segment, whose end is an `End`.
    names : tuple of str
        Names of the two parameters.

    Returns
    -------
    str
        Text for display.
    """
    reason_text = REASON_TEXTS.get(segment.end, REASON_TEXTS[End.STEP])
    return reason_text.format(name=names[segment.end_param_index], value=segment.end_value)


def rescale_end_text(text: str, unit_factors: dict[str, float]) -> str:
    """Convert the parameter value in a text to another unit.

    Parameters
    ----------
    text : str
        Text from `describe_segment_end`.
    unit_factors : dict of str to float
        For each parameter the value of the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by the factor of the parameter.
    """
    text_match = re.fullmatch(r"(?:the domain of )?(\S+) (?:reached its bound|ends at) (\S+)", text)
    unit_factor = unit_factors.get(text_match[1], 1.0) if text_match else 1.0
    return (
        f"{text[: text_match.start(2)]}{float(text_match[2]) * unit_factor:.12g}"
        if text_match and unit_factor != 1.0
        else text
    )
