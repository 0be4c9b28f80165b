"""Compute basin fractions along a parameter and match the attractors between its values."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import UNLIMITED, make_limits, partial_result_reason

from ..attractors.basin_fraction_bounds import SIGNIFICANCE_LEVEL, compute_share_bounds
from ..attractors.dataset_attributes import STATUS_FLAGS, other_parameters, survey_attributes
from ..attractors.find import make_attractors, settle_starts
from ..attractors.survey_arguments import check_survey_values, is_increasing
from ..maps.initial_conditions import draw_initial_states
from ..output.units import LENGTH, SPEED, unit_of
from ..scene import check
from ..scene.scene import Scene
from .attractor_matching import match_attractors, nearest_rotation
from .attractor_transport import ParameterNode, transport_attractors
from .least_shock import least_shock

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
        Wall-clock time, in s, after which no further value is started, neither in the search for attractors nor in the
        search for shocks. The attractors of the first value are always computed. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables with dimensions (name, attractor): ``share``, ``share_low`` and ``share_high``, the basin fraction and
        its bounds at 95 % confidence, nan where the attractor does not exist; ``label`` as in `Attractor`, ``""`` where
        the attractor does not exist; ``kind``, ``"periodic"``, ``"chaotic"`` or ``""``; ``periods``, 0 if it is not
        periodic; ``exponent``, the largest Lyapunov exponent per drive period; ``state_x`` and ``state_v``, a state on
        the attractor at phase 0; ``mirror_of``, the index of the mirror image, equal to that of the attractor if it is
        symmetric, -1 for none. With `shocks`, ``least_shock``: the smallest impulse at phase 0 that leads to another
        attractor (see `least_shock`), inf if none does, nan if unknown, for example if an impact falls on phase 0.
        Variables along `name`: ``unresolved``, ``unresolved_low`` and ``unresolved_high``, the fraction of initial
        states on no attractor; ``status``, the worst of the initial states, as in `Impacts`. Attributes: ``starts`` and
        ``seed``.

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
    The initial states differ between values. The errors are therefore independent along the parameter, and the result
    at a value does not depend on the other values.

    An attractor keeps its index if the motion on it, carried in small steps of the parameter, approaches an attractor
    at the next value, and the motion carried back approaches the first attractor. This includes period doublings, and
    grazings without a jump, at which the label changes. If a branch ends and its motion approaches another attractor,
    the other attractor keeps its own index. At a symmetry breaking, the asymmetric attractor whose label comes first,
    or for equal labels whose mean x at phase 0 is lower, keeps the index. Its mirror image has another index. An
    attractor has the share 0 at a value at which no initial state approaches it.

    After `max_seconds`, the attractors of the values that are done are still matched. The other values have shares of
    nan, the label ``""`` and the status -1, and the attribute ``stopped`` gives the reason.

    References
    ----------
    Clopper and Pearson (1934): exact bounds. Only one bound is nontrivial if none or all of the initial states approach
    the attractor.

    Examples
    --------
    >>> data = jv.fractions(scene, "amplitude", [1.9, 2.0], starts=20)
    >>> data["label"].values.tolist()
    [['P111', 'P100'], ['P111', 'P100']]
    >>> data["share"].values.round(2).tolist()
    [[0.9, 0.1], [0.95, 0.05]]
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    values = _check_values(scene, name, values)
    starts, settle = check.check_whole_number("starts", starts, 1), check.check_whole_number("settle", settle, 0)
    seed, shocks = check.check_whole_number("seed", seed, 0), check.check_whole_number("shocks", shocks, 0)
    nodes: list[ParameterNode] = []
    for value in values:
        if nodes and computation_limits.expired:
            break
        nodes.append(_make_parameter_node(scene.replace(**{name: value}), float(value), starts, seed, settle))
        if progress is not None:
            progress(len(nodes))
    transport_attractors(nodes, name, settle)
    tracks = match_attractors(nodes, name, settle) or [{}]
    node_attractors = [make_attractors(node.scene, node.candidates, starts) for node in nodes]
    result_dataset, n_done_values = (
        _make_dataset(scene, name, values[: len(nodes)], nodes, node_attractors, tracks, starts, seed),
        len(nodes),
    )
    if shocks:
        shock_sizes, n_done_values = _compute_least_shocks(nodes, node_attractors, tracks, shocks, computation_limits)
        shock_attrs = {"long_name": "least impulse at phase 0 that makes the motion leave", "units": SPEED}
        result_dataset = result_dataset.assign(
            least_shock=((name, "attractor"), shock_sizes, shock_attrs)
        ).assign_attrs(shocks=shocks)
    if len(nodes) < len(values):
        result_dataset = _pad_missing_values(result_dataset, name, values)
    if n_done_values < len(values):
        result_dataset = result_dataset.assign_attrs(
            stopped=partial_result_reason(n_done_values, len(values), "values")
        )
    return result_dataset


def _check_values(scene, name, values) -> Float[np.ndarray, " values"]:
    """Check the values of the parameter and return them as an array."""
    values = check_survey_values(
        scene, name, values, "values", "must be one or more values in increasing order", is_increasing
    )
    scene.replace(**{name: values})
    return values


def _make_parameter_node(scene, value, n_starts, seed, settle):
    """Return the `ParameterNode` of a value with the attractors of its own initial states."""
    start_states = draw_initial_states(scene, n_starts, (seed, int(np.float64(value).view(np.uint64))))
    settled_starts = settle_starts(scene, start_states, settle)
    return ParameterNode(
        value,
        scene,
        settled_starts.candidates,
        len(settled_starts.failure_reasons),
        settled_starts.scale,
        int(settled_starts.status.max()),
    )


def _compute_least_shocks(nodes, node_attractors, tracks, n_shocks, computation_limits=UNLIMITED):
    """Return (minimal fatal shocks of shape (values, attractors), number of values searched)."""
    shock_sizes = np.full((len(nodes), len(tracks)), np.nan)
    for node_index, node in enumerate(nodes):
        if computation_limits.expired:
            return shock_sizes, node_index
        shock_sizes[node_index] = [
            _compute_shock_size(node.scene, node_attractors[node_index], attractor_by_node.get(node_index), n_shocks)
            for attractor_by_node in tracks
        ]
    return shock_sizes, len(nodes)


def _pad_missing_values(result_dataset, name, values):
    """Extend the Dataset to all values, with `BLANK_VALUES` or nan at values that are not done."""
    fill_value_by_variable = {
        variable_name: BLANK_VALUES.get(variable_name, np.nan) for variable_name in result_dataset.data_vars
    }
    variable_dtypes = {variable_name: result_dataset[variable_name].dtype for variable_name in result_dataset.data_vars}
    padded_dataset = result_dataset.reindex({name: values}, fill_value=fill_value_by_variable)
    return padded_dataset.assign(
        {variable_name: padded_dataset[variable_name].astype(dtype) for variable_name, dtype in variable_dtypes.items()}
    )


def _compute_shock_size(scene, attractors, attractor_index, n_shocks):
    """Return the size of the minimal fatal shock at phase 0; nan without the attractor or its trapping region."""
    if attractor_index is None:
        return np.nan
    try:
        return least_shock(scene, attractors, attractor_index, shocks=n_shocks).size
    except check.ArgumentError as error:
        if error.key != "phase":
            raise
        return np.nan


def _make_dataset(scene, name, values, nodes, node_attractors, tracks, n_starts, seed):
    """Return the Dataset of the attractors at each value and their tracks along the parameter."""
    entries_by_value = [
        [_make_attractor_entry(node_attractors, track, node_index, tracks) for track in tracks]
        for node_index in range(len(node_attractors))
    ]
    unresolved_counts = np.array([node.n_unresolved_starts for node in nodes])
    unresolved_lower_bounds, unresolved_upper_bounds = np.array(
        [compute_share_bounds(int(n_unresolved_starts), n_starts) for n_unresolved_starts in unresolved_counts]
    ).T
    unresolved_attrs = {"long_name": "share of the starts on no attractor", "units": "1"}
    variables = {
        **{
            variable_name: ((name, "attractor"), _make_entry_array(entries_by_value, variable_name, dtype), attributes)
            for variable_name, (dtype, _, attributes) in ENTRY_VARIABLES.items()
        },
        "unresolved": (name, unresolved_counts / n_starts, unresolved_attrs),
        "unresolved_low": (name, unresolved_lower_bounds, {"long_name": "lower bound of it at 95 %", "units": "1"}),
        "unresolved_high": (name, unresolved_upper_bounds, {"long_name": "upper bound of it at 95 %", "units": "1"}),
        "status": (
            name,
            np.array([node.status for node in nodes], np.int32),
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
        **survey_attributes(scene, swept=name),
        **{parameter_name: float(value) for parameter_name, value in other_parameters(scene, name).items()},
        "starts": n_starts,
        "seed": seed if seed <= MAX_NETCDF_INT else str(seed),
        "confidence": 1.0 - SIGNIFICANCE_LEVEL,
    }
    return xr.Dataset(variables, coords, attrs)


# Variables of an attractor at a value: type, value if the attractor or the value is missing, and attributes.
ENTRY_VARIABLES: dict[str, tuple[type, Any, dict[str, str]]] = {
    "share": (float, np.nan, {"long_name": "share of the starts", "units": "1"}),
    "share_low": (float, np.nan, {"long_name": "lower bound of the share at 95 %", "units": "1"}),
    "share_high": (float, np.nan, {"long_name": "upper bound of the share at 95 %", "units": "1"}),
    "label": (str, "", {"long_name": "n drive periods, p impacts on the left wall, q on the right"}),
    "kind": (str, "", {"long_name": "periodic or chaotic"}),
    "periods": (np.int32, 0, {"long_name": "drive periods of the orbit, 0 where there is none"}),
    "exponent": (float, np.nan, {"long_name": "largest Lyapunov exponent", "units": "per drive period"}),
    "state_x": (float, np.nan, {"long_name": "position on it at phase 0", "units": LENGTH}),
    "state_v": (float, np.nan, {"long_name": "velocity on it at phase 0", "units": SPEED}),
    "mirror_of": (np.int32, -1, {"long_name": "its mirror image among the attractors, -1 for none"}),
}
BLANK_VALUES = {name: blank for name, (_, blank, _) in ENTRY_VARIABLES.items()} | {"status": -1}


def _make_entry_array(entries_by_value, variable_name, dtype):
    """Return a variable of the entries as an array (values, attractors) of a type that NetCDF files can store."""
    return np.array(
        [
            [attractor_variables[variable_name] for attractor_variables in value_entries]
            for value_entries in entries_by_value
        ],
        dtype,
    ).reshape(len(entries_by_value), -1)


def _make_attractor_entry(node_attractors, attractor_by_node, node_index, tracks):
    """Return the variables of an attractor at one value; attractor_by_node: {node index: attractor index}."""
    if node_index not in attractor_by_node:
        return BLANK_VALUES
    attractor = node_attractors[node_index][attractor_by_node[node_index]]
    section_points = attractor.points
    if node_index - 1 in attractor_by_node and attractor.periods:
        previous_attractor = node_attractors[node_index - 1][attractor_by_node[node_index - 1]]
        if previous_attractor.periods == attractor.periods:
            section_points = nearest_rotation(section_points, previous_attractor.points)
    return {
        "share": attractor.share,
        "share_low": attractor.share_bounds[0],
        "share_high": attractor.share_bounds[1],
        **{key: getattr(attractor, key) for key in ("label", "kind", "periods", "exponent")},
        "state_x": section_points[0, 0] if attractor.periods else attractor.state.x,
        "state_v": section_points[0, 1] if attractor.periods else attractor.state.v,
        "mirror_of": _mirror_track_index(attractor, node_index, tracks),
    }


def _mirror_track_index(attractor, node_index, tracks):
    """Return the index of the track of an attractor's mirror image at a value, -1 for none."""
    return next(
        (
            track_index
            for track_index, other_track in enumerate(tracks)
            if attractor.mirror_of is not None and other_track.get(node_index) == attractor.mirror_of
        ),
        -1,
    )
