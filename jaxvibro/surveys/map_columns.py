"""Define the columns of a parameter map, and fill them from classified motions and attractors."""

from collections.abc import Mapping

import numpy as np

from ..attractors.dataset_attributes import STATUS_FLAGS
from ..attractors.tangent_growth import RECORDED_PERIODS
from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.iterate import take_lanes, take_padded_block
from ..maps.wall_loads import LOAD_COLUMNS as LOADS
from ..maps.wall_loads import wall_loads
from ..orbits.orbit import samples_fill_same_set
from ..output import label_codes
from ..output.units import LENGTH, SPEED
from ..scene import check
from ..stores.study import Column, blank_columns
from .motion_classification import CHAOTIC, UNDECIDED, MotionResults

MAX_ATTRACTORS = 8  # attractors of a cell that are stored, the largest shares first
RATE_UNIT = "per drive period"
LABEL, STATUS, PERIOD, ATTRACTORS = "label", "status", "period", "attractors"
SHARES = "shares"  # columns of every map with several initial states per cell
QUANTITY_NAMES = (LABEL, PERIOD, "exponent", "state", "loads", ATTRACTORS)


def check_quantities(scene, quantities, n_starts):
    """Check the requested quantities; return a tuple of them and the label, in the order of `QUANTITY_NAMES`."""
    selected_quantities = check.make_name_tuple("quantities", quantities)
    for quantity in selected_quantities:
        if quantity not in QUANTITY_NAMES:
            raise check.ArgumentError("quantities", f"must be some of {', '.join(QUANTITY_NAMES)}", quantity)
    if "attractors" in selected_quantities and not n_starts:
        raise check.ArgumentError(
            "quantities", "must not contain attractors if a cell has one initial state", selected_quantities
        )
    if "loads" in selected_quantities and not scene.walls:
        raise check.ArgumentError("quantities", "must not contain loads if the scene has no walls", selected_quantities)
    return tuple(name for name in QUANTITY_NAMES if name in selected_quantities or name == LABEL)


def make_columns(scene, quantities, is_motion_carried, n_starts) -> Mapping[str, Column]:
    """Return {name: `Column`} of the requested quantities of a scene's cells."""
    direction_dims = {"way": 2} if is_motion_carried else {}
    cell_dims = {"attractor": MAX_ATTRACTORS} if n_starts else direction_dims
    wall_dims = {**cell_dims, "wall": len(scene.walls)}

    def float_column(description, unit, dims):
        """Return a column of numbers, which is nan where they are unknown."""
        return Column(np.dtype(scene.dtype), np.nan, {"long_name": description, "units": unit}, dims)

    columns_by_quantity = {
        LABEL: {
            LABEL: Column(np.dtype(np.int32), label_codes.NOT_DONE, {"long_name": label_codes.CODE_RULE}, cell_dims),
            STATUS: Column(
                np.dtype(np.int8), -1, {"long_name": "worst status, -1 not done", **STATUS_FLAGS}, direction_dims
            ),
        },
        SHARES: {
            "share": float_column("share of the starts", "1", cell_dims),
            "unresolved": float_column("share of the starts that are undecided", "1", {}),
        },
        ATTRACTORS: {ATTRACTORS: Column(np.dtype(np.int16), -1, {"long_name": "attractors, -1 not done"})},
        PERIOD: {
            PERIOD: Column(
                np.dtype(np.int16),
                UNDECIDED,
                {"long_name": "drive periods of the orbit, 0 chaotic, -1 undecided or not done", "units": "1"},
                cell_dims,
            )
        },
        "exponent": {
            "exponent": float_column("largest Lyapunov exponent", RATE_UNIT, cell_dims),
            "exponent_error": float_column("its standard error", RATE_UNIT, cell_dims),
        },
        "state": {
            name: float_column(f"{name} on Sigma, at the end", unit, cell_dims)
            for name, unit in (("x", LENGTH), ("v", SPEED), ("contact", "1"))
        },
        "loads": {
            name: float_column(description, unit, wall_dims)
            for name, (unit, description) in LOADS.items()
            if name in ("largest_speed", "work_rate")
        },
    }
    return {
        name: column
        for quantity, quantity_columns in columns_by_quantity.items()
        if quantity in quantities or (quantity == SHARES and n_starts)
        for name, column in quantity_columns.items()
    }


def motion_columns(scene, motions: MotionResults, study_columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """Return {name: array}, lanes on the first axis, of the study's columns that describe a single motion."""
    column_values = {
        LABEL: motion_label_codes(motions),
        STATUS: np.asarray(motions.status, np.int8),
        PERIOD: np.asarray(motions.periods, np.int16),
        "exponent": motions.exponent,
        "exponent_error": motions.error,
        "x": motions.state.x,
        "v": motions.state.v,
        "contact": motions.state.contact,
    }
    if "work_rate" in study_columns:
        column_values |= _wall_load_columns(scene, motions)
    return {name: array for name, array in column_values.items() if name in study_columns}


def select_motion_lanes(scene, motions: MotionResults, lanes):
    """Return (scene, motions) of the lanes with given indices, which may repeat."""
    state, impact_counts, section_points = (
        take_lanes(motions.state, lanes),
        motions.impact_counts[:, lanes],
        motions.points[:, lanes],
    )
    lane_fields = {
        name: getattr(motions, name)[lanes] for name in ("status", "periods", "endless", "exponent", "error")
    }
    return take_lanes(scene, lanes), MotionResults(
        state=state, impact_counts=impact_counts, points=section_points, **lane_fields
    )


def motion_label_codes(motions: MotionResults):
    """Return the codes of the motions' labels, (lanes,)."""
    left_impacts, right_impacts = motions.impact_counts
    orbit_codes = label_codes.label_code_from_counts(motions.periods, left_impacts, right_impacts, motions.endless)
    nonperiodic_codes = np.where(motions.periods == CHAOTIC, label_codes.CHAOTIC, label_codes.UNDECIDED)
    return np.where(motions.periods > 0, orbit_codes, nonperiodic_codes).astype(np.int32)


def _wall_load_columns(scene, motions):
    """Compute the columns largest_speed and work_rate, (lanes, walls), in blocks of motions with equal periods."""
    n_lanes, n_walls = len(motions.periods), len(scene.walls)
    columns = {name: np.full((n_lanes, n_walls), np.nan, scene.dtype) for name in ("largest_speed", "work_rate")}
    periods = np.where(motions.periods == CHAOTIC, RECORDED_PERIODS, motions.periods)
    for n_periods in np.unique(periods[periods > 0]).tolist():
        lanes = np.flatnonzero(periods == n_periods)
        for first_index in range(0, len(lanes), BLOCK_WIDTH):
            lane_block = lanes[first_index : first_index + BLOCK_WIDTH]
            load_dataset = wall_loads(
                *take_padded_block(take_lanes((scene, motions.state), lane_block), 0, BLOCK_WIDTH), n_periods
            )
            for name, column_array in columns.items():
                column_array[lane_block] = load_dataset[name].values[: len(lane_block)]
    return columns


def attractor_columns(scene, motions: MotionResults, n_starts: int, study_columns) -> dict[str, np.ndarray]:
    """Return the columns {name: array}, cells on the first axis, of the attractors of `n_starts` motions per cell."""
    n_cells, label_codes = len(motions.periods) // n_starts, motion_label_codes(motions)
    columns = blank_columns(study_columns, (n_cells,))
    cell_index_lane_triples: list[tuple[int, int, int]] = []  # cell, index and lane of each stored attractor
    columns["label"][:], columns["share"][:] = 0, 0.0
    for cell_index in range(n_cells):
        lanes = np.arange(cell_index * n_starts, (cell_index + 1) * n_starts)
        attractor_lanes = group_by_attractor(motions, label_codes, lanes)
        columns["status"][cell_index] = motions.status[lanes].max()
        columns["unresolved"][cell_index] = 1.0 - sum(map(len, attractor_lanes)) / n_starts
        if "attractors" in columns:
            columns["attractors"][cell_index] = len(attractor_lanes)
        for attractor_index, lane_group in enumerate(attractor_lanes[:MAX_ATTRACTORS]):
            columns["share"][cell_index, attractor_index] = len(lane_group) / n_starts
            cell_index_lane_triples.append((cell_index, attractor_index, lane_group[0]))
    if cell_index_lane_triples:
        cell_indices, attractor_indices, lane = np.array(cell_index_lane_triples).T
        attractor_scenes, attractor_motions = select_motion_lanes(scene, motions, lane)
        attractor_values = motion_columns(attractor_scenes, attractor_motions, study_columns)
        for name, array in attractor_values.items():
            if name != "status":
                columns[name][cell_indices, attractor_indices] = array
    return columns


def group_by_attractor(motions: MotionResults, label_codes, lanes) -> list[list[int]]:
    """Return the lanes of each attractor, in order of decreasing number of lanes, label code and first lane.

    Undecided lanes are omitted. Two orbits are the same if they have a point on the section in common. Two chaotic
    motions are on the same attractor if they fill the same set (`orbit.samples_fill_same_set`).
    """
    attractor_lanes: list[list[int]] = []
    max_state_magnitude = np.nanmax(abs(motions.points[-1, lanes]), initial=1.0)
    tolerance = np.finfo(motions.points.dtype).eps ** 0.4 * max_state_magnitude
    for lane in lanes[motions.periods[lanes] != UNDECIDED].tolist():
        lane_group = next(
            (
                lane_group
                for lane_group in attractor_lanes
                if _are_on_same_attractor(motions, lane_group[0], lane, tolerance)
            ),
            None,
        )
        if lane_group is None:
            attractor_lanes.append([lane])
        else:
            lane_group.append(lane)
    return sorted(attractor_lanes, key=lambda group: (-len(group), int(label_codes[group[0]]), group[0]))


def _are_on_same_attractor(motions, first_lane, second_lane, tolerance):
    """Return True if two lanes are on the same attractor."""
    n_periods = motions.periods[first_lane]
    if n_periods != motions.periods[second_lane]:
        return False
    if n_periods == CHAOTIC:
        lane_points = (motions.points[:, lane] for lane in (first_lane, second_lane))
        return samples_fill_same_set(*(points[np.isfinite(points).all(axis=1)] for points in lane_points))
    return bool(
        (abs(motions.points[-n_periods:, first_lane] - motions.points[-1, second_lane]).max(axis=1) <= tolerance).any()
    )
