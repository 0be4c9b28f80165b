"""Compute basin fractions along a parameter and match the attractors between its values."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import UNLIMITED, limits_of, partial_reason

from ..attractors.find import make_attractors, settle_starts
from ..attractors.shares import SIGNIFICANCE_LEVEL, share_bounds
from ..attractors.sweep import STATUS_FLAGS, UNITS_TEXT, equation_text, other_parameters, static_attributes
from ..maps.initial_conditions import draw_initial_states
from ..output.units import LENGTH, SPEED, scales_attributes, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.unit_mistakes import require_scene_units
from .attractor_transport import ParameterNode, transport_attractors
from .least_shock import least_shock
from .matching import match_attractors, nearest_rotation

MAX_NETCDF_INT = 2**31 - 1  # largest integer in a NetCDF file of the classic format


@check.host_only("use strobe")
def fractions(
    scene: Scene,
    name: str,
    values: Real[ArrayLike, " values"] | Sequence[float],
    starts: int = 200,
    seed: int = 0,
    settle: int = 300,
    shocks: int = 0,
    progress: Callable[[int], object] | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """Compute basin fractions along a parameter.

    At each value the attractors are found from random initial states. Each attractor is matched with its continuation
    at the next value.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    name : str
        Parameter of the scene, for example ``"amplitude"`` or ``"left.position"``.
    values : array_like
        Values of the parameter, increasing. Array of shape (values,).
    starts : int, optional
        Number of random initial states at each value.
    seed : int, optional
        Seed of the random draw. The initial states of a value depend on the seed and the value only.
    settle : int, optional
        Drive periods before recurrence is tested, as in `find_attractors`.
    shocks : int, optional
        Number of shocks for the minimal fatal shock of each attractor at each value. 0 omits it.
    progress : callable, optional
        Called with the number of values whose initial states have settled.
    max_seconds : float, optional
        Wall-clock time, in s, after which no further value is started and no further shock is searched. The first value
        is always done. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables with dimensions (name, attractor): ``share``, ``share_low`` and ``share_high``, the basin fraction and
        its bounds at 95 % confidence, nan where the attractor does not exist; ``label`` (P n p q, ``"chaotic"``),
        ``""`` where it does not exist; ``kind``, ``"periodic"``, ``"chaotic"`` or ``""``; ``periods``, 0 if it is not
        periodic; ``exponent``, the largest Lyapunov exponent per drive period; ``state_x`` and ``state_v``, a state on
        it at phase 0; ``mirror_of``, the index of its mirror image, its own if it is symmetric, -1 for none. With
        `shocks`, ``least_shock``: the smallest impulse at phase 0 that makes the motion leave the attractor (see
        `least_shock`), inf if none does, nan if it is unknown, for example if an impact falls on that phase. Variables
        along `name`: ``unresolved``, ``unresolved_low`` and ``unresolved_high``, the fraction of initial states on no
        attractor; ``status``, the worst of the initial states, as in `Impacts`. Attributes: ``starts`` and ``seed``.

    Raises
    ------
    ArgumentError
        If the scene has lanes, the name is unknown, the values do not increase or break a rule of the scene, or a count
        is invalid. All arguments are checked before any computation.

    See Also
    --------
    find_attractors : Find the attractors at one value.
    least_shock : Find the minimal fatal shock of an attractor.

    Notes
    -----
    The initial states differ between values. So the errors are independent along the parameter, and the result at a
    value does not depend on the other values.

    An attractor keeps its index as long as the motion that starts on it, carried in small steps of the parameter,
    approaches its continuation at the next value, and returns from there. This includes period doublings, and grazings
    without a jump: the label changes. If a branch ends and its motion falls onto another attractor, that one keeps its
    own index. At a symmetry breaking, the asymmetric attractor whose label comes first, or else whose mean x at phase 0
    is lower, keeps the index; its mirror image has another. An attractor that is carried to a value at which no initial
    state found it has the share 0 there.

    After `max_seconds`, the attractors of the values that are done are still matched. The other values have shares of
    nan, the label ``""`` and the status -1, and the attribute ``stopped`` gives the reason.

    References
    ----------
    Clopper and Pearson (1934): exact bounds. For 0 initial states, or all of them, the bound is one-sided.

    Examples
    --------
    >>> data = jv.fractions(scene, "amplitude", [1.9, 2.0], starts=20)
    >>> data["label"].values.tolist()
    [['P111', 'P100'], ['P111', 'P100']]
    >>> data["share"].values.round(2).tolist()
    [[0.9, 0.1], [0.95, 0.05]]
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    values = _check_values(scene, name, values)
    starts, settle = check.whole_number("starts", starts, 1), check.whole_number("settle", settle, 0)
    seed, shocks = check.whole_number("seed", seed, 0), check.whole_number("shocks", shocks, 0)
    nodes: list[ParameterNode] = []
    for value in values:
        if nodes and limits.expired:
            break
        nodes.append(_settle_node(scene.replace(**{name: value}), float(value), starts, seed, settle))
        if progress is not None:
            progress(len(nodes))
    transport_attractors(nodes, name, settle)
    tracks = match_attractors(nodes, name, settle) or [{}]
    node_attractors = [make_attractors(node.scene, node.candidates, starts) for node in nodes]
    data, n_done = (
        _make_dataset(scene, name, values[: len(nodes)], nodes, node_attractors, tracks, starts, seed),
        len(nodes),
    )
    if shocks:
        shock_sizes, n_done = _least_shocks(nodes, node_attractors, tracks, shocks, limits)
        shock_attrs = {"long_name": "least impulse at phase 0 that makes the motion leave", "units": SPEED}
        data = data.assign(least_shock=((name, "attractor"), shock_sizes, shock_attrs)).assign_attrs(shocks=shocks)
    if len(nodes) < len(values):
        data = _pad_values(data, name, values)
    if n_done < len(values):
        data = data.assign_attrs(stopped=partial_reason(n_done, len(values), "values"))
    return data


def _check_values(scene, name, values) -> Float[np.ndarray, " values"]:
    """Return the values of the parameter, checked."""
    check.require_parameter(name, scene.names, name)
    values = check.finite_array(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(name, "must be one or more values in increasing order", values)
    require_scene_units("values", scene, name, values)
    scene.replace(**{name: values})
    return values


def _settle_node(scene, value, n_starts, seed, settle):
    """Return the `ParameterNode` of a value with the attractors of its own initial states."""
    start_states = draw_initial_states(scene, n_starts, (seed, int(np.float64(value).view(np.uint64))))
    settled_starts = settle_starts(scene, start_states, settle)
    return ParameterNode(
        value,
        scene,
        settled_starts.candidates,
        len(settled_starts.failures),
        settled_starts.scale,
        int(settled_starts.status.max()),
    )


def _least_shocks(nodes, node_attractors, tracks, n_shocks, limits=UNLIMITED):
    """Return (smallest impulses, (values, attractors), number of values searched)."""
    shock_sizes = np.full((len(nodes), len(tracks)), np.nan)
    for node_index, node in enumerate(nodes):
        if limits.expired:
            return shock_sizes, node_index
        shock_sizes[node_index] = [
            _least_shock_size(node.scene, node_attractors[node_index], track.get(node_index), n_shocks)
            for track in tracks
        ]
    return shock_sizes, len(nodes)


def _pad_values(data, name, values):
    """Extend the data to all values, blank at those that are not done."""
    fill_values = {key: BLANK_VALUES.get(key, np.nan) for key in data.data_vars}
    dtypes = {key: data[key].dtype for key in data.data_vars}
    padded_data = data.reindex({name: values}, fill_value=fill_values)
    return padded_data.assign({key: padded_data[key].astype(dtype) for key, dtype in dtypes.items()})


def _least_shock_size(scene, attractors, index, n_shocks):
    """Return the smallest impulse at phase 0 of an attractor; nan for none, or without a trapping region there."""
    if index is None:
        return np.nan
    try:
        return least_shock(scene, attractors, index, shocks=n_shocks).size
    except check.ArgumentError as error:
        if error.key != "phase":
            raise
        return np.nan


def _make_dataset(scene, name, values, nodes, node_attractors, tracks, n_starts, seed):
    """Return the named result of the attractors at each value and their tracks along the parameter."""
    rows = [
        [_attractor_entry(node_attractors, item, node_index) for item in tracks]
        for node_index in range(len(node_attractors))
    ]
    for node_index, row in enumerate(rows):
        for item, entry in zip(tracks, row, strict=True):
            entry["mirror_of"] = _mirror_index(node_attractors[node_index], item, node_index, tracks)
    n_unresolved = np.array([item.n_unresolved for item in nodes])
    lower, upper = np.array([share_bounds(int(count), n_starts) for count in n_unresolved]).T
    unresolved_attrs = {"long_name": "share of the starts on no attractor", "units": "1"}
    variables = {
        **{
            key: ((name, "attractor"), _entry_column(rows, key), column_attrs)
            for key, column_attrs in COLUMN_ATTRS.items()
        },
        "unresolved": (name, n_unresolved / n_starts, unresolved_attrs),
        "unresolved_low": (name, lower, {"long_name": "lower bound of it at 95 %", "units": "1"}),
        "unresolved_high": (name, upper, {"long_name": "upper bound of it at 95 %", "units": "1"}),
        "status": (
            name,
            np.array([item.status for item in nodes], np.int32),
            {"long_name": "worst status", **STATUS_FLAGS},
        ),
    }
    coords = {
        name: (name, values, {"long_name": name, "units": unit_of(name)}),
        "attractor": (
            "attractor",
            np.arange(len(tracks), dtype=np.int32),
            {"long_name": "attractor along the parameter"},
        ),
    }
    attrs = {
        "equation": equation_text(scene),
        "units": UNITS_TEXT,
        "swept": name,
        **static_attributes(scene),
        **scales_attributes(scene),
    }
    attrs |= {key: float(value) for key, value in other_parameters(scene, name).items()}
    attrs |= {
        "starts": n_starts,
        "seed": seed if seed <= MAX_NETCDF_INT else str(seed),
        "confidence": 1.0 - SIGNIFICANCE_LEVEL,
    }
    return xr.Dataset(variables, coords, attrs)


COLUMN_ATTRS = {
    "share": {"long_name": "share of the starts", "units": "1"},
    "share_low": {"long_name": "lower bound of the share at 95 %", "units": "1"},
    "share_high": {"long_name": "upper bound of the share at 95 %", "units": "1"},
    "label": {"long_name": "n drive periods, p impacts on the left wall, q on the right"},
    "kind": {"long_name": "periodic or chaotic"},
    "periods": {"long_name": "drive periods of the orbit, 0 where there is none"},
    "exponent": {"long_name": "largest Lyapunov exponent", "units": "per drive period"},
    "state_x": {"long_name": "position on it at phase 0", "units": LENGTH},
    "state_v": {"long_name": "velocity on it at phase 0", "units": SPEED},
    "mirror_of": {"long_name": "its mirror image among the attractors, -1 for none"},
}
ABSENT_ENTRY: dict[str, Any] = dict.fromkeys(
    ("share", "share_low", "share_high", "exponent", "state_x", "state_v"), np.nan
)
ABSENT_ENTRY |= {"label": "", "kind": "", "periods": 0}
BLANK_VALUES = {"label": "", "kind": "", "periods": 0, "mirror_of": -1, "status": -1}  # at a value that is not done


def _entry_column(rows, key):
    """Return a variable (values, attractors) of the entries: texts of one width, integers that files hold."""
    dtype = {"label": str, "kind": str, "periods": np.int32, "mirror_of": np.int32}.get(key, float)
    return np.array([[entry[key] for entry in row] for row in rows], dtype).reshape(len(rows), -1)


def _attractor_entry(node_attractors, track, node_index):
    """Return the variables of an attractor at a value; track: {value's index: attractor's index}."""
    if node_index not in track:
        return dict(ABSENT_ENTRY)
    attractor, points = (
        node_attractors[node_index][track[node_index]],
        node_attractors[node_index][track[node_index]].points,
    )
    if node_index - 1 in track and attractor.periods:
        previous = node_attractors[node_index - 1][track[node_index - 1]]
        if previous.periods == attractor.periods:
            points = nearest_rotation(points, previous.points)
    return {
        "share": attractor.share,
        "share_low": attractor.share_bounds[0],
        "share_high": attractor.share_bounds[1],
        **{key: getattr(attractor, key) for key in ("label", "kind", "periods", "exponent")},
        "state_x": points[0, 0] if attractor.periods else attractor.state.x,
        "state_v": points[0, 1] if attractor.periods else attractor.state.v,
    }


def _mirror_index(attractors, track, node_index, tracks):
    """Return the index of the track of an attractor's mirror image at a value, -1 for none."""
    image_index = attractors[track[node_index]].mirror_of if node_index in track else None
    return next(
        (
            index
            for index, other_track in enumerate(tracks)
            if image_index is not None and other_track.get(node_index) == image_index
        ),
        -1,
    )
