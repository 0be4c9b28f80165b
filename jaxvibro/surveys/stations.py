"""Attractors carried from one value of a parameter to the next: their motion goes on while the parameter changes."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors import free_and_mirrored
from ..attractors.classify import Evidence, chaotic, periodic, read_set, roam
from ..attractors.transients import is_turned, orbit_of, settle_lanes
from ..compiled.kernels import WIDTH
from ..flight.wall_positions import fit
from ..maps.initial_conditions import box
from ..maps.iterate import iterate
from ..orbits.orbit_comparison import is_same_orbit, is_same_set
from ..scene.check import MOST_PERIODS
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State

STEPS = 64  # of the parameter from one value to the next
KICK = 0.375  # power of eps, of the largest x and v: it lets a motion leave an orbit that has ceased to attract
HEADING = (0.6, 0.8)


class Carried(NamedTuple):
    """Where an attractor was carried to. home: the place among those of the next value, None where it settled on none;
    trail: x, v and contact at phase 0 on the way, MOST_PERIODS of them at each step, shape (STEPS, MOST_PERIODS, 3)."""

    home: int | None
    trail: Float[np.ndarray, "steps periods 3"]


@dataclass(eq=False)
class Station:
    """What there is at one value of the parameter.

    scene; seen: its attractors, as `Evidence`, whose lanes are the starts on them; lost: how many starts are on none;
    scale: of x and v, the largest; status: the worst of the starts'. ways: {-1 or 1: {place in `seen`: `Carried`}}, to
    the value before and to the one after.
    """

    value: float
    scene: Scene
    seen: list[Evidence]
    lost: int
    scale: float | np.floating
    status: int
    ways: dict[int, dict[int, Carried]] = field(default_factory=lambda: {-1: {}, 1: {}})


def carry_on(stations, name, settle):
    """Carries each attractor of some `Station`s, in order of their values, to the values beside its own.

    What it settles on there and no start has found is an attractor of that value too, of no starts, and carried on in
    its turn. That takes as many rounds as there are values at most, for one that goes all along the parameter.
    """
    for _ in stations:
        tasks = [
            (k, place, way)
            for k, station in enumerate(stations)
            for place in range(len(station.seen))
            for way in (-1, 1)
            if 0 <= k + way < len(stations) and place not in station.ways[way]
        ]
        for first in range(0, len(tasks), WIDTH):
            _carry(stations, name, tasks[first : first + WIDTH], settle)


def _carry(stations, name, tasks, settle):
    """Carries at most WIDTH attractors, (station, place, way) each, all at once."""
    padded = tasks + tasks[-1:] * (WIDTH - len(tasks))
    begin = np.array([stations[k].value for k, _, _ in padded])
    end = np.array([stations[k + way].value for k, _, way in padded])
    states = [stations[k].seen[place].numbers["state"] for k, place, _ in padded]
    state, status, trail = _ramp(
        stations[0].scene, name, begin, end, _stacked(stations[0].scene, states), _scales(stations, padded)
    )
    goals = np.array([k + way for k, _, way in tasks])
    homes = np.full(len(tasks), -1)
    for goal in np.unique(goals):
        lanes = np.flatnonzero((goals == goal) & (status[: len(tasks)] < Status.CAP))
        if lanes.size:
            homes[lanes] = homes_of(stations[goal], jax.tree.map(lambda leaf, lanes=lanes: leaf[lanes], state), settle)
    for lane, (k, place, way) in enumerate(tasks):
        home = None if homes[lane] < 0 else int(homes[lane])
        stations[k].ways[way][place] = Carried(home, trail[:, :, lane])


def _scales(stations, tasks):
    return np.array([max(stations[k].scale, stations[k + way].scale) for k, _, way in tasks])


def _stacked(scene, states):
    """States of one lane each, at phase 0, as one of many lanes."""
    parts = ([getattr(one, key) for one in states] for key in ("x", "v", "contact"))
    x, v, contact = (np.array(part, scene.dtype) for part in parts)
    return State(x, v, np.zeros_like(x), contact)


def _ramp(scene, name, begin, end, state, scale):
    """(state, the worst status, trail (STEPS, MOST_PERIODS, lanes, 3)) of lanes whose parameters go from the beginning
    to the end."""
    worst, trail = np.zeros(len(begin), int), []
    for step in range(1, STEPS + 1):
        values = end if step == STEPS else begin + (end - begin) * part_at(step)
        here = scene.replace(**{name: values})
        state = jax.tree.map(np.asarray, fit(here, kicked(scene, state, scale)))
        run = iterate(here, state, MOST_PERIODS, few=0)
        state, worst = run.state, np.maximum(worst, run.status)
        trail.append(np.stack([run.x, run.v, run.contact], -1))
    return state, worst, np.stack(trail)


def part_at(step):
    """The part of the way that the parameter has gone after so many steps: they are small at both ends, where an
    attractor of one of the values may be near its own end."""
    u = step / STEPS
    return u * u * (3.0 - 2.0 * u)


def kicked(scene, state, scale):
    """States a little aside, but for those in contact with a wall; scale: of x and v, the largest."""
    size = np.where(np.asarray(state.contact) == 0, np.finfo(scene.dtype).eps ** KICK * scale, 0.0)
    x, v = (
        np.asarray(part + size * along, scene.dtype) for part, along in zip((state.x, state.v), HEADING, strict=True)
    )
    return State(x, v, state.phase, state.contact)


def homes_of(station, state, settle):
    """The places among a station's attractors on which states (lanes) settle, -1 for none; new ones are added to them,
    with their mirror images where the scene is symmetric."""
    scene, seen = station.scene, station.seen
    left, right, _ = box(scene)
    state = jax.tree.map(np.asarray, fit(scene, kicked(scene, state, station.scale)))
    found, periods, _ = settle_lanes(scene, state, settle, max(abs(left), abs(right)))
    homes = np.full(len(periods), -1)
    for lane in np.flatnonzero(periods):
        homes[lane] = _among_orbits(seen, orbit_of(found, lane, periods[lane])[0], station.scale)
    roaming = np.flatnonzero((periods == 0) & (found.status < Status.CAP))
    for lane in roaming:
        one = roam(scene, jax.tree.map(lambda leaf, lane=lane: leaf[[lane]], found.state))
        if one.status[0] < Status.CAP:
            homes[lane] = _among(seen, read_set(scene, one, station.scale, {}))
    known = len(seen)
    for one in periodic(scene, found, np.where(homes < 0, periods, 0), settle, station.scale)[0]:
        homes[one.lanes] = _added(seen, one)
    for one in chaotic(scene, found, roaming[homes[roaming] < 0], station.scale)[0]:
        homes[one.lanes] = _added(seen, one)
    if len(seen) > known:
        seen += free_and_mirrored.images(scene, seen, station.scale)
    return homes


def _among_orbits(seen, points, scale):
    """The place of the periodic attractor with these points, -1 where there is none."""
    near = np.finfo(points.dtype).eps ** 0.4 * scale
    for place, one in enumerate(seen):
        known = one.numbers["points"]
        if one.numbers["periods"] == len(points) and is_turned(points, known, near):
            return place
    return -1


def _among(seen, one):
    """The place of an attractor that is one of those seen, -1 where it is none."""
    test = is_same_orbit if one.numbers["periods"] else is_same_set
    alike = (k for k, other in enumerate(seen) if other.numbers["periods"] == one.numbers["periods"])
    return next((k for k in alike if test(one.hits, seen[k].hits)), -1)


def _added(seen, one):
    """The place of an attractor among those seen, to which it is added where it is new, as one of no starts."""
    place = _among(seen, one)
    if place < 0:
        seen.append(replace(one, lanes=[]))
        return len(seen) - 1
    return place
