"""The rules for a scene file: each that is broken is a SceneError naming the key, dotted from the top."""

from contextlib import contextmanager

import numpy as np

from ..design.free_numbers import room_of, units_of
from ..design.records import positive
from ..scene import check
from ..scene.scene import Scene, changed, free_between, known
from ..scene.scene_table import PLAIN
from ..surveys.map import study_of
from .schema import KINDS, MOST_STATES


@check.of_scene
def checked(file):
    """A `SceneFile`, once scene and studies break no rule. Raises SceneError naming the key, dotted from the top."""
    scene = _plain(file.scene)
    if file.sweep is not None:
        _check_sweep(scene, file.sweep)
    for name in ("attractors", "orbits"):
        asked = getattr(file, name)
        if asked is not None:
            with _under(f"{name}.at."):
                known(changed(scene, asked.at), np.float64)
    if file.branch is not None:
        _check_branch(scene, file.branch)
    if file.explore is not None:
        _check_explore(scene, file)
    if file.locus is not None:
        _check_locus(scene, file)
    if file.margin is not None:
        _check_margin(scene, file.margin)
    if file.fit is not None:
        _check_fit(scene, file.fit)
    if file.map is not None:
        _check_map(scene, file.map)
    if file.spectrum is not None:
        _check_spectrum(scene, file.spectrum)
    if file.basins is not None:
        _check_basins(scene, file.basins)
    _check_panels(scene, file)
    return file


def _plain(table):
    """The scene of a table in NumPy's float64, checked, whether jax has double precision on or not."""
    left, right = (wall and wall.wall() for wall in (table.left, table.right))
    given = {name: getattr(table, name) for name in PLAIN}
    plain = {name: None if value is None else np.asarray(value) for name, value in given.items()}
    force, drive = table.force and table.force.force(), tuple(each.motion() for each in table.drive)
    with _under("scene."):
        return known(Scene(**plain, left=left, right=right, force=force, drive=drive), np.float64)


@contextmanager
def _under(prefix):
    """Names the keys of a scene's errors as the file does."""
    try:
        yield
    except check.ArgumentError as error:
        raise check.SceneError(prefix + error.key, error.rule, error.value, error.index) from None


def _check_map(scene, table):
    _check_plane("map", scene, table)
    with _under("map.at."):
        here = known(changed(scene, table.at), np.float64)
    if table.starts is None:
        _check_start("map.start", here, table.start)
    with _under("map."):
        study_of(here, **table.arguments)


def _check_plane(key, scene, asked):
    """Two different parameters, and bounds for both."""
    names = list(asked.parameters)
    for place, name in enumerate(names):
        _check_name(f"{key}.parameters[{place}]", scene, name)
    if names[0] == names[1]:
        raise check.SceneError(f"{key}.parameters", "must be two different parameters", names)
    if set(asked.bounds) != set(names):
        given = ", ".join(asked.bounds) or "none"
        raise check.SceneError(f"{key}.bounds", f"must give [low, high] for {' and for '.join(names)}, no other", given)
    for name in names:
        _check_bounds(f"{key}.bounds.{name}", asked.bounds[name])


def _check_sweep(scene, sweep):
    _check_name("sweep.parameter", scene, sweep.parameter)
    if sweep.count * sweep.keep * len(sweep.legs) > MOST_STATES:
        rule = f"must keep at most {MOST_STATES:,} states: count times keep times the number of legs"
        raise check.SceneError("sweep.keep", rule, sweep.keep)
    met = set()
    for place, leg in enumerate(sweep.legs):
        if leg.name in met:
            raise check.SceneError(f"sweep.legs[{place}].name", "must differ from the other legs' names", leg.name)
        met.add(leg.name)
        _check_leg(f"sweep.legs[{place}]", scene, sweep, leg)


def _check_leg(key, scene, sweep, leg):
    for name, value in (("from", leg.first), ("to", leg.last)):
        check.number(f"{key}.{name}", value, np.float64)
    with _under(f"{key} from {leg.first} to {leg.last}: "):
        known(changed(scene, {sweep.parameter: sweep.values(leg)}), np.float64)
    _check_start(f"{key}.start", changed(scene, {sweep.parameter: leg.first}), leg.start)


def _check_spectrum(scene, asked):
    _check_name("spectrum.parameter", scene, asked.parameter)
    for name, value in (("from", asked.first), ("to", asked.last)):
        check.number(f"spectrum.{name}", value, np.float64)
    with _under(f"spectrum from {asked.first} to {asked.last}: "):
        known(changed(scene, {asked.parameter: asked.values}), np.float64)
    for value in (asked.first, asked.last):
        _check_start("spectrum.start", changed(scene, {asked.parameter: value}), asked.start)
    _check_step("spectrum.error", asked.error)


def _check_basins(scene, asked):
    for key in ("x", "v"):
        _check_bounds(f"basins.{key}", getattr(asked, key))
    check.number("basins.phase", asked.phase, np.float64)
    with _under("basins.at."):
        scene = known(changed(scene, asked.at), np.float64)
    low, high = map(float, free_between(scene, asked.phase))
    if asked.x[0] < low or asked.x[1] > high:
        raise check.SceneError("basins.x", f"must lie between the walls, here at {low} and {high}", list(asked.x))


def _check_panels(scene, file):
    lengths = {name: len(values) for name, values in file.panels.items()}
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        raise check.SceneError("panels", "must give each parameter a value for each panel, as many of each", lengths)
    for name, values in file.panels.items():
        _check_name(f"panels.{name}", scene, name)
        with _under("panels."):
            known(changed(scene, {name: np.array(values)}), np.float64)


def _check_branch(scene, branch):
    scene = _check_followed("branch", scene, branch)
    low, high = branch.bounds
    value = float(scene.parameter(branch.parameter))
    if not low <= value <= high:
        if branch.parameter in branch.at:
            rule = f"must lie within branch.bounds, {low} and {high}"
            raise check.SceneError(f"branch.at.{branch.parameter}", rule, value)
        rule = f"must hold the scene's {branch.parameter}, {value}, or that in branch.at"
        raise check.SceneError("branch.bounds", rule, list(branch.bounds))
    _check_start("branch.start", scene, branch.start)
    _check_step("branch.largest_step", branch.largest_step)


def _check_explore(scene, file):
    if file.branch is not None:
        raise check.SceneError("explore", "must not stand beside [branch]", file.explore.parameter)
    _check_followed("explore", scene, file.explore)


def _check_followed(key, scene, asked):
    """The scene of a [branch] or [explore], once its parameter, bounds and values break no rule."""
    _check_name(f"{key}.parameter", scene, asked.parameter)
    _check_bounds(f"{key}.bounds", asked.bounds)
    with _under(f"{key}.at."):
        return known(changed(scene, asked.at), np.float64)


def _check_locus(scene, file):
    asked, source = file.locus, file.followed
    names = list(asked.parameters)
    if source is None:
        raise check.SceneError("locus", "must come with [branch] or [explore], whose special points it follows", names)
    _check_plane("locus", scene, asked)
    for name in names:
        _check_reach(f"locus.bounds.{name}", name, asked.bounds[name], scene, file)
    _check_kinds("locus.kinds", asked.kinds)
    _check_step("locus.largest_step", asked.largest_step)


def _check_margin(scene, asked):
    with _under("margin.at."):
        scene = known(changed(scene, asked.at), np.float64)
    _check_kinds("margin.kinds", asked.kinds)
    _check_start("margin.start", scene, asked.start)
    with _under("margin."):
        units = units_of(scene, asked.free)
        room_of(scene, units, asked.bounds)
        check.whole("directions", asked.directions, 2 * len(units))


def _check_fit(scene, asked):
    with _under("fit."):
        room_of(scene, units_of(scene, asked.free), asked.bounds)
        positive("sigma", asked.sigma)


def _check_kinds(key, kinds):
    for place, kind in enumerate(kinds):
        if kind not in KINDS or kind in kinds[:place]:
            rule = f"must be one of {', '.join(KINDS)}" if kind not in KINDS else "must differ from the others"
            raise check.SceneError(f"{key}[{place}]", rule, kind)


def _check_reach(key, name, bounds, scene, file):
    """Refuse bounds of a locus in which no special point of the branches can lie."""
    table, source = "branch" if file.branch is not None else "explore", file.followed
    (low, high), (least, most) = bounds, source.bounds
    if name == source.parameter:
        if high < least or most < low:
            raise check.SceneError(key, f"must overlap {table}.bounds, {least} and {most}", list(bounds))
        return
    value = float(changed(scene, source.at).parameter(name))
    if not low <= value <= high:
        raise check.SceneError(key, f"must hold the {name} of [{table}], {value}", list(bounds))


def _check_bounds(key, bounds):
    low, high = bounds
    if not (np.isfinite(bounds).all() and low < high):
        raise check.SceneError(key, "must be [low, high], two finite numbers, the first smaller", list(bounds))


def _check_step(key, step):
    step = check.number(key, step, np.float64)
    check.require(key, "must be greater than 0", step, step > 0)


def _check_name(key, scene, name):
    if name not in scene.names:
        raise check.SceneError(key, f"must be a parameter of the scene{check.among(name, scene.names)}", name)


def _check_start(key, scene, start):
    for name in ("x", "v"):
        check.number(f"{key}.{name}", getattr(start, name), np.float64)
    low, high = map(float, free_between(scene, 0.0))
    rule = f"must lie between the walls, here at {low} and {high}"
    check.require(f"{key}.x", rule, start.x, low <= start.x <= high)
