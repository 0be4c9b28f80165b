"""Define the columns of a map's cells and fill them from classified motions."""

from collections.abc import Mapping

import numpy as np

from ..attractors.sweep import STATUS_FLAGS
from ..attractors.tangent import RECORDED_PERIODS
from ..compiled.kernels import BLOCK_WIDTH
from ..maps.long_run import padded_block, take_lanes
from ..maps.wall_loads import LOAD_COLUMNS as LOADS
from ..maps.wall_loads import wall_loads
from ..output import label_codes
from ..output.units import LENGTH, SPEED
from ..scene import check
from ..stores.study import Column
from .motions import CHAOTIC, UNDECIDED, MotionResults

MAX_ATTRACTORS = 8  # attractors of a cell that are stored, the largest shares first
RATE_ATTRS = {"units": "per drive period"}
LABEL, STATUS, PERIOD, ATTRACTORS = "label", "status", "period", "attractors"
QUANTITY_NAMES = (LABEL, PERIOD, "exponent", "state", "loads", ATTRACTORS)


def check_quantities(scene, quantities, n_starts):
    """Return the quantities as a tuple in the order of `QUANTITY_NAMES`; raise ArgumentError for invalid ones."""
    selection = check.name_tuple("quantities", quantities)
    for quantity in selection:
        if quantity not in QUANTITY_NAMES:
            raise check.ArgumentError("quantities", f"must be some of {', '.join(QUANTITY_NAMES)}", quantity)
    if "attractors" in selection and not n_starts:
        raise check.ArgumentError(
            "quantities", "must not contain attractors if a cell has one initial state", selection
        )
    if "loads" in selection and not scene.walls:
        raise check.ArgumentError("quantities", "must not contain loads if the scene has no walls", selection)
    return tuple(name for name in QUANTITY_NAMES if name in selection or name == LABEL)


def make_columns(scene, quantities, is_carried, n_starts) -> Mapping[str, Column]:
    """Return {name: `Column`} of the requested quantities of a scene's cells."""
    direction_dims = {"way": 2} if is_carried else {}
    cell_dims = {"attractor": MAX_ATTRACTORS} if n_starts else direction_dims
    float_type = np.dtype(scene.dtype)
    columns = {
        LABEL: Column(np.dtype(np.int32), label_codes.NOT_DONE, {"long_name": label_codes.CODE_RULE}, cell_dims),
        STATUS: Column(
            np.dtype(np.int8), -1, {"long_name": "worst status, -1 not done", **STATUS_FLAGS}, direction_dims
        ),
    }
    if n_starts:
        columns["share"] = Column(float_type, np.nan, {"long_name": "share of the starts", "units": "1"}, cell_dims)
        attrs = {"long_name": "share of the starts that are undecided", "units": "1"}
        columns["unresolved"] = Column(float_type, np.nan, attrs)
    if ATTRACTORS in quantities:
        columns["attractors"] = Column(np.dtype(np.int16), -1, {"long_name": "attractors, -1 not done"})
    if PERIOD in quantities:
        attrs = {"long_name": "drive periods of the orbit, 0 chaotic, -1 undecided or not done", "units": "1"}
        columns[PERIOD] = Column(np.dtype(np.int16), UNDECIDED, attrs, cell_dims)
    if "exponent" in quantities:
        columns["exponent"] = Column(
            float_type, np.nan, {"long_name": "largest Lyapunov exponent", **RATE_ATTRS}, cell_dims
        )
        columns["exponent_error"] = Column(
            float_type, np.nan, {"long_name": "its standard error", **RATE_ATTRS}, cell_dims
        )
    if "state" in quantities:
        for name, unit in (("x", LENGTH), ("v", SPEED), ("contact", "1")):
            columns[name] = Column(
                float_type, np.nan, {"long_name": f"{name} on Sigma, at the end", "units": unit}, cell_dims
            )
    if "loads" in quantities:
        for name in ("largest_speed", "work_rate"):
            unit, description = LOADS[name]
            wall_dims = {**cell_dims, "wall": len(scene.walls)}
            columns[name] = Column(float_type, np.nan, {"long_name": description, "units": unit}, wall_dims)
    return columns


def motion_columns(scene, motions: MotionResults, study_columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """Return {name: array}, lanes first, of the requested columns that a motion has."""
    values = {
        LABEL: motion_labels(motions),
        STATUS: np.asarray(motions.status, np.int8),
        PERIOD: np.asarray(motions.periods, np.int16),
        "exponent": motions.exponent,
        "exponent_error": motions.error,
        "x": motions.state.x,
        "v": motions.state.v,
        "contact": motions.state.contact,
    }
    if "work_rate" in study_columns:
        values |= _load_columns(scene, motions)
    return {name: array for name, array in values.items() if name in study_columns}


def select_motions(scene, motions: MotionResults, lanes):
    """Return (scene, motions) of some of the lanes; a lane may be repeated."""
    state, impact_counts, points = (
        take_lanes(motions.state, lanes),
        motions.impact_counts[:, lanes],
        motions.points[:, lanes],
    )
    lane_fields = {
        name: getattr(motions, name)[lanes] for name in ("status", "periods", "endless", "exponent", "error")
    }
    return take_lanes(scene, lanes), MotionResults(
        state=state, impact_counts=impact_counts, points=points, **lane_fields
    )


def motion_labels(motions: MotionResults):
    """Return the codes of the motions' labels, (lanes,)."""
    left_impacts, right_impacts = motions.impact_counts
    orbit_codes = label_codes.encode_labels(motions.periods, left_impacts, right_impacts, motions.endless)
    other_codes = np.where(motions.periods == CHAOTIC, label_codes.CHAOTIC, label_codes.UNDECIDED)
    return np.where(motions.periods > 0, orbit_codes, other_codes).astype(np.int32)


def _load_columns(scene, motions):
    """Return {largest_speed, work_rate}, (lanes, walls), in blocks of motions with equal numbers of periods."""
    n_lanes, n_walls = len(motions.periods), len(scene.walls)
    columns = {name: np.full((n_lanes, n_walls), np.nan, scene.dtype) for name in ("largest_speed", "work_rate")}
    periods = np.where(motions.periods == CHAOTIC, RECORDED_PERIODS, motions.periods)
    for n_periods in np.unique(periods[periods > 0]).tolist():
        lanes = np.flatnonzero(periods == n_periods)
        for start in range(0, len(lanes), BLOCK_WIDTH):
            block = lanes[start : start + BLOCK_WIDTH]
            loads = wall_loads(*padded_block(take_lanes((scene, motions.state), block), 0, BLOCK_WIDTH), n_periods)
            for name, column in columns.items():
                column[block] = loads[name].values[: len(block)]
    return columns
