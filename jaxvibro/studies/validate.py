"""Check a scene file; each error is a SceneError that names the key, dotted from the top."""

from contextlib import contextmanager

import numpy as np

from ..design.free_parameters import allowed_changes, check_units
from ..design.records import positive_number
from ..scene import check
from ..scene.scene import Scene, replace_unchecked, rigid_wall_positions, validate_scene
from ..scene.scene_table import NUMBER_KEYS
from ..surveys.map import make_study
from .schema import LOCUS_KINDS, MAX_SWEEP_STATES


@check.raise_scene_errors
def check_scene_file(file):
    """Return a `SceneFile` whose scene and analyses break no rule; a SceneError names the key, dotted from the top."""
    scene = _numpy_scene(file.scene)
    if file.sweep is not None:
        _check_sweep(scene, file.sweep)
    for name in ("attractors", "orbits"):
        table = getattr(file, name)
        if table is not None:
            with _prefixed_errors(f"{name}.at."):
                validate_scene(replace_unchecked(scene, table.at), np.float64)
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


def _numpy_scene(table):
    """Return the checked scene of a table in NumPy's float64, for any precision of jax."""
    left, right = (wall and wall.wall() for wall in (table.left, table.right))
    values = {name: getattr(table, name) for name in NUMBER_KEYS}
    arrays = {name: None if value is None else np.asarray(value) for name, value in values.items()}
    force, drive = table.force and table.force.force(), tuple(term.motion() for term in table.drive)
    with _prefixed_errors("scene."):
        return validate_scene(Scene(**arrays, left=left, right=right, force=force, drive=drive), np.float64)


@contextmanager
def _prefixed_errors(prefix):
    """Prefix the keys of a scene's errors with the table of the file."""
    try:
        yield
    except check.ArgumentError as error:
        raise check.SceneError(prefix + error.key, error.rule, error.value, error.index) from None


def _check_map(scene, table):
    _check_plane("map", scene, table)
    with _prefixed_errors("map.at."):
        map_scene = validate_scene(replace_unchecked(scene, table.at), np.float64)
    if table.starts is None:
        _check_start("map.start", map_scene, table.start)
    with _prefixed_errors("map."):
        make_study(map_scene, **table.arguments)


def _check_plane(key, scene, table):
    """Check that there are two different parameters with bounds for both."""
    names = list(table.parameters)
    for index, name in enumerate(names):
        _check_name(f"{key}.parameters[{index}]", scene, name)
    if names[0] == names[1]:
        raise check.SceneError(f"{key}.parameters", "must be two different parameters", names)
    if set(table.bounds) != set(names):
        bound_names = ", ".join(table.bounds) or "none"
        raise check.SceneError(
            f"{key}.bounds", f"must give [low, high] for {' and for '.join(names)} only", bound_names
        )
    for name in names:
        _check_bounds(f"{key}.bounds.{name}", table.bounds[name])


def _check_sweep(scene, sweep):
    _check_name("sweep.parameter", scene, sweep.parameter)
    if sweep.count * sweep.keep * len(sweep.legs) > MAX_SWEEP_STATES:
        rule = f"must keep at most {MAX_SWEEP_STATES:,} states: count times keep times the number of legs"
        raise check.SceneError("sweep.keep", rule, sweep.keep)
    leg_names = set()
    for index, leg in enumerate(sweep.legs):
        if leg.name in leg_names:
            raise check.SceneError(f"sweep.legs[{index}].name", "must differ from the other legs' names", leg.name)
        leg_names.add(leg.name)
        _check_leg(f"sweep.legs[{index}]", scene, sweep, leg)


def _check_leg(key, scene, sweep, leg):
    for name, value in (("from", leg.first), ("to", leg.last)):
        check.finite_array(f"{key}.{name}", value, np.float64)
    with _prefixed_errors(f"{key} from {leg.first} to {leg.last}: "):
        validate_scene(replace_unchecked(scene, {sweep.parameter: sweep.values(leg)}), np.float64)
    _check_start(f"{key}.start", replace_unchecked(scene, {sweep.parameter: leg.first}), leg.start)


def _check_spectrum(scene, table):
    _check_name("spectrum.parameter", scene, table.parameter)
    for name, value in (("from", table.first), ("to", table.last)):
        check.finite_array(f"spectrum.{name}", value, np.float64)
    with _prefixed_errors(f"spectrum from {table.first} to {table.last}: "):
        validate_scene(replace_unchecked(scene, {table.parameter: table.values}), np.float64)
    for value in (table.first, table.last):
        _check_start("spectrum.start", replace_unchecked(scene, {table.parameter: value}), table.start)
    _check_step("spectrum.error", table.error)


def _check_basins(scene, table):
    for key in ("x", "v"):
        _check_bounds(f"basins.{key}", getattr(table, key))
    check.finite_array("basins.phase", table.phase, np.float64)
    with _prefixed_errors("basins.at."):
        scene = validate_scene(replace_unchecked(scene, table.at), np.float64)
    lower, upper = map(float, rigid_wall_positions(scene, table.phase))
    if table.x[0] < lower or table.x[1] > upper:
        raise check.SceneError("basins.x", f"must lie between the walls, at {lower} and {upper}", list(table.x))


def _check_panels(scene, file):
    lengths = {name: len(values) for name, values in file.panels.items()}
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        raise check.SceneError("panels", "must give equally many values for each parameter, one per panel", lengths)
    for name, values in file.panels.items():
        _check_name(f"panels.{name}", scene, name)
        with _prefixed_errors("panels."):
            validate_scene(replace_unchecked(scene, {name: np.array(values)}), np.float64)


def _check_branch(scene, branch):
    scene = _check_branch_table("branch", scene, branch)
    lower, upper = branch.bounds
    value = float(scene.parameter(branch.parameter))
    if not lower <= value <= upper:
        if branch.parameter in branch.at:
            rule = f"must lie within branch.bounds, {lower} and {upper}"
            raise check.SceneError(f"branch.at.{branch.parameter}", rule, value)
        rule = f"must contain the scene's {branch.parameter}, {value}, or that in branch.at"
        raise check.SceneError("branch.bounds", rule, list(branch.bounds))
    _check_start("branch.start", scene, branch.start)
    _check_step("branch.largest_step", branch.largest_step)


def _check_explore(scene, file):
    if file.branch is not None:
        raise check.SceneError("explore", "must not be given together with [branch]", file.explore.parameter)
    _check_branch_table("explore", scene, file.explore)


def _check_branch_table(key, scene, table):
    """Return the scene of a [branch] or [explore] after a check of its parameter, bounds and values."""
    _check_name(f"{key}.parameter", scene, table.parameter)
    _check_bounds(f"{key}.bounds", table.bounds)
    with _prefixed_errors(f"{key}.at."):
        return validate_scene(replace_unchecked(scene, table.at), np.float64)


def _check_locus(scene, file):
    table, branch_table = file.locus, file.branch_table
    names = list(table.parameters)
    if branch_table is None:
        raise check.SceneError("locus", "must come with [branch] or [explore], whose special points it follows", names)
    _check_plane("locus", scene, table)
    for name in names:
        _check_overlap(f"locus.bounds.{name}", name, table.bounds[name], scene, file)
    _check_kinds("locus.kinds", table.kinds)
    _check_step("locus.largest_step", table.largest_step)


def _check_margin(scene, table):
    with _prefixed_errors("margin.at."):
        scene = validate_scene(replace_unchecked(scene, table.at), np.float64)
    _check_kinds("margin.kinds", table.kinds)
    _check_start("margin.start", scene, table.start)
    with _prefixed_errors("margin."):
        units = check_units(scene, table.free)
        allowed_changes(scene, units, table.bounds)
        check.whole_number("directions", table.directions, 2 * len(units))


def _check_fit(scene, table):
    with _prefixed_errors("fit."):
        allowed_changes(scene, check_units(scene, table.free), table.bounds)
        positive_number("sigma", table.sigma)


def _check_kinds(key, kinds):
    for index, kind in enumerate(kinds):
        if kind not in LOCUS_KINDS or kind in kinds[:index]:
            rule = (
                f"must be one of {', '.join(LOCUS_KINDS)}" if kind not in LOCUS_KINDS else "must differ from the others"
            )
            raise check.SceneError(f"{key}[{index}]", rule, kind)


def _check_overlap(key, name, bounds, scene, file):
    """Check that a special point of the branches can lie within the bounds of a locus."""
    table_name, branch_table = "branch" if file.branch is not None else "explore", file.branch_table
    (lower, upper), (branch_lower, branch_upper) = bounds, branch_table.bounds
    if name == branch_table.parameter:
        if upper < branch_lower or branch_upper < lower:
            raise check.SceneError(
                key, f"must overlap {table_name}.bounds, {branch_lower} and {branch_upper}", list(bounds)
            )
        return
    value = float(replace_unchecked(scene, branch_table.at).parameter(name))
    if not lower <= value <= upper:
        raise check.SceneError(key, f"must contain the {name} of [{table_name}], {value}", list(bounds))


def _check_bounds(key, bounds):
    lower, upper = bounds
    if not (np.isfinite(bounds).all() and lower < upper):
        raise check.SceneError(key, "must be [low, high], two finite numbers, the first smaller", list(bounds))


def _check_step(key, step):
    step = check.finite_array(key, step, np.float64)
    check.require(key, "must be greater than 0", step, step > 0)


def _check_name(key, scene, name):
    if name not in scene.names:
        raise check.SceneError(
            key, f"must be a parameter of the scene{check.describe_choices(name, scene.names)}", name
        )


def _check_start(key, scene, start):
    for name in ("x", "v"):
        check.finite_array(f"{key}.{name}", getattr(start, name), np.float64)
    lower, upper = map(float, rigid_wall_positions(scene, 0.0))
    rule = f"must lie between the walls, at {lower} and {upper}"
    check.require(f"{key}.x", rule, start.x, lower <= start.x <= upper)
