"""Assemble a `Branch` from continued segments: data, segments and special points, without impossible points.

Reject special points that are impossible. With a linear spring and damper between passive walls, the product of the
multipliers is between 0 and 1. The factors of the product are e^(-2 d T) with the damping d and the period T, R^2 with
the restitution R for each impact, and the factors of soft walls. Under any force a product below 1 excludes two
multipliers of modulus 1. Therefore there is no Neimark-Sacker point, and no two of SN, SB and PD coincide. An orbit
that is its own mirror image has no PD, because its multipliers are the squares of those of half the orbit (Swift and
Wiesenfeld, Phys. Rev. Lett. 52, 1984).
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import xarray as xr

from continuation.branch_segment import join_segments, reverse_segment

from ..contact.kinds import flow_of_scene
from ..orbits.orbit import STABILITY_MARGIN, eigenvalue_pairs
from ..output.units import LENGTH, SPEED, TIME, scales_attributes, unit_of
from ..problem.curve_ends import End
from ..problem.orbit_equations import mark_impact_rows
from ..problem.orbit_point import is_own_mirror_image, label_of_point, point_of_solution
from ..scene.scene_properties import is_symmetric
from .branch import Branch, Segment, make_special, multipliers_of_row

EXCLUSIVE_PAIRS = {("SB", "SN"), ("PD", "SN"), ("PD", "SB"), ("BP", "PD")}
COINCIDENCE_TOLERANCE = 1e-9  # relative to 1 + abs(value) and to the largest speed; closer special points coincide
MULTIPLIER_TOLERANCE = 1e-2  # largest difference of multipliers of one point, also close to a grazing
ROUNDING_FACTOR = 1e-9  # rounding of the product, relative to (1 + larger multiplier)^2


class ImpossiblePointError(ArithmeticError):
    """Error raised if a computed special point cannot exist in the scene."""

    def __init__(self, description, name, value, multiplier_product):
        super().__init__(description, name, value, multiplier_product)
        self.description, self.name, self.value, self.multiplier_product = description, name, value, multiplier_product

    def __str__(self):
        return (
            f"{self.description} at {self.name} = {self.value:.12g} is impossible, because the product of the"
            f" multipliers is {self.multiplier_product:.6g}; the computation is wrong there; please report the scene"
        )


def require_no_area_growth(name, values, multipliers):
    """Check that the products of multipliers, array of shape (points, 2), are at most 1. Raises
    ImpossiblePointError."""
    multiplier_products, rounding_error = _multiplier_products(multipliers)
    for index in np.flatnonzero(np.isfinite(multiplier_products) & (multiplier_products > 1.0 + rounding_error)):
        raise ImpossiblePointError("a growing area", name, float(values[index]), float(multiplier_products[index]))


def require_possible_points(special_points):
    """Check that the special points of a branch are possible. Raises ImpossiblePointError."""
    contracting_points = []
    for special in special_points:
        multiplier_product, rounding_error = _multiplier_products(special.multipliers)
        if multiplier_product < 1.0 - rounding_error:
            contracting_points.append((special, multiplier_product))
    for special, multiplier_product in contracting_points:
        if (
            special.kind == "PD"
            and is_symmetric(special.scene)
            and is_own_mirror_image(special.spot.problem, special.spot.z)
        ):
            raise ImpossiblePointError(
                "PD of an orbit that is its own mirror image", special.name, special.value, multiplier_product
            )
    for (special, multiplier_product), (other_special, _) in combinations(contracting_points, 2):
        if tuple(sorted((special.kind, other_special.kind))) in EXCLUSIVE_PAIRS and _are_coincident(
            special, other_special
        ):
            raise ImpossiblePointError(
                f"coincidence of {special.kind} and {other_special.kind}",
                special.name,
                special.value,
                multiplier_product,
            )


def _multiplier_products(multipliers):
    """Return the moduli of the products of multipliers and their rounding errors; nan at an impact with zero speed."""
    with np.errstate(invalid="ignore"):
        return abs(multipliers.prod(axis=-1)), ROUNDING_FACTOR * (1.0 + abs(multipliers[..., 0])) ** 2


def _are_coincident(first_point, second_point):
    """Test whether two special points have the same value, impacts and multipliers.

    At a grazing of a soft wall the multipliers change from -1 to 1 while value and impacts change by rounding.
    """
    first_row, second_row = first_point.spot, second_point.spot
    if len(first_row.times) != len(second_row.times) or abs(
        first_row.value - second_row.value
    ) > COINCIDENCE_TOLERANCE * (1.0 + abs(first_row.value)):
        return False
    if not abs(first_point.multipliers - second_point.multipliers).max() <= MULTIPLIER_TOLERANCE:
        return False
    orbit_differences = np.concatenate(
        [
            first_row.times - second_row.times,
            first_row.speeds - second_row.speeds,
            [first_row.x - second_row.x, first_row.v - second_row.v],
        ]
    )
    return bool(
        abs(orbit_differences).max() <= COINCIDENCE_TOLERANCE * (1.0 + first_row.speeds.max(initial=abs(first_row.v)))
    )


START_REASON = End.START.reason()


def assemble_branch(scene, name, bounds, settings, backward, forward, start_reason=START_REASON):
    """Assemble the `Branch` of the segments that were followed backward and forward from a start.

    `backward` and `forward` are the results of `continue_through_grazings` in the two directions, None for a direction
    that was not followed. `start_reason` is the `EndReason` of the end in a direction that was not followed.
    """
    backward_segments, first_reason = backward or ([], start_reason)
    forward_segments, last_reason = forward or ([], start_reason)
    branch_segments = [reverse_segment(segment) for segment in reversed(backward_segments)]
    if backward and forward:
        branch_segments[-1] = join_segments([branch_segments[-1], forward_segments[0]])
        branch_segments += forward_segments[1:]
    elif forward:
        branch_segments = forward_segments
    end_kinds, reasons = zip(first_reason, last_reason, strict=True)
    data, segments, special_points = _build_branch_parts(scene, name, bounds, branch_segments)
    settings = {key: setting for key, setting in settings.items() if key != "limits"}
    return Branch(name, bounds, scene, data, segments, special_points, reasons, settings, end_kinds)


def merge_branches(first_branch, second_branch):
    """Merge two branches; the second has at least two points and begins where the first ends."""
    index_shift = len(first_branch) - 1
    max_impacts = max(first_branch.data.sizes["impact"], second_branch.data.sizes["impact"])
    second_data = second_branch.data.isel(point=slice(1, None))
    second_data = second_data.assign(segment=second_data["segment"] + first_branch.data["segment"].values[-1])
    data = xr.concat([_pad_impacts(first_branch.data, max_impacts), _pad_impacts(second_data, max_impacts)], "point")
    shifted_segments = [
        replace(record, first=record.first + index_shift, last=record.last + index_shift)
        for record in second_branch.segments
    ]
    joint_segment = replace(first_branch.segments[-1], last=shifted_segments[0].last)
    special_points = (
        *first_branch.special,
        *(replace(record, place=record.place + index_shift) for record in second_branch.special),
    )
    return replace(
        first_branch,
        data=data,
        segments=(*first_branch.segments[:-1], joint_segment, *shifted_segments[1:]),
        special=tuple(record for record in special_points if record.kind != "EP" or record.place != index_shift),
        reasons=(first_branch.reasons[0], second_branch.reasons[1]),
        ends=(first_branch.ends[0], second_branch.ends[1]),
    )


def _pad_impacts(data, max_impacts):
    """Pad the impact dimension of the data."""
    padding = {"impact": (0, max_impacts - data.sizes["impact"])}
    if not padding["impact"][1]:
        return data
    sides = data["side"].pad(padding, constant_values=0)
    return data.drop_vars("side").pad(padding).assign(side=sides)


def _build_branch_parts(scene, name, bounds, branch_segments):
    """Return the dataset, `Segment` and `Special` records of continued segments. Raises ImpossiblePointError."""
    max_impacts = max(entry.args.n_used_rows for entry in branch_segments)
    segment_columns = [
        dataset_columns(entry, name, max_impacts, segment_index) for segment_index, entry in enumerate(branch_segments)
    ]
    columns = {
        key: np.concatenate([columns_of_segment[key] for columns_of_segment in segment_columns])
        for key in segment_columns[0]
    }
    descriptions = column_descriptions(name)
    data = {key: xr.Variable(descriptions[key][0], column, descriptions[key][1]) for key, column in columns.items()}

    def make_branch_special(branch_row_index, orbit_point, *fields):
        multipliers = multipliers_of_row({key: column[branch_row_index] for key, column in columns.items()})
        return make_special(scene, name, bounds, branch_row_index, orbit_point, multipliers, *fields)

    segments, special_points, first_row = [], [], 0
    grazing_rows = set()
    for entry in branch_segments:
        n_points, first_point = len(entry.points.z), _point_of_segment(entry, 0)
        itinerary = first_point.itinerary
        label = label_of_point(scene, first_point, itinerary)
        segments.append(Segment(first_row, first_row + n_points - 1, label, itinerary))
        for special_record in entry.specials:
            branch_row_index = first_row + special_record.row
            is_duplicate = (
                special_record.kind == "GR" and branch_row_index - 1 in grazing_rows
            )  # the same grazing, located from the other segment
            if not is_duplicate:
                special_fields = _special_fields(scene, entry, special_record)
                special_points.append(make_branch_special(branch_row_index, *special_fields))
            if special_record.kind == "GR":
                grazing_rows.add(branch_row_index)
        first_row += n_points
    for branch_row_index, entry, row in ((0, branch_segments[0], 0), (first_row - 1, branch_segments[-1], -1)):
        if not any(special.place == branch_row_index for special in special_points):
            end_point = _point_of_segment(entry, row)
            special_points.append(make_branch_special(branch_row_index, end_point, "EP", end_point.residual))
    special_points = tuple(sorted(special_points, key=lambda special: special.place))
    if not flow_of_scene(scene).areas_may_grow():
        require_no_area_growth(name, columns[name], columns["multiplier_real"] + 1j * columns["multiplier_imag"])
    require_possible_points(special_points)
    return xr.Dataset(data, attrs={"parameter": name, **scales_attributes(scene)}), tuple(segments), special_points


def dataset_columns(segment, name, max_impacts, segment_index):
    """Return the columns of a branch's data for one segment, ``{name: array}`` with one row per point."""
    problem, diagnostics = segment.args, segment.diagnostics
    times, speeds, sides = problem.impacts(segment.points.z)
    time_slopes, speed_slopes, _ = problem.impacts(segment.points.tangent)
    n_points, n_impacts = times.shape

    def pad_impacts(impact_values, fill_value):
        padded = np.full((n_points, max_impacts), fill_value)
        padded[:, :n_impacts] = impact_values
        return padded

    floquet_multipliers = eigenvalue_pairs(diagnostics.trace, diagnostics.determinant)
    return {
        name: segment.points.z[:, -1],
        "time": pad_impacts(times, np.nan),
        "speed": pad_impacts(speeds, np.nan),
        "side": pad_impacts(sides, 0).astype(np.int8),
        "x": diagnostics.x,
        "v": diagnostics.v,
        "multiplier_real": floquet_multipliers.real,
        "multiplier_imag": floquet_multipliers.imag,
        "stable": (abs(floquet_multipliers) < 1.0 - STABILITY_MARGIN).all(axis=1).astype(np.int8),
        "least_speed": speeds[:, mark_impact_rows(problem.sequence)[:n_impacts]].min(axis=1, initial=np.inf),
        "least_clearance": diagnostics.clearance.min(axis=(1, 2), initial=np.inf),
        "residual": segment.points.residual,
        "time_slope": pad_impacts(time_slopes, np.nan),
        "speed_slope": pad_impacts(speed_slopes, np.nan),
        "value_slope": segment.points.tangent[:, -1],
        "segment": np.full(n_points, segment_index),
    }


def column_descriptions(name):
    """Return dimensions and attributes of each column. The long names are stored in files."""

    def describe_column(long_name, units, *dimensions):
        return ("point", *dimensions), {"long_name": long_name, "units": units}

    return {
        name: (("point",), {"long_name": "the parameter", "units": unit_of(name)}),
        "time": describe_column("since phase 0", TIME, "impact"),
        "speed": describe_column("abs(y- - v_b)", SPEED, "impact"),
        "side": describe_column(
            "-1 left, 1 right, 0 none; 2 or 3 times that: its wall lets the mass go", "1", "impact"
        ),
        "x": describe_column("position at phase 0 of each period", LENGTH, "period"),
        "v": describe_column("velocity at phase 0 of each period", SPEED, "period"),
        "multiplier_real": describe_column("Floquet's, the larger first", "1", "multiplier"),
        "multiplier_imag": describe_column("Floquet's, the larger first", "1", "multiplier"),
        "stable": describe_column("1: both are smaller than 1", "1"),
        "least_speed": describe_column("of the impacts, inf: none", SPEED),
        "least_clearance": describe_column("at turning points, inf: none", LENGTH),
        "residual": describe_column("largest error left in the equations", LENGTH),
        "time_slope": describe_column("of the unit tangent", "1", "impact"),
        "speed_slope": describe_column("of the unit tangent", "1", "impact"),
        "value_slope": describe_column("of the unit tangent", "1"),
        "segment": describe_column("which stretch of one itinerary", "1"),
    }


def _point_of_segment(segment, row):
    """Return the `OrbitPoint` of one point of a segment."""
    points, diagnostics = segment.points, segment.diagnostics
    state = diagnostics.x[row, 0], diagnostics.v[row, 0]
    return point_of_solution(
        segment.args, points.z[row].copy(), state, points.residual[row], points.tangent[row].copy()
    )


def _special_fields(scene, segment, special_record):
    """Return (orbit, kind, residual, neighbours, is_not_followed) of a special point, as `make_special` takes them."""
    orbit_point, kind = _point_of_segment(segment, special_record.row), special_record.kind
    if kind == "BP" and is_symmetric(scene):
        kind = "SB" if is_own_mirror_image(orbit_point.problem, orbit_point.z) else kind
    details = special_record.detector_details
    neighbours = [_point_of_exit(grazing_exit) for grazing_exit in details.exits] if details else ()
    return orbit_point, kind, special_record.residual, neighbours, details.not_followed if details else ()


def _point_of_exit(grazing_exit):
    """Return the `OrbitPoint` near a grazing on a branch that emanates from it."""
    diagnostics = grazing_exit.diagnostics
    state = diagnostics.x[0, 0], diagnostics.v[0, 0]
    return point_of_solution(grazing_exit.problem, grazing_exit.z_near_grazing, state, 0.0)
