"""Continue a special point of a branch in two parameters: `locus`, and the files of loci."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike

import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Complex

from continuation.branch_segment import join_segments, make_limits, reverse_segment

from ..branches.branch import Special
from ..orbits.orbit import eigenvalue_pairs
from ..output.checksums import parse_checked_file
from ..output.dataframes import make_dataframe, multiplier_columns, special_kind_per_point, speed_clearance_columns
from ..output.label_codes import translate_label
from ..output.saved_curve_checks import (
    decode_field,
    decode_plane_curve,
    parse_saved_curve,
    require_valid_columns,
    require_valid_field,
)
from ..output.table_text import align_columns, column_header
from ..output.units import LENGTH, SPEED, TIME, scales_attributes, unit_in_system, unit_of
from ..problem.curve_ends import End
from ..problem.orbit_curve import PlaneCurve, SpecialOrbit, dataset_row, describe_segment_end, point_of_plane_row
from ..problem.orbit_point import OrbitPoint
from ..scene import check
from ..scene.scene import Scene, replace_unchecked
from .grazing_switchover import opposite_directions, track_across_walls
from .locus_start import KINDS, STICKING_KINDS, check_special_point, whole_orbit_impacts

MEANINGS = {
    "CP": "cusp",
    "GPD": "generalized period doubling",
    "DSB": "degenerate symmetry breaking",
    "GR": "end on a grazing",
    "GG": "two grazings",
    "RG": "resonant grazing",
    "DG": "degenerate grazing",
    "CH": "end on a complete chatter",
    "RL": "end on a release within a sticking phase",
    "EP": "end",
}


@dataclass(frozen=True, eq=False)
class Codim2(SpecialOrbit):
    """Special point of a locus: a point of codimension two, or an end.

    Attributes
    ----------
    kind : str
        ``"CP"`` (cusp), ``"GPD"`` (generalized period doubling), ``"DSB"`` (degenerate symmetry breaking), ``"GR"`` (an
        SN, PD, SB, CH or RL ends on a grazing), ``"GG"`` (two grazings), ``"RG"`` (resonant grazing), ``"DG"``
        (degenerate grazing), ``"SN"``, ``"PD"`` or ``"SB"`` (a locus of GR meets a locus of this kind), ``"CH"`` or
        ``"RL"`` (limit of a sticking phase), or ``"EP"`` (end).
    on : str
        Kind of the locus.
    values : dict of str to float
        Values of the two parameters, by name.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter of the locus.
    multipliers : numpy.ndarray
        Floquet multipliers of the orbit, the larger first. Array of shape (2,), complex.
    place : int
        Index of the point among the points of the locus.
    residual : float
        Largest residual of the equations of the point.
    itinerary : tuple of str
        Sequence of walls hit, a word of L and R for each drive period.
    scene : Scene
        Scene at the point.
    spot : OrbitPoint
        The orbit at the point.

    See Also
    --------
    jaxvibro.switch : Continue the loci that emanate from a point of codimension two.
    """

    kind: str
    on: str
    values: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    multipliers: Complex[np.ndarray, "2"]
    place: int
    residual: float
    itinerary: tuple[str, ...]
    scene: Scene = field(repr=False)
    spot: OrbitPoint = field(repr=False)


@dataclass(frozen=True, eq=False)
class Locus(PlaneCurve[Codim2]):
    """Two-parameter bifurcation curve.

    `locus` computes a curve, and `load_locus` reads a curve from a file.

    Attributes
    ----------
    kind : str
        Kind of the special points along the curve.
    names : tuple of str
        Names of the two parameters.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter.
    scene : Scene
        Scene at the start.
    data : xarray.Dataset
        One row per point, in order along the curve. `locus` lists the columns.
    special : tuple of Codim2
        Points of codimension two and ends, in order along the curve.
    reasons : tuple of str
        Termination reasons at the first and at the last point.
    NOUN : str
        Name of this kind of curve in error messages.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> curve = jv.locus(special, ("amplitude", "frequency"), {"amplitude": (0.0, 6.0), "frequency": (2.05, 2.15)})
    >>> curve.kind, curve.names, [point.kind for point in curve.special]
    ('SN', ('amplitude', 'frequency'), ['EP', 'EP'])
    >>> curve.values.shape == (len(curve), 2)
    True
    """

    kind: str
    names: tuple[str, str]
    bounds: dict[str, tuple[float, float]]
    scene: Scene = field(repr=False)
    data: xr.Dataset = field(repr=False)
    special: tuple[Codim2, ...]
    reasons: tuple[str, str]

    NOUN = "locus"

    def __repr__(self):
        kinds = " ".join(special_point.kind for special_point in self.special)
        return f"Locus({self.kind} of {self.label} in {self.names[0]} and {self.names[1]}, {len(self)} points, {kinds})"

    @property
    def label(self) -> str:
        """Label P n p q of the orbits."""
        return self.special[0].label

    @property
    def content(self) -> bytes:
        """Content of the file that `save` writes, in bytes."""
        special_fields = [[entry.kind, entry.place, entry.residual] for entry in self.special]
        return self._file_content("jaxvibro locus", {"kind": self.kind}, {"special": json.dumps(special_fields)})

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """Format the special points and the termination reasons as text.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the values. Physical units (Hz, N, mm) require a scene with scales.
        labels : str, optional
            Naming scheme of the point labels, as in `Branch.table`.

        Returns
        -------
        str
            Table with one line per special point, followed by the two termination reasons.

        Raises
        ------
        ArgumentError
            If `units` or `labels` is unknown, or if physical units are requested of a scene without scales.
        """
        column_units = [unit_in_system(self.scene, unit_of(name), units) for name in self.names]
        headers = [column_header(name, unit, units) for name, (unit, _) in zip(self.names, column_units, strict=True)]
        rows: list[tuple[str, ...]] = [("kind", *headers, "orbit", "itinerary")]
        for special_point in self.special:
            itinerary_text = " ".join(word or "." for word in special_point.itinerary)
            values = [
                f"{value * unit_factor:.12g}"
                for value, (_, unit_factor) in zip(special_point.values.values(), column_units, strict=True)
            ]
            rows.append((translate_label(special_point.kind, labels), *values, special_point.label, itinerary_text))
        return "\n".join([align_columns(rows), *self._end_lines(units)])

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """Convert the points to a table.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the values, as in `Branch.to_frame`.

        Returns
        -------
        pandas.DataFrame
            One row per point: kind of the entry of `special` at that point, if any, the two parameters, the label of
            the orbit, the smallest speed before an impact, the smallest clearance, and the multipliers.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or if physical units are requested of a scene without scales.
        """
        return make_dataframe(
            self.scene,
            {
                "kind": ("", special_kind_per_point(self.special, len(self))),
                **{name: (unit_of(name), self.data[name].values) for name in self.names},
                "label": ("", np.repeat(self.label, len(self))),
                **speed_clearance_columns(self.data),
                **multiplier_columns(self.multipliers),
            },
            units,
        )


@check.host_only("use strobe or monodromy")
def locus(
    special: Special,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    first_step: float = 0.02,
    largest_step: float = 0.1,
    tolerance: float = 1e-12,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Locus:
    """Continue a special point in two parameters of its scene.

    Parameters
    ----------
    special : Special
        Special point of a branch, of kind SN, PD, SB, GR, CH or RL.
    names : sequence of str
        Names of two different parameters.
    bounds : dict of str to tuple of float
        Lower and upper bound of each parameter, by name.
    first_step : float, optional
        First arclength step, as in `follow`. The arclength is measured in (times, speeds, parameters). A stiffness is
        measured in units of 1 plus its value at the start.
    largest_step : float, optional
        Largest arclength step.
    tolerance : float, optional
        Tolerance of Newton's method, measured like the arclength.
    max_points : int, optional
        Largest number of points of the locus. By default the number is unlimited.
    max_seconds : float, optional
        Wall-clock time in s after which the continuation stops, as in `follow`. By default the time is unlimited.
    progress : callable, optional
        Function that is called with the number of points computed.

    Returns
    -------
    Locus
        The bifurcation curve, with its points of codimension two.

    Raises
    ------
    ArgumentError
        If `special` is of another kind, or if `names`, `bounds` or a setting is invalid.

    See Also
    --------
    family : Loci of one special point for several values of a third parameter.
    switch : Loci that emanate from a point of codimension two.
    load_locus : Read a locus from a file.

    Notes
    -----
    The unknowns are the times and speeds of the impacts, and both parameters. A symmetric orbit is represented by one
    half. The admissibility of every point is checked. The locus ends where the orbit becomes inadmissible.

    The following points are located:

    - cusps (CP), generalized period doublings (GPD) and degenerate symmetry breakings (DSB);
    - ends on a grazing (GR);
    - on a GR, ends at a second simultaneous grazing contact (GG);
    - ends at a limit of a sticking phase (CH, RL);
    - on a GR, degenerate grazings (DG), where the relative acceleration at the contact vanishes;
    - on a GR, resonant grazings (RG), at which loci of SN and PD end, and points at which the orbit without the grazing
      contact is an SN, PD or SB.

    `switch` continues the loci that emanate from RG, GPD, DSB, SN, PD, SB and GR. The locus of GR of a motion without
    impacts does not end at a GG. Beyond the GG the motion grazes the other wall, and the locus continues along this
    grazing.

    The columns of `data` are the parameters, ``time``, ``speed`` and ``side`` of each impact, ``multiplier_real`` and
    ``multiplier_imag``, ``least_speed``, ``least_clearance`` and ``residual``. There is one row per point.

    Examples
    --------
    >>> special = branch.points("SN")[0]
    >>> curve = jv.locus(special, ("amplitude", "frequency"), {"amplitude": (0.0, 6.0), "frequency": (2.05, 2.15)})
    >>> print(curve.reason["last"])
    frequency reached its bound 2.15
    """
    limits = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    check_special_point(special, (*KINDS, *STICKING_KINDS))
    step_settings = first_step, largest_step, tolerance, limits
    return locus_through_orbit(special.kind, special.scene, special.spot, names, bounds, step_settings)


def locus_through_orbit(kind, scene, orbit_point, names, bounds, step_settings):
    """Return the `Locus` of a kind through an `OrbitPoint` in both directions; `step_settings` ends with the limits."""
    limits = step_settings[-1]
    forward_direction, backward_direction = opposite_directions(kind, scene, orbit_point, names, bounds, *step_settings)
    forward_parts = track_across_walls(forward_direction.with_limits(limits.half_points()), step_settings)
    backward_direction = backward_direction.with_limits(
        limits.after_points(sum(len(segment.points.z) - 1 for _, segment in forward_parts))
    )
    return build_locus(
        forward_parts,
        () if forward_parts[0][1].end is End.CLOSED else track_across_walls(backward_direction, step_settings),
    )


def build_locus(forward_parts, backward_parts, start_reason="the start"):
    """Build a `Locus` from the parts that `track_across_walls` returns for both directions.

    `backward_parts` is empty if the curve is closed or
    begins at its start. `start_reason` is then the termination reason at the first point."""
    direction = forward_parts[0][0]
    segments = [reverse_segment(segment) for _, segment in reversed(backward_parts)]
    segments += [segment for _, segment in forward_parts]
    if backward_parts and backward_parts[0][0].problem is forward_parts[0][0].problem:
        segments[len(backward_parts) - 1 : len(backward_parts) + 1] = [
            join_segments(segments[len(backward_parts) - 1 : len(backward_parts) + 1])
        ]
    data, special_by_row, row_offset = [], {}, 0
    n_impact_columns = max(whole_orbit_impacts(segment.args, segment.points.z[:1])[0].shape[1] for segment in segments)
    for segment in segments:
        data.append(
            _segment_dataset(direction.names, segment, n_impact_columns).isel(point=slice(1 if data else 0, None))
        )
        special_by_row |= {
            row_offset + special_record.row: (special_record.kind, special_record.residual)
            for special_record in segment.specials
        }
        last_row = row_offset + len(segment.points.z) - 1
        if segment is not segments[-1] and segment.args.sequence.releases is None:  # corner of the boundary
            special_by_row.setdefault(last_row, ("GG", float(segment.points.residual[-1])))
        row_offset = last_row
    data = xr.concat(data, "point", combine_attrs="override").assign_attrs(scales_attributes(direction.scene))
    for row_index in (0, row_offset):
        special_by_row.setdefault(row_index, ("EP", float(data["residual"].values[row_index])))
    common_fields = direction.scene, direction.kind, direction.bounds, data
    codim2_points = tuple(
        build_codim2(*common_fields, row_index, *special_by_row[row_index]) for row_index in sorted(special_by_row)
    )
    reasons = (
        describe_segment_end(backward_parts[-1][1], direction.names) if backward_parts else start_reason,
        describe_segment_end(forward_parts[-1][1], direction.names),
    )
    return Locus(direction.kind, direction.names, direction.bounds, direction.scene, data, codim2_points, reasons)


def _segment_dataset(names, segment, n_impact_columns):
    """Build the dataset of the points of a segment, padded to a number of impact columns."""
    problem, z, diagnostics = segment.args, segment.points.z, segment.diagnostics
    times, speeds, sides, periods = whole_orbit_impacts(problem, z)
    multipliers = eigenvalue_pairs(diagnostics.trace, diagnostics.determinant)
    if float(problem.sequence.closure_sign) < 0:  # the multipliers are those of one half of the orbit
        with np.errstate(invalid="ignore"):
            multipliers = multipliers * multipliers
    row_of_impact = np.arange(times.shape[1]) % problem.n_used_rows
    min_speeds = np.where(np.isin(row_of_impact, problem.impact_rows), speeds, np.inf).min(axis=1)
    impact_variables = {"time": (times, "since phase 0", TIME), "speed": (speeds, "abs(y- - v_b)", SPEED)}
    point_variables = {
        "least_speed": (min_speeds, "of the impacts but for that which grazes", SPEED),
        "least_clearance": (
            diagnostics.clearance.min(axis=(1, 2), initial=np.inf),
            "at turning points, inf: none",
            LENGTH,
        ),
        "residual": (segment.points.residual, "largest error left in the equations", LENGTH),
    }
    data_variables = {
        name: (
            "point",
            z[:, problem.n_orbit_unknowns + parameter_index],
            _variable_attributes("a parameter", unit_of(name)),
        )
        for parameter_index, name in enumerate(names)
    }
    data_variables |= {
        key: (("point", "impact"), values_name_unit[0], _variable_attributes(*values_name_unit[1:]))
        for key, values_name_unit in impact_variables.items()
    }
    sides = np.broadcast_to(sides.astype(np.int8), times.shape)
    data_variables["side"] = (("point", "impact"), sides, _variable_attributes("-1 left, 1 right", "1"))
    for key, component in (("real", multipliers.real), ("imag", multipliers.imag)):
        data_variables[f"multiplier_{key}"] = (
            ("point", "multiplier"),
            component,
            _variable_attributes("Floquet's, the larger first", "1"),
        )
    data_variables |= {
        key: ("point", values_name_unit[0], _variable_attributes(*values_name_unit[1:]))
        for key, values_name_unit in point_variables.items()
    }
    dataset = xr.Dataset(data_variables, attrs={"periods": periods})
    n_missing_columns = n_impact_columns - times.shape[1]
    return dataset.pad(impact=(0, n_missing_columns), constant_values={"side": 0}) if n_missing_columns else dataset


def _variable_attributes(long_name, units):
    return {"long_name": long_name, "units": units}


def build_codim2(scene, locus_kind, bounds, data, row_index, kind, residual):
    """Build the `Codim2` at a row of the data of a locus.

    `scene` is the scene at the start of the locus, and `locus_kind` is the kind of the locus.
    """
    row, names = dataset_row(data, row_index), tuple(bounds)
    values = {name: float(row[name]) for name in names}
    parameter_values = {name: jnp.asarray(value, scene.dtype) for name, value in values.items()}
    scene = replace_unchecked(scene, parameter_values)  # the values are within the domains: no check
    multipliers = row["multiplier_real"] + 1j * row["multiplier_imag"]
    point = point_of_plane_row(scene, names[0], data, row)
    return Codim2(kind, locus_kind, values, bounds, multipliers, row_index, residual, point.itinerary, scene, point)


DIMENSIONS: dict[str, tuple[str, ...]] = dict.fromkeys(("least_speed", "least_clearance", "residual"), ("point",))
DIMENSIONS |= dict.fromkeys(("time", "speed", "side"), ("point", "impact"))
DIMENSIONS |= dict.fromkeys(("multiplier_real", "multiplier_imag"), ("point", "multiplier"))


@check.host_only("use what was loaded before")
def load_locus(path: str | PathLike[str]) -> Locus:
    """Read a locus from a file that `Locus.save` wrote.

    Parameters
    ----------
    path : str or os.PathLike
        Path of the file.

    Returns
    -------
    Locus
        The locus, with the same numbers as when it was saved.

    Raises
    ------
    ArgumentError
        If the file is damaged or is not a locus.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> special = branch.points("SN")[0]
    >>> curve = jv.locus(special, ("amplitude", "frequency"), {"amplitude": (0.0, 6.0), "frequency": (2.05, 2.15)})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     curve.save(f"{folder}/curve.nc")
    ...     print(jv.load_locus(f"{folder}/curve.nc").kind)
    SN
    """
    return parse_checked_file(path, lambda content, path: parse_saved_curve(content, path, "Locus", _parse_locus))


def _parse_locus(data):
    """Build the `Locus` from the data of a file, or raise an error if a field is invalid."""
    attrs = data.attrs
    kind, (names, bounds, scene, reasons) = str(attrs["kind"]), decode_plane_curve(attrs)
    require_valid_field("kind", kind in (*KINDS, *STICKING_KINDS))
    require_valid_columns(data, dict.fromkeys(names, ("point",)) | DIMENSIONS, (*names, "residual"))
    periods = int(attrs["periods"])
    require_valid_field("periods", periods > 0)
    codim2_entries = decode_field(attrs, "special", list[tuple[str, int, float]])
    require_valid_field(
        "special",
        codim2_entries
        and all(entry and 0 <= row_index < data.sizes["point"] for entry, row_index, _ in codim2_entries),
    )
    data.attrs = {"periods": periods, **scales_attributes(scene)}
    special = tuple(
        build_codim2(scene, kind, bounds, data, row_index, entry, residual)
        for entry, row_index, residual in codim2_entries
    )
    return Locus(kind, names, bounds, scene, data, special, reasons)
