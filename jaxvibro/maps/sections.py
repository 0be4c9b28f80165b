"""What a motion leaves on the three sections: states on Sigma, impacts on the walls L and R (paper, 1)."""

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from ..flight.wall_positions import SIGNS, places
from ..output.units import ANGLE, LENGTH, SPEED, scales_in
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import SIDES, Scene
from ..scene.state import State, check_start, real_state
from .iterate import KEEP, ends, iterate
from .phase_shift import shift_phase


@check.host("use return_map or strobe")
def sections(
    scene: Scene, state: State, phase: Real[ArrayLike, ""] = 0.0, periods: int = 1000, settle: int = 300
) -> xr.Dataset:
    """A motion's points on Sigma, L and R: an xarray.Dataset.

    scene: a single one; state: a `State` of numbers, at its phase. settle: drive periods left out; periods: those
    looked at after them. phase: of the drive at which Sigma lies, rad.

    x, v on Sigma along "period", in order: the map P1 leads from each to the next; a mass within a soft wall there is
    past it. left_phase (rad, from 0 to 2 pi) and left_velocity, right_phase and right_velocity: of the drive at each
    impact on a wall and of the mass after it, in order: P2 and P3 lead from each to the next (`return_map`). At a soft
    wall an impact is an entry, which leaves the velocity as it is, into the wall. At most 16 impacts a period are seen.

    Raises ArgumentError for a batch, numbers that cannot be, and a motion that ends with a bad status.
    """
    check.require_single(scene)
    settle, periods = check.whole("settle", settle, 0), check.whole("periods", periods, 1)
    state = real_state(scene, state)
    if np.shape(state.x + state.v + state.phase + state.contact):
        raise check.ArgumentError("state", "must be a single state, not a batch", f"shape {np.shape(state.x)}")
    check_start(scene, state)
    given = check.number("phase", phase, np.float64)
    if given.shape:
        raise check.ArgumentError("phase", "must be a number", given)
    turned = float(given)
    state = State(*(np.reshape(np.asarray(each), 1) for each in (state.x, state.v, state.phase, state.contact)))
    if settle:
        state = _good(*ends(scene, state, settle))
    state = _good(*shift_phase(scene, state, turned))
    parts = []
    for first in range(0, periods, KEEP):
        run = iterate(scene, state, min(KEEP, periods - first))
        state = _good(run.state, run.status)
        parts.append(run)
    return _dataset(scene, turned, parts)


def _good(state, status):
    if status[0] >= Status.CAP:
        raise check.ArgumentError("state", "must start a motion that goes on", Status(status[0]).word)
    return state


def _dataset(scene, phase, parts):
    x, v, time, side, speed = (
        np.concatenate([getattr(run, key)[:, 0] for run in parts]) for key in ("x", "v", "time", "side", "speed")
    )
    columns = {"x": ("period", x, {"units": LENGTH}), "v": ("period", v, {"units": SPEED})}
    for name, sign, k in zip(SIDES, SIGNS, (0, 1), strict=True):
        hit = side == sign
        angle = phase + float(scene.frequency) * time[hit]
        after = np.empty(0)
        if getattr(scene, name) is not None:
            pace = np.asarray(places(scene, angle)[k][1])
            after = pace - float(scene.bounce(name)) * sign * speed[hit]
        columns[f"{name}_phase"] = f"{name}_impact", np.mod(angle, 2.0 * np.pi), {"units": ANGLE}
        columns[f"{name}_velocity"] = f"{name}_impact", after, {"units": SPEED}
    return xr.Dataset(columns, attrs=scene.numbers | {"phase": phase} | scales_in(scene))
