"""Compute the invariant manifolds of a saddle on the section."""

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Real

from continuation.branch_segment import make_limits, partial_result_reason

from ..maps.initial_conditions import initial_box
from ..maps.monodromy import monodromy
from ..maps.sections import shift_phase
from ..maps.strobe_inverse import require_reversible
from ..orbits.orbit import Orbit
from ..output.units import LENGTH, SPEED, scales_attributes
from ..scene import check
from ..scene.scene import rigid_wall_positions
from ..scene.state import State
from .manifold_growth import (
    ManifoldLevel,
    ManifoldPointRules,
    compute_local_manifold,
    grow_manifold_levels,
    iterate_map,
    measure_neighbour_gaps,
)

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
        Largest distance of neighbouring points. At speeds v above the largest speed V of the box of initial states, the
        distance may be larger by the factor v / V.
    angle : float, optional
        Largest turn of the curve between neighbouring points, in rad.
    fastest : float, optional
        Speed beyond which the curve is left out. None takes twice the largest speed of the box of initial states.
    most : int, optional
        Number of points on one side at which the computation of this side ends, at least 100.
    max_seconds : float, optional
        Wall-clock time, in s, after which no further image of the local manifold is computed. The local manifold itself
        is always computed, and the attribute ``stopped`` states how many sides are done. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables along ``point``: ``x``, ``v``; ``arc``, length of the curve from the saddle; ``side``, -1 or 1;
        ``origin``, index of the orbit's point; ``image``, number of times that the map, or its inverse, was applied to
        the local manifold; ``piece``, index of the piece. Along ``piece_end``, for each piece: ``began`` and ``ended``,
        the reasons for its ends (see the notes). Attributes: the parameters of the scene, ``phase``, ``kind``,
        ``label`` and ``multiplier``.

    Raises
    ------
    ArgumentError
        If the orbit is not a saddle, an argument is invalid, or the stable manifold is requested and the motion cannot
        be reversed.

    Notes
    -----
    Reasons for the end of a piece:

    - ``"saddle"``: the saddle itself.
    - ``"section"``: an impact on a rigid wall at the phase of the section. The curve continues from the wall with the
      speed after or before the impact.
    - ``"grazing"``: a corner at which an impact appears or disappears, or at which the mass enters or leaves a soft
      wall at the phase of the section. The corner is the last point of one piece and the first of the next.
    - ``"fast"``: the next part is faster than `fastest` and is left out.
    - ``"resolution"``: the curve is stretched more than rounding allows.
    - ``"attractor"``: the curve ends on an attractor.
    - ``"length"``, ``"points"``, ``"max_seconds"``: a limit.

    Points beyond the face of a soft wall are inside the wall. The stable manifold is grown with the certified map in
    reversed time. The motion cannot be reversed if a wall has ``R = 0``, if a soft wall has critical damping or more,
    or if the damping of the scene is 1 or more.

    Examples
    --------
    >>> saddle = branch.orbit(int(abs(branch.values - 4.65).argmin()))
    >>> data = jv.manifold(saddle, "unstable", length=0.5)
    >>> data["ended"].values.tolist()
    ['length', 'section', 'length']
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    if kind not in KINDS:
        raise check.ArgumentError("kind", f"must be one of {', '.join(KINDS)}", kind)
    scene, is_backward = orbit.scene, kind == "stable"
    point_rules = _make_point_rules(scene, length, spacing, angle, fastest, check.check_whole_number("most", most, 100))
    stretch_factor, periods = _stretch_factor(orbit, kind), orbit.periods
    if is_backward:
        require_reversible(scene)
    phase = float(check.check_finite_array("phase", orbit.state.phase if phase is None else phase, np.float64))
    manifold_sides = []
    for saddle_index, (saddle_point, eigenvector) in enumerate(_saddle_points(orbit, phase, is_backward)):
        local_manifold = compute_local_manifold(
            scene,
            saddle_point,
            eigenvector,
            stretch_factor,
            periods,
            phase,
            is_backward,
            point_rules.scene_length_scale,
        )
        for side in (-1, 1):
            levels, end_reason = grow_manifold_levels(
                scene,
                local_manifold,
                side,
                np.sign(stretch_factor),
                periods,
                phase,
                is_backward,
                point_rules,
                computation_limits,
            )
            manifold_sides.append(
                _assemble_side(scene, phase, saddle_point, levels, end_reason, point_rules)
                | {"side": side, "origin": saddle_index}
            )
    attrs = {"phase": phase, "kind": kind, "label": orbit.label}
    n_sides_done_in_time = sum(manifold_side["ended"][-1] != "max_seconds" for manifold_side in manifold_sides)
    if n_sides_done_in_time < len(manifold_sides):
        attrs["stopped"] = partial_result_reason(n_sides_done_in_time, len(manifold_sides), "sides")
    return _make_dataset(scene, manifold_sides, attrs | {"multiplier": float(_saddle_multiplier(orbit, kind))})


def _make_point_rules(scene, length, spacing, angle, fastest, max_points):
    """Check the arguments and return the `ManifoldPointRules`."""
    start_box_x_min, start_box_x_max, start_box_max_speed = initial_box(scene)
    fastest = 2.0 * start_box_max_speed if fastest is None else fastest
    arguments = {"length": length, "spacing": spacing, "angle": angle, "fastest": fastest}
    values = {key: float(check.check_finite_array(key, value, np.float64)) for key, value in arguments.items()}
    for key, value in values.items():
        if not value > 0:
            raise check.ArgumentError(key, "must be greater than 0", value)
    return ManifoldPointRules(
        scene_length_scale=max(abs(float(start_box_x_min)), abs(float(start_box_x_max))),
        min_distance=1e-3 * values["spacing"],
        max_unscaled_speed=float(start_box_max_speed),
        max_points=max_points,
        **values,
    )


def _saddle_multiplier(orbit, kind):
    """Return the multiplier of the manifold; raise ArgumentError if the orbit is not a saddle."""
    larger_multiplier, smaller_multiplier = sorted(orbit.multipliers, key=abs, reverse=True)
    if larger_multiplier.imag or not abs(larger_multiplier) > 1 > abs(smaller_multiplier):
        raise check.ArgumentError(
            "orbit", "must be a saddle: one multiplier inside the unit circle, one outside", orbit
        )
    return (smaller_multiplier if kind == "stable" else larger_multiplier).real


def _stretch_factor(orbit, kind):
    """Return the factor by which one period of the orbit, or of its inverse, stretches the curve.

    The factor is negative if the map exchanges both sides of the saddle.
    """
    saddle_multiplier = _saddle_multiplier(orbit, kind)
    if saddle_multiplier == 0:
        raise check.ArgumentError("orbit", "must have no multiplier 0 for its stable manifold to be a curve", orbit)
    return saddle_multiplier if kind == "unstable" else 1.0 / saddle_multiplier


def _saddle_points(orbit, phase, is_backward):
    """Yield (point, eigenvector) of each of the orbit's points on the section at a phase."""
    scene, state = orbit.scene, orbit.state
    lane_state = State(
        *(np.full(1, float(value), scene.dtype) for value in (state.x, state.v, state.phase, state.contact))
    )
    orbit_section_state, _ = shift_phase(scene, lane_state, phase)
    orbit_point = np.array([[orbit_section_state.x[0], orbit_section_state.v[0]]], float)
    for _ in range(orbit.periods):
        monodromy_matrix = np.asarray(monodromy(scene, State(*orbit_point[0], phase), orbit.periods), float)
        if not np.isfinite(monodromy_matrix).all():
            raise check.ArgumentError("phase", "must not be the phase of an impact or of sticking", phase)
        eigenvalues, eigenvectors = np.linalg.eig(monodromy_matrix)
        eigenvalue_index = np.argmin(abs(eigenvalues)) if is_backward else np.argmax(abs(eigenvalues))
        eigenvector = eigenvectors[:, eigenvalue_index].real
        yield orbit_point[0], eigenvector * np.sign(eigenvector[np.argmax(abs(eigenvector))])
        orbit_point, _, _ = iterate_map(scene, orbit_point, phase, 1, False)


def _assemble_side(scene, phase, saddle_point, levels, end_reason, point_rules):
    """Assemble one side of the manifold at one point of the orbit, from the saddle outwards.

    Returns arrays over the points and over the pieces.
    """
    rigid_positions = [position for position in rigid_wall_positions(scene, phase) if np.isfinite(position)]
    states, is_valid, image_numbers, break_reasons = [saddle_point[None]], [[True]], [[0]], [[""]]
    for level_index, manifold_level in enumerate(levels):
        manifold_level = _drop_rounding_pieces(manifold_level, rigid_positions, point_rules)
        indices_with_corners, level_break_reasons = _duplicate_corners(
            manifold_level, _break_reasons(manifold_level, rigid_positions, point_rules)
        )
        indices_without_joint = indices_with_corners[
            min(level_index, 1) :
        ]  # the first point of a level is the last of the previous one
        states.append(manifold_level.z[indices_without_joint])
        is_valid.append(manifold_level.is_valid[indices_without_joint])
        image_numbers.append(np.full(len(indices_without_joint), level_index))
        break_reasons.append(level_break_reasons if level_index else np.append("", level_break_reasons))
    states, is_valid, image_numbers, break_reasons = map(
        np.concatenate, (states, is_valid, image_numbers, break_reasons)
    )
    piece_numbers = np.cumsum(break_reasons != "")[is_valid]
    piece_start_indices = np.flatnonzero(np.append(True, np.diff(piece_numbers) != 0))
    start_reasons = break_reasons[np.flatnonzero(is_valid)[piece_start_indices]]
    end_reasons = np.append(break_reasons, end_reason)[
        np.flatnonzero(is_valid)[np.append(piece_start_indices[1:], len(piece_numbers)) - 1] + 1
    ]
    start_reasons[0], end_reasons[-1] = "saddle", end_reason
    states, piece_numbers = (
        states[is_valid],
        np.repeat(np.arange(len(piece_start_indices)), np.diff(np.append(piece_start_indices, len(piece_numbers)))),
    )
    step_lengths = np.where(
        np.append(True, np.diff(piece_numbers) != 0), 0.0, np.hypot(*np.diff(states, axis=0, prepend=states[:1]).T)
    )
    return {
        "z": states,
        "image": image_numbers[is_valid],
        "piece": piece_numbers,
        "arc": np.cumsum(step_lengths),
        "began": start_reasons,
        "ended": end_reasons,
    }


def _break_reasons(manifold_level, rigid_positions, point_rules):
    """Return the reason why the points of each pair of neighbours are not connected, "" for a connected pair."""
    spacing_ratios, is_connected, _ = measure_neighbour_gaps(manifold_level, point_rules)
    is_valid_pair = manifold_level.is_valid[:-1] & manifold_level.is_valid[1:]
    with np.errstate(invalid="ignore"):
        wall_masks = [
            (abs(manifold_level.z[:, 0] - position) <= SAME_POINT_DISTANCE * point_rules.scene_length_scale)
            for position in rigid_positions
        ]
    is_section_impact = np.any([is_at_wall[:-1] & is_at_wall[1:] for is_at_wall in wall_masks], axis=0)
    impact_count_changes = np.diff(manifold_level.n_impacts) != 0
    break_reasons = np.where(impact_count_changes & (spacing_ratios <= 1.0), "grazing", "resolution")
    break_reasons = np.where(impact_count_changes & is_section_impact, "section", break_reasons)
    return np.where(is_connected, "", np.where(is_valid_pair, break_reasons, "fast"))


def _drop_rounding_pieces(manifold_level, rigid_positions, point_rules):
    """Remove pieces shorter than `SAME_POINT_DISTANCE` between two impacts at the phase of the section.

    The refinement brackets an impact at the phase of the section until neighbours are only rounding errors apart. The
    numbers of impacts of such neighbours may alternate.
    """
    section_break_indices = np.flatnonzero(_break_reasons(manifold_level, rigid_positions, point_rules) == "section")
    is_retained = np.ones(len(manifold_level.u), bool)
    for first_index, last_index in zip(section_break_indices[:-1] + 1, section_break_indices[1:], strict=True):
        is_retained[first_index : last_index + 1] = (
            np.ptp(manifold_level.z[first_index : last_index + 1], axis=0).max()
            > SAME_POINT_DISTANCE * point_rules.scene_length_scale
        )
    return ManifoldLevel(*(array[is_retained] for array in manifold_level))


def _duplicate_corners(manifold_level, break_reasons):
    """Return (indices of points, break reasons between them) with each grazing corner in both adjacent pieces.

    Of the two neighbours of a corner, the point with fewer impacts represents it. The distance of this point from the
    corner is of the order of the parameter step. The distance of the other neighbour is of the order of the square root
    of the step, like the speed of a grazing impact. The curve between both neighbours is nearly straight.
    """
    grazing_gap_indices = np.flatnonzero(break_reasons == "grazing")
    corner_indices = grazing_gap_indices + (
        manifold_level.n_impacts[grazing_gap_indices] > manifold_level.n_impacts[grazing_gap_indices + 1]
    )
    indices_with_corners = np.sort(np.append(np.arange(len(manifold_level.u)), corner_indices))
    new_break_reasons = np.where(break_reasons == "grazing", "", break_reasons)[
        np.minimum(indices_with_corners[:-1], len(break_reasons) - 1)
    ]
    return indices_with_corners, np.where(
        indices_with_corners[:-1] == indices_with_corners[1:], "grazing", new_break_reasons
    )


def _make_dataset(scene, manifold_sides, attrs):
    """Concatenate the sides of the manifold in a Dataset and number their pieces consecutively."""
    length_attrs, speed_attrs = {"units": LENGTH}, {"units": SPEED}
    n_pieces_before_side = np.cumsum([0, *(len(manifold_side["began"]) for manifold_side in manifold_sides)])
    n_points_by_side = [len(manifold_side["z"]) for manifold_side in manifold_sides]
    points, image_numbers, arc_lengths = (
        np.concatenate([manifold_side[key] for manifold_side in manifold_sides]) for key in ("z", "image", "arc")
    )
    piece_numbers = np.concatenate(
        [
            manifold_side["piece"] + n_pieces_before
            for manifold_side, n_pieces_before in zip(manifold_sides, n_pieces_before_side, strict=False)
        ]
    )
    side_of_point, saddle_index_of_point = (
        np.repeat([manifold_side[key] for manifold_side in manifold_sides], n_points_by_side)
        for key in ("side", "origin")
    )
    return xr.Dataset(
        {
            "x": ("point", points[:, 0], {"long_name": "displacement", **length_attrs}),
            "v": ("point", points[:, 1], {"long_name": "velocity", **speed_attrs}),
            "arc": ("point", arc_lengths, {"long_name": "length of the curve from the saddle on"}),
            "image": ("point", image_numbers, {"long_name": "times that the map was applied"}),
            "piece": ("point", piece_numbers),
            "side": ("point", side_of_point),
            "origin": ("point", saddle_index_of_point),
            "began": ("piece_end", np.concatenate([manifold_side["began"] for manifold_side in manifold_sides])),
            "ended": ("piece_end", np.concatenate([manifold_side["ended"] for manifold_side in manifold_sides])),
        },
        attrs=scene.numbers | scales_attributes(scene) | attrs,
    )
