"""Which numbers of a scene made a record: `fit`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy import special

from ..output.table_text import columns
from ..scene import check
from ..scene.parameters import tied
from ..scene.scene import SIDES, Scene
from . import chain_fit, point_fit
from .chain_fit import Free
from .free_numbers import room_of, units_of
from .growth import matched
from .matching import RARE, WRONG, Record, at, possible, seen
from .records import ImpactRecord, PointRecord
from .settled import settled

PHASES, HEAD, BEST = 8, 10, 3  # of an unknown phase: starts, impacts that choose among them, how many are gone on with
TURN = 0.5  # rad: the scale of an unknown phase
SAID = 1.0  # scales: a record that says no more than this of a combination does not say it
INVOLVED = 0.05  # of a combination that is held: a number with as large a share has no error of its own
SHOWN = 0.1  # of a combination, a smaller share is left out of its text


class FitStatus(IntEnum):
    """What became of a fit. OK: the numbers are found. UNIDENTIFIABLE: some of their combinations are not in the
    record, and were held. BOUND: a number is at the end of where it may be. MISFIT: the scene does not explain the
    record within its errors. NONE: no motion of the scene goes along it; the numbers are the first ones."""

    OK = 0
    UNIDENTIFIABLE = 1
    BOUND = 2
    MISFIT = 3
    NONE = 4


@dataclass(frozen=True)
class Combination:
    """A combination of the free numbers, each in its scale: its shares, a unit vector, and its error."""

    shares: dict[str, float]
    sigma: float

    def __str__(self) -> str:
        parts = sorted(self.shares.items(), key=lambda one: -abs(one[1]))
        return " ".join(f"{share:+.2f} {name}" for name, share in parts if abs(share) >= SHOWN)


@dataclass(frozen=True, eq=False)
class Fit:
    """What a record says of a scene, made by `fit`. values, sigma: {name: number}, sigma infinite where the number is
    part of a combination that the record does not say; covariance: (name, other), of what it says; residuals: measured
    less fitted, in errors; chi2, dof: their squares' sum, and what noise makes of it on average; identifiable,
    unidentifiable: `Combination`s, best known first; missed: (time, side) of impacts that the record lacks; spurious:
    places in the record of those that are none; scene: with the numbers put in; status: a `FitStatus`."""

    values: dict[str, float]
    sigma: dict[str, float]
    covariance: xr.DataArray
    residuals: Float[np.ndarray, " residuals"]
    chi2: float
    dof: int
    identifiable: tuple[Combination, ...]
    unidentifiable: tuple[Combination, ...]
    missed: tuple[tuple[float, int], ...]
    spurious: tuple[int, ...]
    scene: Scene
    status: FitStatus

    def table(self) -> str:
        """The fit as text."""
        rows = [("number", "value", "sigma"), *((name, self.values[name], self.sigma[name]) for name in self.values)]
        lines = [columns(rows), f"chi2 {self.chi2:.4g} of {self.dof}, {self.status.name}"]
        lines += [f"not in the record: {one}" for one in self.unidentifiable]
        lines += [f"missed: {time:.6g} {SIDES[int(side > 0)]}" for time, side in self.missed]
        return "\n".join([*lines, *(f"spurious: impact {k}" for k in self.spurious)])


@check.host("use the chain's equations")
def fit(
    scene: Scene,
    data: ImpactRecord | PointRecord,
    free: Mapping[str | tuple[str, ...], float],
    bounds: Mapping[str | tuple[str, ...], Sequence[float]] | None = None,
) -> Fit:
    """The numbers of a scene that made a record, with their errors: a `Fit`.

    scene: where it begins, some scales off at most; data: an `ImpactRecord`, between rigid walls, or a `PointRecord`;
    free: {name: scale}, of the numbers that are not known, and by how much each may be off; bounds: {name: (low, high)}
    of free numbers, by default their domains. Of a `PointRecord` a tuple of names is one number, of several that have
    one value. The first state of impacts is never known.

    Points are functions of the scene (`located`), fitted by Gauss and Newton. Impacts are explained by a chain of
    flights, each as exact as in `strobe`; where it is chaotic nothing is lost (multiple shooting; Bock 1981). Errors
    are those of least squares, of the linear theory.

    Raises ArgumentError for soft walls, names that the scene lacks, scales that are none, bounds that do not hold the
    scene, walls that the scene lacks, and where more is unknown than the record holds: a settled record holds its
    impacts' phases alone, and its period where the frequency is free.
    """
    if not isinstance(scene, Scene):
        raise check.ArgumentError("scene", "must be a Scene", scene)
    check.require_single(scene)
    if isinstance(data, PointRecord):
        return _points_told(scene, data, free, bounds or {})
    if not isinstance(data, ImpactRecord):
        raise check.ArgumentError("data", "must be an ImpactRecord or a PointRecord", data)
    check.require_rigid(scene, "a fit of impacts")
    units = units_of(scene, free)
    room = room_of(scene, units, bounds or {})
    for side in np.unique(data.sides):
        if SIDES[int(side > 0)] not in scene.walls:
            raise check.ArgumentError("data.sides", f"the scene has no {SIDES[int(side > 0)]} wall", int(side))
    _enough(np.size(data.times), len(units) + 2 + (data.phase is None))
    record = _record(scene, data, units, *room)
    holds = settled(data, float(scene.frequency), "frequency" in units)
    chain = _chained(record, data)
    if holds is not None and holds < len(record.free.names):
        _refuse(record, chain, holds)
    return _told(record, chain)


def _enough(holds, unknown):
    if holds < unknown:
        rule = f"must hold as many numbers as are unknown, {unknown} with the first state"
        raise check.ArgumentError("data", rule, f"{holds} times")


def _record(scene, data, units, low, high):
    names, scales = tuple(units), np.array(list(units.values()))
    begun = np.array([float(scene.parameter(name)) for name in names])
    if data.phase is None:
        names, scales, begun = (*names, "phase"), np.append(scales, TURN), np.append(begun, 0.0)
        low, high = np.append(low, -np.inf), np.append(high, np.inf)
    free = Free(names, scales, begun, low, high, np.eye(len(names)))
    sigma = np.full(len(data.times), data.sigma)
    return Record(scene, data.phase or 0.0, data.times, data.sides.astype(float), sigma, free)


def _chained(record, data):
    """The `Chain` of a record: of an unknown phase the best of several."""
    if data.phase is not None:
        return matched(record, data.flawed)
    found = []
    for angle in 2.0 * np.pi * np.arange(PHASES) / PHASES:
        begun = np.append(record.free.begun[:-1], angle)
        one = record._replace(free=record.free._replace(begun=begun))
        head = one._replace(times=one.times[:HEAD], sides=one.sides[:HEAD], sigma=one.sigma[:HEAD])
        chain = matched(head, False)
        if chain is not None:
            found.append((chain.cost, angle, one))
    found.sort(key=lambda each: each[:2])
    chains = [matched(one, data.flawed) for _, _, one in found[:BEST]]
    return min((one for one in chains if one is not None), key=lambda one: one.cost, default=None)


def _combinations(free, covariance):
    """(the errors in scales, directions) of what a record says beside what was known before, best known first."""
    found = np.linalg.inv(covariance) - free.known
    information, ways = np.linalg.eigh(0.5 * (found + found.T))
    errors = np.maximum(information, 1e-30) ** -0.5
    return errors[::-1], ways[:, ::-1]


def _named(names, errors, ways):
    return tuple(
        Combination(dict(zip(names, map(float, way), strict=True)), float(error))
        for error, way in zip(errors, ways.T, strict=True)
    )


def _refuse(record, chain, holds):
    """Of a settled record: what it holds."""
    known = ""
    if chain is not None and chain.cost < WRONG:
        errors, ways = _combinations(record.free, chain.solved.covariance)
        known = ": " + "; ".join(map(str, _named(record.free.names, errors[:holds], ways[:, :holds])))
    rule = f"is settled, holds {holds} numbers and must hold as many as are free, {len(record.free.names)}{known}"
    raise check.ArgumentError("data", rule, f"{len(record.times)} times")


def _told(record, chain):
    free = record.free
    if chain is None or chain.cost >= WRONG:
        return _none(record.scene, free.names, free.begun)
    errors, ways = _combinations(free, chain.solved.covariance)
    lost = errors > SAID
    held = ways[:, lost] @ ways[:, lost].T
    now = chain.solved
    given, final = seen(record, chain), free._replace(known=held)
    solved = chain_fit.solved(record.scene, record.phase, now.nodes, given, final, now.numbers)
    left = np.eye(len(free.names)) - held
    covariance = left @ solved.covariance @ left * np.outer(free.scales, free.scales)
    errors, ways = _combinations(final, solved.covariance) if not lost.any() else (errors, ways)
    dof = len(given.node) - 2 - int(np.sum(~lost))
    status = _status(record, solved, lost, dof)
    open_ones = np.sum(ways[:, lost] ** 2, 1) > INVOLVED**2
    sigma = np.where(open_ones, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    named = _named(free.names, errors, ways)
    return Fit(
        dict(zip(free.names, map(float, solved.numbers), strict=True)),
        dict(zip(free.names, map(float, sigma), strict=True)),
        _labelled(free.names, covariance),
        -solved.residuals,
        solved.chi2,
        dof,
        tuple(one for one, gone in zip(named, lost, strict=True) if not gone),
        tuple(one for one, gone in zip(named, lost, strict=True) if gone),
        tuple((float(solved.nodes.first[k]), int(solved.nodes.sides[k])) for k in np.flatnonzero(chain.seen < 0)),
        tuple(sorted(chain.left_out)),
        at(record, solved.numbers)[0],
        status,
    )


def _points_told(scene, data, free, bounds):
    """The `Fit` of a `PointRecord`."""
    groups = [(key,) if isinstance(key, str) else tuple(key) for key in free]
    if len(data.values) < len(groups):
        rule = f"must hold as many numbers as are unknown, {len(groups)}"
        raise check.ArgumentError("data", rule, f"{len(data.values)} points")
    scales, low, high = _grouped(scene, free, groups, bounds)
    labels, begun = [" = ".join(group) for group in groups], np.array([tied(scene, group) for group in groups])
    met = point_fit.met(point_fit.points_of(data, tuple(groups), scales, low, high), begun)
    if met is None or not met.met:
        return _none(scene, labels, begun)
    information, ways = np.linalg.eigh(met.by.T @ met.by)
    errors, ways = np.maximum(information, 1e-30)[::-1] ** -0.5, ways[:, ::-1]
    lost = errors > SAID
    covariance = (ways[:, ~lost] * errors[~lost] ** 2) @ ways[:, ~lost].T * np.outer(scales, scales)
    sigma = np.where(np.sum(ways[:, lost] ** 2, 1) > INVOLVED**2, np.inf, np.sqrt(np.diag(covariance)))
    chi2, dof = float(met.residuals @ met.residuals), len(met.residuals) - int(np.sum(~lost))
    status = FitStatus.UNIDENTIFIABLE if lost.any() else FitStatus.OK
    if chi2 > special.chdtri(max(1, dof), RARE):
        status = FitStatus.MISFIT
    named = _named(labels, errors, ways)
    values = {name: float(number) for group, number in zip(groups, met.numbers, strict=True) for name in group}
    return Fit(
        dict(zip(labels, map(float, met.numbers), strict=True)),
        dict(zip(labels, map(float, sigma), strict=True)),
        _labelled(labels, covariance),
        -met.residuals,
        chi2,
        dof,
        tuple(one for one, gone in zip(named, lost, strict=True) if not gone),
        tuple(one for one, gone in zip(named, lost, strict=True) if gone),
        (),
        (),
        scene.replace(**values),
        status,
    )


def _grouped(scene, free, groups, bounds):
    """(scales, low, high) of free numbers, each of one or several names. Raises ArgumentError."""
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit}, one number at least", free)
    for key in bounds:
        if key not in free:
            raise check.ArgumentError(f"bounds.{key}", "must be of a free number", key)
    rows = []
    for key, group in zip(free, groups, strict=True):
        value, ends = tied(scene, group), []
        for name in group:
            unit = units_of(scene, {name: free[key]})
            ends.append(
                [
                    value + unit[name] * end[0]
                    for end in room_of(scene, unit, {name: bounds[key]} if key in bounds else {})
                ]
            )
        rows.append((unit[name], max(low for low, _ in ends), min(high for _, high in ends)))
    return np.array(rows).T


def _status(record, solved, lost, dof):
    if not possible(record, solved):
        return FitStatus.MISFIT
    if np.min(np.abs(record.free.room(solved.numbers))) <= chain_fit.SHORT:
        return FitStatus.BOUND
    if solved.chi2 > special.chdtri(max(1, dof), RARE):
        return FitStatus.MISFIT
    return FitStatus.UNIDENTIFIABLE if lost.any() else FitStatus.OK


def _none(scene, names, begun):
    """The `Fit` that says nothing."""
    values, nothing = dict(zip(names, map(float, begun), strict=True)), dict.fromkeys(names, np.inf)
    nan, blank = np.full((len(names),) * 2, np.nan), np.zeros(0)
    return Fit(values, nothing, _labelled(names, nan), blank, np.inf, 0, (), (), (), (), scene, FitStatus.NONE)


def _labelled(names, covariance):
    return xr.DataArray(covariance, dims=("name", "other"), coords={"name": list(names), "other": list(names)})
