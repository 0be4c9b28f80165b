"""Orbits along two parameters with one quantity held fixed."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool

from ..output.dataframes import make_dataframe
from ..output.equal_runs import find_equal_runs
from ..output.table_text import align_columns, column_header
from ..output.units import LENGTH, SPEED, unit_in_system, unit_of
from ..problem import orbit_curve
from ..problem.orbit_curve import PlaneCurve
from ..problem.orbit_point import label_of_point
from ..scene.scene import Scene
from .branch import Special, orbit_columns

HELD_UNITS = {"peak": LENGTH, "least_speed": SPEED}  # units of the quantities that may be held


@dataclass(frozen=True, eq=False)
class HeldBranch(PlaneCurve[Special]):
    """Orbits along two parameters with one quantity held fixed.

    Attributes
    ----------
    names : tuple of str
        Names of the two parameters.
    held : str
        Name of the held quantity, ``"peak"`` or ``"least_speed"``.
    value : float
        Value of the held quantity.
    bounds : dict of str to tuple of float
        Bounds of each parameter.
    scene : Scene
        Scene at the start.
    data : xarray.Dataset
        One row per point, in order. The columns are those of `Branch`, with both parameters.
    reasons : tuple of str
        Reasons for the ends at the first and at the last point.
    special : tuple of Special
        Empty; no special points are located.

    See Also
    --------
    follow : Continue a periodic orbit; its argument `hold` gives a `HeldBranch`.

    Examples
    --------
    >>> bounds = {"amplitude": (1.5, 2.5), "frequency": (2.05, 2.15)}
    >>> held = jv.follow(orbit, ("amplitude", "frequency"), bounds, hold={"least_speed": 1.9})
    >>> held.names, held.label
    (('amplitude', 'frequency'), 'P111')
    """

    names: tuple[str, str]
    held: str
    value: float
    bounds: dict[str, tuple[float, float]]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    reasons: tuple[str, str]
    special: tuple[Special, ...] = ()

    NOUN = "branch"

    def __repr__(self):
        first_name, second_name = self.names
        return f"HeldBranch({self.held} {self.value:g} along {first_name} and {second_name}, {len(self)} points)"

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """True at each point with a stable orbit, boolean array of shape (points,)."""
        return self.data["stable"].values.astype(bool)

    @cached_property
    def label(self) -> str:
        """Label P n p q of the orbits."""
        scene, orbit_point = self.located(0)
        return label_of_point(scene, orbit_point, orbit_point.itinerary)

    @property
    def content(self) -> bytes:
        """Bytes of the file that `save` writes."""
        return self._file_content("jaxvibro held branch", {"held": self.held, "value": self.value}, {})

    def table(self, units: str = "scene") -> str:
        """Format the held quantity, the stability along the curve, and the reasons for the ends.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` needs a scene with scales.

        Returns
        -------
        str
            One line per part of constant stability, with the parameters at its ends, then the reason for each end.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or the scene has no scales.

        Examples
        --------
        >>> bounds = {"amplitude": (1.5, 2.5), "frequency": (2.05, 2.15)}
        >>> held = jv.follow(orbit, ("amplitude", "frequency"), bounds, hold={"least_speed": 1.9})
        >>> held.table().splitlines()[0]
        'least_speed held at 1.9'
        """
        column_units = {name: unit_in_system(self.scene, unit_of(name), units) for name in self.names}
        held_unit, held_factor = unit_in_system(self.scene, HELD_UNITS[self.held], units)
        parameter_headers = [column_header(name, text, units) for name, (text, _) in column_units.items()]
        rows: list[tuple[str, ...]] = [("points", *parameter_headers, "orbit", "stability")]
        stability_words = orbit_curve.stability_words(self.multipliers)
        for start_row, stop_row in find_equal_runs(stability_words):
            run_end_values = self.values[[start_row, stop_row - 1]] * [
                unit_factor for _, unit_factor in column_units.values()
            ]
            range_texts = [f"{start_value:.12g} to {end_value:.12g}" for start_value, end_value in run_end_values.T]
            rows.append((f"{start_row} to {stop_row - 1}", *range_texts, self.label, stability_words[start_row]))
        return "\n".join(
            [
                f"{column_header(self.held, held_unit, units)} held at {self.value * held_factor:.12g}",
                align_columns(rows),
                *self._end_lines(units),
            ]
        )

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """Convert the points to a pandas DataFrame.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` needs a scene with scales.

        Returns
        -------
        pandas.DataFrame
            One row per point: the two parameters, the held quantity, and the columns of `Branch.to_frame` except the
            kind.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or the scene has no scales.
        """
        values = {name: self.data[name].values for name in self.names}
        labels, held_column = np.repeat(self.label, len(self)), (HELD_UNITS[self.held], np.full(len(self), self.value))
        orbit_data = orbit_columns(self.scene, values, self.data, labels, self.multipliers)
        leading_columns = {name: orbit_data[name] for name in self.names} | {self.held: held_column}
        return make_dataframe(
            self.scene,
            leading_columns | {key: column for key, column in orbit_data.items() if key not in leading_columns},
            units,
        )
