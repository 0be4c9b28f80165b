"""Check the tables of a scene file; each error is a SceneError that names the full dotted key."""

from contextlib import contextmanager

import numpy as np

from ..design.free_parameter_checks import bounds_of_changes, check_free_parameters
from ..design.records import require_positive_number
from ..scene import check
from ..scene.scene import Scene, replace_unchecked, rigid_wall_positions, validate_scene
from ..scene.scene_table import NUMBER_KEYS
from ..surveys.map import make_map_study
from .schema import LOCUS_KINDS, MAX_SWEEP_STATES


@check.convert_to_scene_errors
def check_scene_file(scene_file):
    """Return a `SceneFile` if its scene and analyses are valid; raise SceneError otherwise."""
    scene = _make_numpy_scene(scene_file.scene)
    if scene_file.sweep is not None:
        _check_sweep(scene, scene_file.sweep)
    for analysis_name in ("attractors", "orbits"):
        analysis_table = getattr(scene_file, analysis_name)
        if analysis_table is not None:
            with _prefix_error_keys(f"{analysis_name}.at."):
                validate_scene(replace_unchecked(scene, analysis_table.at), np.float64)
    if scene_file.branch is not None:
        _check_branch(scene, scene_file.branch)
    if scene_file.explore is not None:
        _check_explore(scene, scene_file)
    if scene_file.locus is not None:
        _check_locus(scene, scene_file)
    if scene_file.margin is not None:
        _check_margin(scene, scene_file.margin)
    if scene_file.fit is not None:
        _check_fit(scene, scene_file.fit)
    if scene_file.map is not None:
        _check_map(scene, scene_file.map)
    if scene_file.spectrum is not None:
        _check_spectrum(scene, scene_file.spectrum)
    if scene_file.basins is not None:
        _check_basins(scene, scene_file.basins)
    _check_panels(scene, scene_file)
    return scene_file


def _make_numpy_scene(scene_table):
    """Return the valid scene of a [scene] table with float64 arrays of NumPy, whatever the precision of JAX."""
    left_wall, right_wall = (wall and wall.wall() for wall in (scene_table.left, scene_table.right))
    scene_values = {parameter_name: getattr(scene_table, parameter_name) for parameter_name in NUMBER_KEYS}
    scene_arrays = {
        parameter_name: None if parameter_value is None else np.asarray(parameter_value)
        for parameter_name, parameter_value in scene_values.items()
    }
    force, drive = (
        scene_table.force and scene_table.force.force(),
        tuple(drive_term.motion() for drive_term in scene_table.drive),
    )
    with _prefix_error_keys("scene."):
        return validate_scene(
            Scene(**scene_arrays, left=left_wall, right=right_wall, force=force, drive=drive), np.float64
        )


@contextmanager
def _prefix_error_keys(prefix):
    """Convert ArgumentErrors in the block to SceneErrors whose keys have a prefix, the name of the table."""
    try:
        yield
    except check.ArgumentError as error:
        raise check.SceneError(prefix + error.key, error.rule, error.value, error.index) from None


def _check_map(scene, map_table):
    _check_parameter_plane("map", scene, map_table)
    with _prefix_error_keys("map.at."):
        scene_at_values = validate_scene(replace_unchecked(scene, map_table.at), np.float64)
    if map_table.starts is None:
        _check_initial_state("map.start", scene_at_values, map_table.start)
    with _prefix_error_keys("map."):
        make_map_study(scene_at_values, **map_table.arguments)


def _check_parameter_plane(table_key, scene, table):
    """Check that a table has two different parameters and bounds for both."""
    parameter_names = list(table.parameters)
    for index, parameter_name in enumerate(parameter_names):
        _check_parameter_name(f"{table_key}.parameters[{index}]", scene, parameter_name)
    if parameter_names[0] == parameter_names[1]:
        raise check.SceneError(f"{table_key}.parameters", "must be two different parameters", parameter_names)
    if set(table.bounds) != set(parameter_names):
        bounds_text = ", ".join(table.bounds) or "none"
        raise check.SceneError(
            f"{table_key}.bounds", f"must give [low, high] for {' and for '.join(parameter_names)} only", bounds_text
        )
    for parameter_name in parameter_names:
        _check_bounds(f"{table_key}.bounds.{parameter_name}", table.bounds[parameter_name])


def _check_sweep(scene, sweep_table):
    _check_parameter_name("sweep.parameter", scene, sweep_table.parameter)
    if sweep_table.count * sweep_table.keep * len(sweep_table.legs) > MAX_SWEEP_STATES:
        rule = f"must keep at most {MAX_SWEEP_STATES:,} states: count times keep times the number of legs"
        raise check.SceneError("sweep.keep", rule, sweep_table.keep)
    leg_names = set()
    for index, leg_table in enumerate(sweep_table.legs):
        if leg_table.name in leg_names:
            raise check.SceneError(
                f"sweep.legs[{index}].name", "must differ from the other legs' names", leg_table.name
            )
        leg_names.add(leg_table.name)
        _check_leg(f"sweep.legs[{index}]", scene, sweep_table, leg_table)


def _check_leg(leg_key, scene, sweep_table, leg_table):
    for end_key, end_value in (("from", leg_table.first), ("to", leg_table.last)):
        check.check_finite_array(f"{leg_key}.{end_key}", end_value, np.float64)
    with _prefix_error_keys(f"{leg_key} from {leg_table.first} to {leg_table.last}: "):
        validate_scene(replace_unchecked(scene, {sweep_table.parameter: sweep_table.values(leg_table)}), np.float64)
    _check_initial_state(
        f"{leg_key}.start", replace_unchecked(scene, {sweep_table.parameter: leg_table.first}), leg_table.start
    )


def _check_spectrum(scene, spectrum_table):
    _check_parameter_name("spectrum.parameter", scene, spectrum_table.parameter)
    for end_key, end_value in (("from", spectrum_table.first), ("to", spectrum_table.last)):
        check.check_finite_array(f"spectrum.{end_key}", end_value, np.float64)
    with _prefix_error_keys(f"spectrum from {spectrum_table.first} to {spectrum_table.last}: "):
        validate_scene(replace_unchecked(scene, {spectrum_table.parameter: spectrum_table.values}), np.float64)
    for end_value in (spectrum_table.first, spectrum_table.last):
        _check_initial_state(
            "spectrum.start", replace_unchecked(scene, {spectrum_table.parameter: end_value}), spectrum_table.start
        )
    _require_positive("spectrum.error", spectrum_table.error)


def _check_basins(scene, basins_table):
    for coordinate_name in ("x", "v"):
        _check_bounds(f"basins.{coordinate_name}", getattr(basins_table, coordinate_name))
    check.check_finite_array("basins.phase", basins_table.phase, np.float64)
    with _prefix_error_keys("basins.at."):
        scene = validate_scene(replace_unchecked(scene, basins_table.at), np.float64)
    left_position, right_position = map(float, rigid_wall_positions(scene, basins_table.phase))
    if basins_table.x[0] < left_position or basins_table.x[1] > right_position:
        raise check.SceneError(
            "basins.x", f"must lie between the walls, at {left_position} and {right_position}", list(basins_table.x)
        )


def _check_panels(scene, scene_file):
    value_counts = {parameter_name: len(panel_values) for parameter_name, panel_values in scene_file.panels.items()}
    if len(set(value_counts.values())) > 1 or 0 in value_counts.values():
        raise check.SceneError(
            "panels", "must give equally many values for each parameter, one per panel", value_counts
        )
    for parameter_name, panel_values in scene_file.panels.items():
        _check_parameter_name(f"panels.{parameter_name}", scene, parameter_name)
        with _prefix_error_keys("panels."):
            validate_scene(replace_unchecked(scene, {parameter_name: np.array(panel_values)}), np.float64)


def _check_branch(scene, branch_table):
    scene = _check_branch_table("branch", scene, branch_table)
    lower_bound, upper_bound = branch_table.bounds
    parameter_value = float(scene.parameter(branch_table.parameter))
    if not lower_bound <= parameter_value <= upper_bound:
        if branch_table.parameter in branch_table.at:
            rule = f"must lie within branch.bounds, {lower_bound} and {upper_bound}"
            raise check.SceneError(f"branch.at.{branch_table.parameter}", rule, parameter_value)
        rule = f"must contain the scene's {branch_table.parameter}, {parameter_value}, or that in branch.at"
        raise check.SceneError("branch.bounds", rule, list(branch_table.bounds))
    _check_initial_state("branch.start", scene, branch_table.start)
    _require_positive("branch.largest_step", branch_table.largest_step)


def _check_explore(scene, scene_file):
    if scene_file.branch is not None:
        raise check.SceneError("explore", "must not be given together with [branch]", scene_file.explore.parameter)
    _check_branch_table("explore", scene, scene_file.explore)


def _check_branch_table(dotted_key, scene, branch_table):
    """Check parameter, bounds and values of a [branch] or [explore] table; return the scene with its values."""
    _check_parameter_name(f"{dotted_key}.parameter", scene, branch_table.parameter)
    _check_bounds(f"{dotted_key}.bounds", branch_table.bounds)
    with _prefix_error_keys(f"{dotted_key}.at."):
        return validate_scene(replace_unchecked(scene, branch_table.at), np.float64)


def _check_locus(scene, scene_file):
    locus_table, branch_table = scene_file.locus, scene_file.branch_table
    parameter_names = list(locus_table.parameters)
    if branch_table is None:
        raise check.SceneError(
            "locus", "must come with [branch] or [explore], whose special points it follows", parameter_names
        )
    _check_parameter_plane("locus", scene, locus_table)
    for parameter_name in parameter_names:
        _check_locus_bounds(
            f"locus.bounds.{parameter_name}", parameter_name, locus_table.bounds[parameter_name], scene, scene_file
        )
    _check_kinds("locus.kinds", locus_table.kinds)
    _require_positive("locus.largest_step", locus_table.largest_step)


def _check_margin(scene, margin_table):
    with _prefix_error_keys("margin.at."):
        scene = validate_scene(replace_unchecked(scene, margin_table.at), np.float64)
    _check_kinds("margin.kinds", margin_table.kinds)
    _check_initial_state("margin.start", scene, margin_table.start)
    with _prefix_error_keys("margin."):
        unit_by_parameter = check_free_parameters(scene, margin_table.free)
        bounds_of_changes(scene, unit_by_parameter, margin_table.bounds)
        check.check_whole_number("directions", margin_table.directions, 2 * len(unit_by_parameter))


def _check_fit(scene, fit_table):
    with _prefix_error_keys("fit."):
        bounds_of_changes(scene, check_free_parameters(scene, fit_table.free), fit_table.bounds)
        require_positive_number("sigma", fit_table.sigma)
        if fit_table.sigma_v is not None:
            require_positive_number("sigma_v", fit_table.sigma_v)


def _check_kinds(dotted_key, kinds):
    for index, kind in enumerate(kinds):
        if kind not in LOCUS_KINDS or kind in kinds[:index]:
            rule = (
                f"must be one of {', '.join(LOCUS_KINDS)}" if kind not in LOCUS_KINDS else "must differ from the others"
            )
            raise check.SceneError(f"{dotted_key}[{index}]", rule, kind)


def _check_locus_bounds(dotted_key, parameter_name, locus_bounds, scene, scene_file):
    """Check that special points of the branches can lie within the bounds of one parameter of a locus."""
    table_name, branch_table = "branch" if scene_file.branch is not None else "explore", scene_file.branch_table
    (locus_lower, locus_upper), (branch_lower, branch_upper) = locus_bounds, branch_table.bounds
    if parameter_name == branch_table.parameter:
        if locus_upper < branch_lower or branch_upper < locus_lower:
            raise check.SceneError(
                dotted_key, f"must overlap {table_name}.bounds, {branch_lower} and {branch_upper}", list(locus_bounds)
            )
        return
    parameter_value = float(replace_unchecked(scene, branch_table.at).parameter(parameter_name))
    if not locus_lower <= parameter_value <= locus_upper:
        raise check.SceneError(
            dotted_key, f"must contain the {parameter_name} of [{table_name}], {parameter_value}", list(locus_bounds)
        )


def _check_bounds(dotted_key, bounds):
    lower, upper = bounds
    if not (np.isfinite(bounds).all() and lower < upper):
        raise check.SceneError(dotted_key, "must be [low, high], two finite numbers, the first smaller", list(bounds))


def _require_positive(dotted_key, number):
    number = check.check_finite_array(dotted_key, number, np.float64)
    check.require(dotted_key, "must be greater than 0", number, number > 0)


def _check_parameter_name(dotted_key, scene, parameter_name):
    if parameter_name not in scene.names:
        raise check.SceneError(
            dotted_key,
            f"must be a parameter of the scene{check.describe_choices(parameter_name, scene.names)}",
            parameter_name,
        )


def _check_initial_state(dotted_key, scene, initial_state):
    for coordinate_name in ("x", "v"):
        check.check_finite_array(f"{dotted_key}.{coordinate_name}", getattr(initial_state, coordinate_name), np.float64)
    left_position, right_position = map(float, rigid_wall_positions(scene, 0.0))
    rule = f"must lie between the walls, at {left_position} and {right_position}"
    check.require(f"{dotted_key}.x", rule, initial_state.x, left_position <= initial_state.x <= right_position)
