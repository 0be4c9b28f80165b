"""The attractors of a scene along a parameter, each under one name, with the shares of random starts on them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import UNLIMITED, limits_of, partial_reason

from ..attractors.find import paired, settled_on
from ..attractors.shares import LEVEL, share_bounds
from ..attractors.sweep import MEANING, UNITS, equation, others, static
from ..maps.initial_conditions import random_starts
from ..output.units import LENGTH, SPEED, scales_in, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.unit_slips import require_scene_units
from .least_shock import least_shock
from .matching import identities, nearest_turn
from .stations import Station, carry_on

LARGEST = 2**31 - 1  # whole number that a NetCDF file of the classic format holds


@check.host("use strobe")
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
    values = _checked(scene, name, values)
    starts, settle = check.whole("starts", starts, 1), check.whole("settle", settle, 0)
    seed, shocks = check.whole("seed", seed, 0), check.whole("shocks", shocks, 0)
    stations: list[Station] = []
    for value in values:
        if stations and limits.expired:
            break
        stations.append(_settled(scene.replace(**{name: value}), float(value), starts, seed, settle))
        if progress is not None:
            progress(len(stations))
    carry_on(stations, name, settle)
    known = identities(stations, name, settle) or [{}]
    found = [paired(one.scene, one.seen, starts) for one in stations]
    data, count = _dataset(scene, name, values[: len(stations)], stations, found, known, starts, seed), len(stations)
    if shocks:
        least, count = _shocks(stations, found, known, shocks, limits)
        told = {"long_name": "least impulse at phase 0 that makes the motion leave", "units": SPEED}
        data = data.assign(least_shock=((name, "attractor"), least, told)).assign_attrs(shocks=shocks)
    if len(stations) < len(values):
        data = _with_blanks(data, name, values)
    if count < len(values):
        data = data.assign_attrs(stopped=partial_reason(count, len(values), "values"))
    return data


def _checked(scene, name, values) -> Float[np.ndarray, " values"]:
    check.require_known(name, scene.names, name)
    values = check.number(name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0 or not (np.diff(values) > 0).all():
        raise check.ArgumentError(name, "must be values in rising order, at least one", values)
    require_scene_units("values", scene, name, values)
    scene.replace(**{name: values})
    return values


def _settled(scene, value, starts, seed, settle):
    """The `Station` of a value, of what its own starts settle on."""
    drawn = random_starts(scene, starts, (seed, int(np.float64(value).view(np.uint64))))
    found = settled_on(scene, drawn, settle)
    return Station(value, scene, found.seen, len(found.lost), found.scale, int(found.status.max()))


def _shocks(stations, found, known, shocks, limits=UNLIMITED):
    """(the least impulses, (values, attractors), at how many values they have been looked for)."""
    least = np.full((len(stations), len(known)), np.nan)
    for k, station in enumerate(stations):
        if limits.expired:
            return least, k
        least[k] = [_least(station.scene, found[k], one.get(k), shocks) for one in known]
    return least, len(stations)


def _with_blanks(data, name, values):
    """The data of the first values, with blanks at the others."""
    fill = {key: BLANK.get(key, np.nan) for key in data.data_vars}
    kept = {key: data[key].dtype for key in data.data_vars}
    whole = data.reindex({name: values}, fill_value=fill)
    return whole.assign({key: whole[key].astype(dtype) for key, dtype in kept.items()})


def _least(scene, attractors, place, shocks):
    """The least impulse at phase 0 of one of the attractors; nan of none, and where it has no trap there."""
    if place is None:
        return np.nan
    try:
        return least_shock(scene, attractors, place, shocks=shocks).size
    except check.ArgumentError as error:
        if error.key != "phase":
            raise
        return np.nan


def _dataset(scene, name, values, stations, found, known, starts, seed):
    """The named result of the attractors found at each value, and which of them are one."""
    rows = [[_entry(found, one, k) for one in known] for k in range(len(found))]
    for k, row in enumerate(rows):
        for one, entry in zip(known, row, strict=True):
            entry["mirror_of"] = _mirror(found[k], one, k, known)
    lost = np.array([one.lost for one in stations])
    low, high = np.array([share_bounds(int(count), starts) for count in lost]).T
    along = {"long_name": "share of the starts on no attractor", "units": "1"}
    variables = {
        **{key: ((name, "attractor"), _column(rows, key), about) for key, about in ABOUT.items()},
        "unresolved": (name, lost / starts, along),
        "unresolved_low": (name, low, {"long_name": "lower bound of it at 95 %", "units": "1"}),
        "unresolved_high": (name, high, {"long_name": "upper bound of it at 95 %", "units": "1"}),
        "status": (
            name,
            np.array([one.status for one in stations], np.int32),
            {"long_name": "worst status", **MEANING},
        ),
    }
    coords = {
        name: (name, values, {"long_name": name, "units": unit_of(name)}),
        "attractor": (
            "attractor",
            np.arange(len(known), dtype=np.int32),
            {"long_name": "attractor along the parameter"},
        ),
    }
    attrs = {"equation": equation(scene), "units": UNITS, "swept": name, **static(scene), **scales_in(scene)}
    attrs |= {key: float(value) for key, value in others(scene, name).items()}
    attrs |= {"starts": starts, "seed": seed if seed <= LARGEST else str(seed), "confidence": 1.0 - LEVEL}
    return xr.Dataset(variables, coords, attrs)


ABOUT = {
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
ABSENT: dict[str, Any] = dict.fromkeys(("share", "share_low", "share_high", "exponent", "state_x", "state_v"), np.nan)
ABSENT |= {"label": "", "kind": "", "periods": 0}
BLANK = {"label": "", "kind": "", "periods": 0, "mirror_of": -1, "status": -1}  # of a value that is not done


def _column(rows, key):
    """A variable (values, attractors) of the entries: texts of one width, whole numbers as files hold them."""
    dtype = {"label": str, "kind": str, "periods": np.int32, "mirror_of": np.int32}.get(key, float)
    return np.array([[entry[key] for entry in row] for row in rows], dtype).reshape(len(rows), -1)


def _entry(found, one, k):
    """What is told of an attractor at a value; one: {value's place: attractor's place}."""
    if k not in one:
        return dict(ABSENT)
    here, points = found[k][one[k]], found[k][one[k]].points
    if k - 1 in one and here.periods:
        before = found[k - 1][one[k - 1]]
        if before.periods == here.periods:
            points = nearest_turn(points, before.points)
    return {
        "share": here.share,
        "share_low": here.share_bounds[0],
        "share_high": here.share_bounds[1],
        **{key: getattr(here, key) for key in ("label", "kind", "periods", "exponent")},
        "state_x": points[0, 0] if here.periods else here.state.x,
        "state_v": points[0, 1] if here.periods else here.state.v,
    }


def _mirror(attractors, one, k, known):
    """The place among the known attractors of one's mirror image at a value, -1 for none."""
    image = attractors[one[k]].mirror_of if k in one else None
    return next((place for place, other in enumerate(known) if image is not None and other.get(k) == image), -1)
