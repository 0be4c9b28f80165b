"""Which numbers of a scene made a record: `fit`."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene import check
from ..scene.parameters import tied
from ..scene.questions import ask_of_record
from ..scene.scene import SIDES, Scene
from . import chain_fit, fitted, motion_fit, point_fit
from .fitted import Fit, FitStatus
from .free_numbers import room_of, units_of
from .growth import matched
from .least_squares import Free
from .matching import WRONG, Record, at, possible, seen
from .records import ImpactRecord, PointRecord, SampleRecord
from .settled import impacts_hold, samples_hold

PHASES, HEAD, BEST = 8, 10, 3  # of an unknown phase: starts, impacts that choose among them, how many are gone on with
TURN = 0.5  # rad: the scale of an unknown phase


@check.host("use the chain's equations")
def fit(
    scene: Scene,
    data: ImpactRecord | SampleRecord | PointRecord,
    free: Mapping[str | tuple[str, ...], float],
    bounds: Mapping[str | tuple[str, ...], Sequence[float]] | None = None,
) -> Fit:
    """The numbers of a scene that made a record, with their errors: a `Fit`.

    scene: where it begins, some scales off at most; data: an `ImpactRecord`, a `SampleRecord` or a `PointRecord`; free:
    {name: scale}, of the numbers that are not known, and by how much each may be off; bounds: {name: (low, high)} of
    free numbers, by default their domains. Of a `PointRecord` a tuple of names is one number, of several that have one
    value. The first state of a motion is never known. An impact on a soft wall is when the mass comes to it.

    Points are functions of the scene (`located`), fitted by Gauss and Newton. Impacts are explained by a chain of
    flights, each as exact as in `strobe`, samples by short shots as exact as in `sample`; where the motion is chaotic
    nothing is lost (multiple shooting; Bock 1981). Errors are those of least squares, of the linear theory.

    Raises ArgumentError for a scene in single precision, names that the scene lacks, scales that are none, bounds that
    do not hold the scene, walls that the scene lacks, and where more is unknown than the record holds: a settled record
    holds its impacts' phases alone, or its samples of one round, and its period where the frequency is free.
    """
    if not isinstance(scene, Scene):
        raise check.ArgumentError("scene", "must be a Scene", scene)
    check.require_single(scene)
    check.require_spring(scene, "fit")
    if scene.dtype != np.float64:
        raise check.ArgumentError("scene", "must be in double precision", np.dtype(scene.dtype).name)
    if isinstance(data, PointRecord):
        return _of_points(scene, data, free, bounds or {})
    if not isinstance(data, ImpactRecord | SampleRecord):
        raise check.ArgumentError("data", "must be an ImpactRecord, a SampleRecord or a PointRecord", data)
    units = units_of(scene, free)
    room = room_of(scene, units, bounds or {})
    ask_of_record(scene, data)
    return (_of_impacts if isinstance(data, ImpactRecord) else _of_samples)(scene, data, units, room)


def _of_impacts(scene, data, units, room):
    for side in np.unique(data.sides):
        if SIDES[int(side > 0)] not in scene.walls:
            raise check.ArgumentError("data.sides", f"the scene has no {SIDES[int(side > 0)]} wall", int(side))
    _enough(len(data.times), "times", units, data.phase)
    free, sigma = _free(scene, data.phase, units, room), np.full(len(data.times), data.sigma)
    record = Record(scene, data.phase or 0.0, data.times, data.sides.astype(float), sigma, free)

    chain = _chained(record, data)
    about = None if chain is None or chain.cost >= WRONG else chain.solved
    _held(data, free, about, impacts_hold(data, float(scene.frequency), "frequency" in units))
    if about is None:
        return fitted.nothing(scene, free.names, free.begun)
    free, given = free.from_phase(about.numbers), seen(record, chain)

    def solved(free):
        return chain_fit.solved(scene, record.phase, about.nodes, given, free, about.numbers)

    found, said = fitted.identified(about, free, solved)
    dof = len(given.node) - 2 - int(np.sum(~said.lost))
    status = fitted.status(free, found, said, dof) if possible(record, found) else FitStatus.MISFIT
    missed = tuple((float(found.nodes.first[k]), int(found.nodes.sides[k])) for k in np.flatnonzero(chain.seen < 0))
    return _told(at(record, found.numbers)[0], free, found, said, dof, status, missed, tuple(sorted(chain.left_out)))


def _of_samples(scene, data, units, room):
    given = data.measured[0].size
    _enough(given, "numbers", units, data.phase)
    free = _free(scene, data.phase, units, room)
    samples = motion_fit.samples_of(scene, data, free)
    about = motion_fit.followed(samples)
    _held(data, free, about, None if "frequency" in units else samples_hold(data, float(scene.frequency)))
    if about is None:
        return fitted.nothing(scene, free.names, free.begun)
    free = free.from_phase(about.numbers)

    def solved(free):
        return motion_fit.solved(samples, about, free)

    found, said = fitted.identified(about, free, solved)
    dof = given - 2 - int(np.sum(~said.lost))
    status = fitted.status(free, found, said, dof) if found.met else FitStatus.MISFIT
    return _told(samples.at(found.numbers)[0], free, found, said, dof, status)


def _enough(given, what, units, phase):
    unknown = len(units) + 2 + (phase is None)
    if given < unknown:
        rule = f"must hold as many numbers as are unknown, {unknown} with the first state"
        raise check.ArgumentError("data", rule, f"{given} {what}")


def _free(scene, phase, units, room):
    """The `Free` numbers, the drive's phase at time 0 among them where it is not known."""
    names, scales, (low, high) = tuple(units), np.array(list(units.values())), room
    begun = np.array([float(scene.parameter(name)) for name in names])
    if phase is None:
        names, scales, begun = (*names, "phase"), np.append(scales, TURN), np.append(begun, 0.0)
        low, high = np.append(low, -np.inf), np.append(high, np.inf)
    return Free(names, scales, begun, low, high, np.eye(len(names)))


def _chained(record, data):
    """The `Chain` of a record of impacts: of an unknown phase the best of several."""
    if data.phase is not None:
        return matched(record, data.flawed)
    found = []
    for angle in 2.0 * np.pi * np.arange(PHASES) / PHASES:
        one = record._replace(free=record.free.from_phase(np.array([angle])))
        head = one._replace(times=one.times[:HEAD], sides=one.sides[:HEAD], sigma=one.sigma[:HEAD])
        chain = matched(head, False)
        if chain is not None:
            found.append((chain.cost, angle, one))
    found.sort(key=lambda each: each[:2])
    chains = [matched(one, data.flawed) for _, _, one in found[:BEST]]
    return min((one for one in chains if one is not None), key=lambda one: one.cost, default=None)


def _held(data, free, about, holds):
    """Refuse a settled record that holds fewer numbers than are free."""
    if holds is None or holds >= len(free.names):
        return
    known = ""
    if about is not None:
        said = fitted.said(np.linalg.inv(about.covariance) - free.known)
        known = ": " + "; ".join(map(str, said.named(free.names, slice(holds))))
    rule = f"is settled, holds {holds} numbers and must hold as many as are free, {len(free.names)}{known}"
    raise check.ArgumentError("data", rule, f"{len(data.times)} times")


def _told(scene, free, found, said, *more):
    return fitted.told(scene, free.names, free.scales, found.numbers, said, found.covariance, found.residuals, *more)


def _of_points(scene, data, free, bounds):
    groups = [(key,) if isinstance(key, str) else tuple(key) for key in free]
    if len(data.values) < len(groups):
        rule = f"must hold as many numbers as are unknown, {len(groups)}"
        raise check.ArgumentError("data", rule, f"{len(data.values)} points")
    scales, low, high = _grouped(scene, free, groups, bounds)
    labels, begun = [" = ".join(group) for group in groups], np.array([tied(scene, group) for group in groups])
    met = point_fit.met(point_fit.points_of(data, tuple(groups), scales, low, high), begun)
    if met is None or not met.met:
        return fitted.nothing(scene, labels, begun)
    said, dof = fitted.said(met.by.T @ met.by), len(met.residuals)
    dof -= int(np.sum(~said.lost))
    covariance = (said.ways[:, ~said.lost] * said.errors[~said.lost] ** 2) @ said.ways[:, ~said.lost].T
    status = fitted.misfit(float(met.residuals @ met.residuals), dof)
    status = status or (FitStatus.UNIDENTIFIABLE if said.lost.any() else FitStatus.OK)
    values = {name: float(number) for group, number in zip(groups, met.numbers, strict=True) for name in group}
    there = scene.replace(**values)
    return fitted.told(there, labels, scales, met.numbers, said, covariance, met.residuals, dof, status)


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
