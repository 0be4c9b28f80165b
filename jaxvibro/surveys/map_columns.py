"""Define the columns of a parameter map and fill the columns from classified motions."""

from collections.abc import Mapping

import numpy as np

from ..attractors.dataset_attributes import STATUS_FLAGS
from ..attractors.tangent_growth import RECORDED_PERIODS
from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.long_iteration import take_lanes, take_padded_block
from ..maps.wall_loads import LOAD_COLUMNS as LOADS
from ..maps.wall_loads import wall_loads
from ..output import label_codes
from ..output.units import LENGTH, SPEED
from ..scene import check
from ..stores.study_protocol import Column
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
