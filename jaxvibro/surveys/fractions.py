"""The attractors of a scene along a parameter, each under one name, with the shares of random starts on them."""

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

MAX_NETCDF_INT = 2**31 - 1  # whole number that a NetCDF file of the classic format holds


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
    """The attractors along a parameter, each followed as one, with the shares of random starts on them: a Dataset.

    scene: a single one; name: of any of its parameters, dotted for a wall's; values: shape (values,), rising. starts,
    settle: at each value, as in `find_attractors`; the starts of a value are drawn from the seed and the value itself:
    other ones at each, so that their errors are independent along the parameter, and the same ones whatever other
    values are asked for. progress: called with the number of values whose starts have settled.

    An attractor keeps its place along the dimension "attractor" as long as the motion carried on from it, in small
    steps of the parameter, lands on it at the next value, and from there comes back (`matching`). So it does where
    periods double and where a motion grazes without a jump: its label changes. Where a branch ends and falls onto
    another, the other goes on as itself. Of the two that a symmetric motion breaks into, or that join in one, it is
    the one whose label comes first, or else whose mean x at phase 0 is lower; the other has a place of its own. An
    attractor that is carried on to a value where no start found it is there with a share of 0.

    The Dataset, along (name, attractor): share, share_low, share_high: of the starts, with the bounds at 95 % (Clopper
    and Pearson, 1934; of 0 starts or all, one bound alone), nan where the attractor is not there; label (P n p q,
    "chaotic"), "" where it is not; kind, "periodic", "chaotic" or ""; periods, 0 of none; exponent, the largest, per
    drive period; state_x, state_v: on it at phase 0; mirror_of: the place of its mirror image, its own where it is
    symmetric, -1 where it has none. Along name: unresolved, unresolved_low, unresolved_high: the share of starts on
    none, and status, the worst of the starts', as `Impacts` has it. starts, seed: attributes. With `shocks`, so many
    tried for each attractor at each value, least_shock: the least impulse at phase 0 that makes its motion leave it
    (`least_shock`), inf where none does, nan where it is not known, as where an impact falls on that phase.

    max_seconds: wall-clock time, s, after which the starts of no further value are settled, and no further least shock
    is looked for; None is no limit. The first value is always done. The attractors of the values that are done are
    still carried on to each other. Values that are not done have shares of nan, the label "" and the status -1, and the
    attribute `stopped` says why.

    Raises ArgumentError for a batch of scenes, an unknown name, values that do not rise or break a rule of the scene,
    and counts that cannot be, all before any work.
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
    check.require_parameter(name, scene.names, name)
    values = check.finite_array(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(name, "must be values in rising order, at least one", values)
    require_scene_units("values", scene, name, values)
    scene.replace(**{name: values})
    return values


def _settle_node(scene, value, n_starts, seed, settle):
    """The `ParameterNode` of a value, of what its own starts settle on."""
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
    """(the least impulses, (values, attractors), at how many values they have been looked for)."""
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
    """The data of the first values, with blanks at the others."""
    fill_values = {key: BLANK_VALUES.get(key, np.nan) for key in data.data_vars}
    dtypes = {key: data[key].dtype for key in data.data_vars}
    padded_data = data.reindex({name: values}, fill_value=fill_values)
    return padded_data.assign({key: padded_data[key].astype(dtype) for key, dtype in dtypes.items()})


def _least_shock_size(scene, attractors, index, n_shocks):
    """The least impulse at phase 0 of one of the attractors; nan of none, and where it has no trap there."""
    if index is None:
        return np.nan
    try:
        return least_shock(scene, attractors, index, shocks=n_shocks).size
    except check.ArgumentError as error:
        if error.key != "phase":
            raise
        return np.nan


def _make_dataset(scene, name, values, nodes, node_attractors, tracks, n_starts, seed):
    """The named result of the attractors found at each value, and which of them are one."""
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
BLANK_VALUES = {"label": "", "kind": "", "periods": 0, "mirror_of": -1, "status": -1}  # of a value that is not done


def _entry_column(rows, key):
    """A variable (values, attractors) of the entries: texts of one width, whole numbers as files hold them."""
    dtype = {"label": str, "kind": str, "periods": np.int32, "mirror_of": np.int32}.get(key, float)
    return np.array([[entry[key] for entry in row] for row in rows], dtype).reshape(len(rows), -1)


def _attractor_entry(node_attractors, track, node_index):
    """What is told of an attractor at a value; track: {value's place: attractor's place}."""
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
    """The place among the known attractors of one's mirror image at a value, -1 for none."""
    image_index = attractors[track[node_index]].mirror_of if node_index in track else None
    return next(
        (
            index
            for index, other_track in enumerate(tracks)
            if image_index is not None and other_track.get(node_index) == image_index
        ),
        -1,
    )
