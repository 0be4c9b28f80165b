"""Compute the invariant manifolds of a saddle on the section."""

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.limits import limits_of, partial_reason

from ..maps.initial_conditions import initial_box
from ..maps.inverse import require_reversible
from ..maps.monodromy import monodromy
from ..maps.phase_shift import shift_phase
from ..orbits.orbit import Orbit
from ..output.units import LENGTH, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import rigid_wall_positions
from ..scene.state import State
from .global_manifold import ManifoldLevel, ManifoldRules, grow_levels, neighbour_gaps
from .local_manifold import compute_local_manifold, iterate_map

KINDS = ("stable", "unstable")
SAME_POINT_DISTANCE = 1e-6  # times the scene's size: nearer points are one, and a point nearer to a wall is on it


@check.host_only("use strobe or monodromy")
def manifold(
    orbit: Orbit,
    kind: str,
    length: Real[ArrayLike, ""] = 20.0,
    phase: Real[ArrayLike, ""] | None = None,
    spacing: Real[ArrayLike, ""] = 0.01,
    angle: Real[ArrayLike, ""] = 0.05,
    fastest: Real[ArrayLike, ""] | None = None,
    most: int = 200_000,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """Compute the stable or unstable manifold of a saddle of the stroboscopic map.

    Both sides of each point of the orbit are computed.

    Parameters
    ----------
    orbit : Orbit
        Saddle: an orbit with one multiplier inside the unit circle and one outside.
    kind : {"stable", "unstable"}
        Manifold to compute.
    length : float, optional
        Length of the curve on each side of each point.
    phase : float, optional
        Phase of the section, in rad. None takes that of the orbit.
    spacing : float, optional
        Largest distance of neighbouring points. Beyond the largest speed of the box of initial states it grows with the
        speed.
    angle : float, optional
        Largest turn of the curve between neighbouring points, in rad.
    fastest : float, optional
        Speed beyond which the curve is left out. None takes twice the largest speed of the box of initial states.
    most : int, optional
        Largest number of points on one side, at least 100.
    max_seconds : float, optional
        Wall-clock time, in s, after which no further image of a piece is computed. Each side has its first piece at
        least, and the attribute ``stopped`` states how many sides are done. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables along ``point``: ``x``, ``v``; ``arc``, length of the curve from the saddle; ``side``, -1 or 1;
        ``origin``, index of the orbit's point; ``image``, number of applications of the map, or its inverse, to the
        piece at the saddle, which has 0; ``piece``. Along ``piece_end``, for each piece: ``began`` and ``ended``, the
        reasons listed in the notes. Attributes: the parameters of the scene, ``phase``, ``kind``, ``label`` and
        ``multiplier``.

    Raises
    ------
    ArgumentError
        If the orbit is not a saddle or an argument is invalid.

    Notes
    -----
    Reasons for the end of a piece:

    - ``"saddle"``: the saddle itself.
    - ``"section"``: an impact on a rigid wall at the phase of the section. The curve continues from the wall with the
      speed after or before the impact.
    - ``"grazing"``: a corner at which an impact appears or disappears. For a soft wall also an entry or exit at the
      phase of the section. It is the last point of one piece and the first of the next.
    - ``"fast"``: faster parts are left out.
    - ``"resolution"``: the curve is stretched more than rounding allows.
    - ``"attractor"``: the curve ends on an attractor.
    - ``"length"``, ``"points"``, ``"max_seconds"``: a limit.

    Points beyond the face of a soft wall are inside the wall. The stable manifold is grown with the certified map in
    reversed time. A wall with ``R = 0``, and a soft wall with critical damping or more, cannot be reversed.

    Examples
    --------
    >>> saddle = branch.orbit(int(abs(branch.values - 4.65).argmin()))
    >>> data = jv.manifold(saddle, "unstable", length=0.5)
    >>> data["ended"].values.tolist()
    ['length', 'section', 'length']
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit", orbit)
    if kind not in KINDS:
        raise check.ArgumentError("kind", f"must be one of {', '.join(KINDS)}", kind)
    scene, inverse = orbit.scene, kind == "stable"
    scene_size, rules = _check_rules(scene, length, spacing, angle, fastest, check.whole_number("most", most, 100))
    stretch, periods = _stretch_factor(orbit, kind), orbit.periods
    if inverse:
        require_reversible(scene)
    phase = float(check.finite_array("phase", orbit.state.phase if phase is None else phase, np.float64))
    branches = []
    for saddle_index, (saddle, direction) in enumerate(_saddle_points(orbit, phase, inverse)):
        local_manifold = compute_local_manifold(scene, saddle, direction, stretch, periods, phase, inverse, scene_size)
        for side in (-1, 1):
            levels, end_reason = grow_levels(
                scene, local_manifold, side, np.sign(stretch), periods, phase, inverse, scene_size, rules, limits
            )
            branches.append(
                _assemble_branch(scene, phase, saddle, levels, end_reason, scene_size, rules)
                | {"side": side, "origin": saddle_index}
            )
    attrs = {"phase": phase, "kind": kind, "label": orbit.label}
    n_complete = sum(branch["ended"][-1] != "max_seconds" for branch in branches)
    attrs |= {} if n_complete == len(branches) else {"stopped": partial_reason(n_complete, len(branches), "sides")}
    return _make_dataset(scene, branches, attrs | {"multiplier": float(_multiplier(orbit, kind))})


def _check_rules(scene, length, spacing, angle, fastest, max_points):
    """Return (size of the scene, `ManifoldRules`) of checked arguments."""
    x_min, x_max, max_speed = initial_box(scene)
    fastest = 2.0 * max_speed if fastest is None else fastest
    arguments = {"length": length, "spacing": spacing, "angle": angle, "fastest": fastest}
    values = {key: float(check.finite_array(key, value, np.float64)) for key, value in arguments.items()}
    for key, value in values.items():
        if not value > 0:
            raise check.ArgumentError(key, "must be greater than 0", value)
    scene_size = max(abs(float(x_min)), abs(float(x_max)))
    return scene_size, ManifoldRules(
        min_distance=1e-3 * values["spacing"], usual_speed=float(max_speed), max_points=max_points, **values
    )


def _multiplier(orbit, kind):
    """Return the multiplier of the manifold; raise ArgumentError if the orbit is not a saddle."""
    larger, smaller = sorted(orbit.multipliers, key=abs, reverse=True)
    if larger.imag or not abs(larger) > 1 > abs(smaller):
        raise check.ArgumentError(
            "orbit", "must be a saddle: one multiplier inside the unit circle, one outside", orbit
        )
    return (smaller if kind == "stable" else larger).real


def _stretch_factor(orbit, kind):
    """Return the stretch of a piece in one turn of the orbit or of its inverse; negative if the sides swap."""
    multiplier = _multiplier(orbit, kind)
    if multiplier == 0:
        raise check.ArgumentError("orbit", "must have no multiplier 0 for its stable manifold to be a curve", orbit)
    return multiplier if kind == "unstable" else 1.0 / multiplier


def _saddle_points(orbit, phase, inverse):
    """Yield (point, eigenvector) of each of the orbit's points on the section at a phase."""
    scene, state = orbit.scene, orbit.state
    lane_state = State(
        *(np.full(1, float(value), scene.dtype) for value in (state.x, state.v, state.phase, state.contact))
    )
    shifted_state, _ = shift_phase(scene, lane_state, phase)
    point = np.array([[shifted_state.x[0], shifted_state.v[0]]], float)
    for _ in range(orbit.periods):
        matrix = np.asarray(monodromy(scene, State(*point[0], phase), orbit.periods), float)
        if not np.isfinite(matrix).all():
            raise check.ArgumentError("phase", "must not be the phase of an impact or of sticking", phase)
        eigenvalues, eigenvectors = np.linalg.eig(matrix)
        index = np.argmin(abs(eigenvalues)) if inverse else np.argmax(abs(eigenvalues))
        direction = eigenvectors[:, index].real
        yield point[0], direction * np.sign(direction[np.argmax(abs(direction))])
        point, _, _ = iterate_map(scene, point, phase, 1, False)


def _assemble_branch(scene, phase, saddle, levels, end_reason, scene_size, rules):
    """Return one side of one point from the saddle outwards: arrays over its points and its piece ends."""
    wall_positions = [position for position in rigid_wall_positions(scene, phase) if np.isfinite(position)]
    z, valid, images, reasons = [saddle[None]], [[True]], [[0]], [[""]]
    for level_index, level in enumerate(levels):
        level = _drop_rounding_pieces(level, wall_positions, scene_size, rules)
        indices, gap_reasons = _duplicate_corners(level, _break_reasons(level, wall_positions, scene_size, rules))
        new_indices = indices[min(level_index, 1) :]  # the first point of a level is the last of the previous one
        z.append(level.z[new_indices])
        valid.append(level.valid[new_indices])
        images.append(np.full(len(new_indices), level_index))
        reasons.append(gap_reasons if level_index else np.append("", gap_reasons))
    z, valid, images, reasons = map(np.concatenate, (z, valid, images, reasons))
    piece = np.cumsum(reasons != "")[valid]
    piece_starts = np.flatnonzero(np.append(True, np.diff(piece) != 0))
    start_reasons = reasons[np.flatnonzero(valid)[piece_starts]]
    end_reasons = np.append(reasons, end_reason)[np.flatnonzero(valid)[np.append(piece_starts[1:], len(piece)) - 1] + 1]
    start_reasons[0], end_reasons[-1] = "saddle", end_reason
    z, piece = z[valid], np.repeat(np.arange(len(piece_starts)), np.diff(np.append(piece_starts, len(piece))))
    step_lengths = np.where(np.append(True, np.diff(piece) != 0), 0.0, np.hypot(*np.diff(z, axis=0, prepend=z[:1]).T))
    return {
        "z": z,
        "image": images[valid],
        "piece": piece,
        "arc": np.cumsum(step_lengths),
        "began": start_reasons,
        "ended": end_reasons,
    }


def _break_reasons(level, wall_positions, scene_size, rules):
    """Return for each pair of neighbours the reason why they are not joined, "" if they are."""
    spacing_ratio, connected, _ = neighbour_gaps(level, scene_size, rules)
    valid = level.valid[:-1] & level.valid[1:]
    with np.errstate(invalid="ignore"):
        at_wall = [(abs(level.z[:, 0] - position) <= SAME_POINT_DISTANCE * scene_size) for position in wall_positions]
    at_section = np.any([flags[:-1] & flags[1:] for flags in at_wall], axis=0)
    count_changes = np.diff(level.n_impacts) != 0
    reasons = np.where(count_changes & (spacing_ratio <= 1.0), "grazing", "resolution")
    reasons = np.where(count_changes & at_section, "section", reasons)
    return np.where(connected, "", np.where(valid, reasons, "fast"))


def _drop_rounding_pieces(level, wall_positions, scene_size, rules):
    """Return the level without pieces between two impacts at the phase of the section that are one up to rounding.

    The break is bracketed until neighbours are rounding errors apart; their numbers of impacts may then alternate.
    """
    breaks = np.flatnonzero(_break_reasons(level, wall_positions, scene_size, rules) == "section")
    is_kept = np.ones(len(level.u), bool)
    for first, last in zip(breaks[:-1] + 1, breaks[1:], strict=True):
        is_kept[first : last + 1] = np.ptp(level.z[first : last + 1], axis=0).max() > SAME_POINT_DISTANCE * scene_size
    return ManifoldLevel(*(array[is_kept] for array in level))


def _duplicate_corners(level, reasons):
    """Return (indices of points, reasons between them) with each corner in both of its pieces.

    The corner is the neighbour with fewer impacts. Its distance from the true corner is of the order of the parameter
    step, the other's only of its square root (the speed of a grazing impact). The curve between them is as straight as
    it is short.
    """
    grazing_indices = np.flatnonzero(reasons == "grazing")
    corner_indices = grazing_indices + (level.n_impacts[grazing_indices] > level.n_impacts[grazing_indices + 1])
    indices = np.sort(np.append(np.arange(len(level.u)), corner_indices))
    gap_reasons = np.where(reasons == "grazing", "", reasons)[np.minimum(indices[:-1], len(reasons) - 1)]
    return indices, np.where(indices[:-1] == indices[1:], "grazing", gap_reasons)


def _make_dataset(scene, branches, attrs):
    """Concatenate the branches and number their pieces consecutively."""
    length_attrs, speed_attrs = {"units": LENGTH}, {"units": SPEED}
    piece_offsets = np.cumsum([0, *(len(branch["began"]) for branch in branches)])
    n_points = [len(branch["z"]) for branch in branches]
    points, images, arc_lengths = (
        np.concatenate([branch[key] for branch in branches]) for key in ("z", "image", "arc")
    )
    pieces = np.concatenate([branch["piece"] + offset for branch, offset in zip(branches, piece_offsets, strict=False)])
    sides, saddle_indices = (np.repeat([branch[key] for branch in branches], n_points) for key in ("side", "origin"))
    return xr.Dataset(
        {
            "x": ("point", points[:, 0], {"long_name": "displacement", **length_attrs}),
            "v": ("point", points[:, 1], {"long_name": "velocity", **speed_attrs}),
            "arc": ("point", arc_lengths, {"long_name": "length of the curve from the saddle on"}),
            "image": ("point", images, {"long_name": "times that the map was applied"}),
            "piece": ("point", pieces),
            "side": ("point", sides),
            "origin": ("point", saddle_indices),
            "began": ("piece_end", np.concatenate([branch["began"] for branch in branches])),
            "ended": ("piece_end", np.concatenate([branch["ended"] for branch in branches])),
        },
        attrs=scene.numbers | scales_attributes(scene) | attrs,
    )
