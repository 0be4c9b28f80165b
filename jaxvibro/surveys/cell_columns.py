"""What a map tells of a cell: its columns, and their numbers from the motions."""

from collections.abc import Mapping

import numpy as np

from ..attractors.sweep import MEANING
from ..attractors.tangent import LAPS
from ..compiled.kernels import WIDTH
from ..maps.long_run import padded, some
from ..maps.wall_loads import COLUMNS as LOADS
from ..maps.wall_loads import wall_loads
from ..output import label_codes
from ..output.units import LENGTH, SPEED
from ..scene import check
from ..stores.study import Column
from .motions import CHAOTIC, UNDECIDED, Motions

MOST = 8  # attractors of a cell that are told, the largest shares first
RATE = {"units": "per drive period"}
LABEL, STATUS_OF, PERIOD, ATTRACTORS = "label", "status", "period", "attractors"
NAMES = (LABEL, PERIOD, "exponent", "state", "loads", ATTRACTORS)


def checked(scene, quantities, starts):
    """The quantities as a tuple in the order of `NAMES`. Raises ArgumentError."""
    given = check.sequence("quantities", quantities)
    for one in given:
        if one not in NAMES:
            raise check.ArgumentError("quantities", f"must be some of {', '.join(NAMES)}", one)
    if "attractors" in given and not starts:
        raise check.ArgumentError("quantities", "must be without attractors where a cell has one start", given)
    if "loads" in given and not scene.walls:
        raise check.ArgumentError("quantities", "must be without loads where there is no wall", given)
    return tuple(name for name in NAMES if name in given or name == LABEL)


def columns(scene, quantities, carried, starts) -> Mapping[str, Column]:
    """{name: `Column`} of what is asked for, of a scene's cells."""
    more = {"way": 2} if carried else {}
    each = {"attractor": MOST} if starts else more
    real = np.dtype(scene.dtype)
    found = {
        LABEL: Column(np.dtype(np.int32), label_codes.NOT_DONE, {"long_name": label_codes.RULE}, each),
        STATUS_OF: Column(np.dtype(np.int8), -1, {"long_name": "worst status, -1 not done", **MEANING}, more),
    }
    if starts:
        found["share"] = Column(real, np.nan, {"long_name": "share of the starts", "units": "1"}, each)
        told = {"long_name": "share of the starts that are undecided", "units": "1"}
        found["unresolved"] = Column(real, np.nan, told)
    if ATTRACTORS in quantities:
        found["attractors"] = Column(np.dtype(np.int16), -1, {"long_name": "attractors, -1 not done"})
    if PERIOD in quantities:
        told = {"long_name": "drive periods of the orbit, 0 chaotic, -1 undecided or not done", "units": "1"}
        found[PERIOD] = Column(np.dtype(np.int16), UNDECIDED, told, each)
    if "exponent" in quantities:
        found["exponent"] = Column(real, np.nan, {"long_name": "largest Lyapunov exponent", **RATE}, each)
        found["exponent_error"] = Column(real, np.nan, {"long_name": "its standard error", **RATE}, each)
    if "state" in quantities:
        for name, unit in (("x", LENGTH), ("v", SPEED), ("contact", "1")):
            found[name] = Column(real, np.nan, {"long_name": f"{name} on Sigma, at the end", "units": unit}, each)
    if "loads" in quantities:
        for name in ("largest_speed", "work_rate"):
            unit, meaning = LOADS[name]
            walls = {**each, "wall": len(scene.walls)}
            found[name] = Column(real, np.nan, {"long_name": meaning, "units": unit}, walls)
    return found


def of_motions(scene, found: Motions, asked: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """{name: numbers}, the lanes first, of the columns that are asked for and that a motion has."""
    columns = {
        LABEL: labels(found),
        STATUS_OF: np.asarray(found.status, np.int8),
        PERIOD: np.asarray(found.periods, np.int16),
        "exponent": found.exponent,
        "exponent_error": found.error,
        "x": found.state.x,
        "v": found.state.v,
        "contact": found.state.contact,
    }
    if "work_rate" in asked:
        columns |= _loads(scene, found)
    return {name: each for name, each in columns.items() if name in asked}


def of_lanes(scene, found: Motions, lanes):
    """(the scene, the motions) of some of the lanes, those of one again where it is asked for again."""
    state, hits, points = some(found.state, lanes), found.hits[:, lanes], found.points[:, lanes]
    flat = {name: getattr(found, name)[lanes] for name in ("status", "periods", "endless", "exponent", "error")}
    return some(scene, lanes), Motions(state=state, hits=hits, points=points, **flat)


def labels(found: Motions):
    """The codes of the motions' labels, (lanes,)."""
    left, right = found.hits
    orbit = label_codes.codes(found.periods, left, right, found.endless)
    other = np.where(found.periods == CHAOTIC, label_codes.CHAOTIC, label_codes.UNDECIDED)
    return np.where(found.periods > 0, orbit, other).astype(np.int32)


def _loads(scene, found):
    """{largest_speed, work_rate}: (lanes, walls), in blocks of one shape of motions of as many periods."""
    size, walls = len(found.periods), len(scene.walls)
    columns = {name: np.full((size, walls), np.nan, scene.dtype) for name in ("largest_speed", "work_rate")}
    periods = np.where(found.periods == CHAOTIC, LAPS, found.periods)
    for n in np.unique(periods[periods > 0]).tolist():
        lanes = np.flatnonzero(periods == n)
        for first in range(0, len(lanes), WIDTH):
            block = lanes[first : first + WIDTH]
            loads = wall_loads(*padded(some((scene, found.state), block), 0, WIDTH), n)
            for name, column in columns.items():
                column[block] = loads[name].values[: len(block)]
    return columns
