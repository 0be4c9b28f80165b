"""Check the tables of a scene file; each error is a SceneError that names the full dotted key."""

from contextlib import contextmanager

import msgspec
import numpy as np

from ..design.free_parameters import bounds_of_changes, check_free_parameters
from ..design.records import require_positive_number
from ..scene import check
from ..scene.scene import check_scene_arguments, replace_unchecked, rigid_wall_positions, validate_scene
from ..surveys.map import make_map_study
from . import schema
from .schema import LOCUS_KINDS, MAX_SWEEP_STATES


@check.convert_to_scene_errors
def check_scene_file(scene_file):
    """Return a `SceneFile` if its scene and analyses are valid; raise SceneError otherwise."""
    with prefix_error_keys("scene."):  # float64, whatever the precision of JAX
        scene = check_scene_arguments(**scene_file.scene.arguments, dtype=np.float64)
    _check_combination(scene_file)
    for table_name, analysis_table in scene_file.analyses.items():
        scene_at_values = _check_fields(table_name, scene, analysis_table)
        if table_name in _RULES_BY_TABLE:
            _RULES_BY_TABLE[table_name](scene_at_values, analysis_table, scene_file)
    _check_panels(scene, scene_file)
    return scene_file


def _check_combination(scene_file):
    """Check which tables may be together."""
    if scene_file.explore is not None and scene_file.branch is not None:
        raise check.SceneError("explore", "must not be given together with [branch]", scene_file.explore.parameter)
    if scene_file.locus is not None and scene_file.branch_table is None:
        rule = "must come with [branch] or [explore], whose special points it follows"
        raise check.SceneError("locus", rule, list(scene_file.locus.parameters))


@contextmanager
def prefix_error_keys(prefix):
    """Convert ArgumentErrors in the block to SceneErrors whose keys have a prefix, the name of the table."""
    try:
        yield
    except check.ArgumentError as error:
        raise check.SceneError(prefix + error.key, error.rule, error.value, error.index) from None


def _check_fields(table_key, scene, table):
    """Check the fields of a table whose types have a rule; return the scene with the values in `at`."""
    if hasattr(table, "at"):
        scene = _replace_checked(f"{table_key}.at.", scene, table.at)
    for table_field in msgspec.structs.fields(table):
        if table_field.type in _RULES_BY_TYPE:
            dotted_key = f"{table_key}.{table_field.encode_name}"
            _RULES_BY_TYPE[table_field.type](dotted_key, scene, getattr(table, table_field.name))
    return scene


def _replace_checked(key_prefix, scene, changes):
    """Return the scene with changed parameters; a SceneError has a key with the prefix."""
    with prefix_error_keys(key_prefix):
        return validate_scene(replace_unchecked(scene, changes), np.float64)


def _check_map(scene, map_table, _):
    _check_parameter_plane("map", map_table)
    if map_table.starts is None:
        _check_initial_state("map.start", scene, map_table.start)
    with prefix_error_keys("map."):
        make_map_study(scene, **map_table.arguments)


def _check_parameter_plane(table_key, table):
    """Check that a table has two different parameters and bounds for both."""
    parameter_names = list(table.parameters)
    if parameter_names[0] == parameter_names[1]:
        raise check.SceneError(f"{table_key}.parameters", "must be two different parameters", parameter_names)
    if set(table.bounds) != set(parameter_names):
        bounds_text = ", ".join(table.bounds) or "none"
        raise check.SceneError(
            f"{table_key}.bounds", f"must give [low, high] for {' and for '.join(parameter_names)} only", bounds_text
        )
    for parameter_name in parameter_names:
        _check_bounds(f"{table_key}.bounds.{parameter_name}", None, table.bounds[parameter_name])


def _check_sweep(scene, sweep_table, _):
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
    _check_fields(leg_key, scene, leg_table)
    leg_changes = {sweep_table.parameter: sweep_table.values(leg_table)}
    _replace_checked(f"{leg_key} from {leg_table.first} to {leg_table.last}: ", scene, leg_changes)
    _check_initial_state(
        f"{leg_key}.start", replace_unchecked(scene, {sweep_table.parameter: leg_table.first}), leg_table.start
    )


def _check_spectrum(scene, spectrum_table, _):
    range_text = f"from {spectrum_table.first} to {spectrum_table.last}"
    _replace_checked(f"spectrum {range_text}: ", scene, {spectrum_table.parameter: spectrum_table.values})
    for end_value in (spectrum_table.first, spectrum_table.last):
        _check_initial_state(
            "spectrum.start", replace_unchecked(scene, {spectrum_table.parameter: end_value}), spectrum_table.start
        )


def _check_basins(scene, basins_table, _):
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
        _replace_checked("panels.", scene, {parameter_name: np.array(panel_values)})


def _check_branch(scene, branch_table, _):
    lower_bound, upper_bound = branch_table.bounds
    parameter_value = float(scene.parameter(branch_table.parameter))
    if not lower_bound <= parameter_value <= upper_bound:
        if branch_table.parameter in branch_table.at:
            rule = f"must lie within branch.bounds, {lower_bound} and {upper_bound}"
            raise check.SceneError(f"branch.at.{branch_table.parameter}", rule, parameter_value)
        rule = f"must contain the scene's {branch_table.parameter}, {parameter_value}, or that in branch.at"
        raise check.SceneError("branch.bounds", rule, list(branch_table.bounds))
    _check_initial_state("branch.start", scene, branch_table.start)


def _check_locus(scene, locus_table, scene_file):
    _check_parameter_plane("locus", locus_table)
    for parameter_name in locus_table.parameters:
        _check_locus_bounds(
            f"locus.bounds.{parameter_name}", parameter_name, locus_table.bounds[parameter_name], scene, scene_file
        )


def _check_margin(scene, margin_table, _):
    _check_initial_state("margin.start", scene, margin_table.start)
    with prefix_error_keys("margin."):
        unit_by_parameter = check_free_parameters(scene, margin_table.free)
        bounds_of_changes(scene, unit_by_parameter, margin_table.bounds)
        check.check_whole_number("directions", margin_table.directions, 2 * len(unit_by_parameter))


def _check_fit(scene, fit_table, _):
    with prefix_error_keys("fit."):
        bounds_of_changes(scene, check_free_parameters(scene, fit_table.free), fit_table.bounds)
        require_positive_number("sigma", fit_table.sigma)
        if fit_table.sigma_v is not None:
            require_positive_number("sigma_v", fit_table.sigma_v)


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


def _check_initial_state(dotted_key, scene, initial_state):
    for coordinate_name in ("x", "v"):
        _check_finite(f"{dotted_key}.{coordinate_name}", scene, getattr(initial_state, coordinate_name))
    left_position, right_position = map(float, rigid_wall_positions(scene, 0.0))
    rule = f"must lie between the walls, at {left_position} and {right_position}"
    check.require(f"{dotted_key}.x", rule, initial_state.x, left_position <= initial_state.x <= right_position)


def _check_parameter_name(dotted_key, scene, parameter_name):
    if parameter_name not in scene.names:
        raise check.SceneError(
            dotted_key,
            f"must be a parameter of the scene{check.describe_choices(parameter_name, scene.names)}",
            parameter_name,
        )


def _check_parameter_pair(dotted_key, scene, parameter_names):
    for index, parameter_name in enumerate(parameter_names):
        _check_parameter_name(f"{dotted_key}[{index}]", scene, parameter_name)


def _check_finite(dotted_key, _, number):
    check.check_finite_array(dotted_key, number, np.float64)


def _check_positive(dotted_key, _, number):
    number = check.check_finite_array(dotted_key, number, np.float64)
    check.require(dotted_key, "must be greater than 0", number, number > 0)


def _check_bounds(dotted_key, _, bounds):
    lower, upper = bounds
    if not (np.isfinite(bounds).all() and lower < upper):
        raise check.SceneError(dotted_key, "must be [low, high], two finite numbers, the first smaller", list(bounds))


def _check_kinds(dotted_key, _, kinds):
    for index, kind in enumerate(kinds):
        if kind not in LOCUS_KINDS or kind in kinds[:index]:
            rule = (
                f"must be one of {', '.join(LOCUS_KINDS)}" if kind not in LOCUS_KINDS else "must differ from the others"
            )
            raise check.SceneError(f"{dotted_key}[{index}]", rule, kind)


# Checks of the values of a type: functions of (dotted key, scene, value).
_RULES_BY_TYPE = {
    schema.ParameterName: _check_parameter_name,
    schema.ParameterPair: _check_parameter_pair,
    schema.Finite: _check_finite,
    schema.Positive: _check_positive,
    schema.Bounds: _check_bounds,
    schema.PointKinds: _check_kinds,
}
# Checks of a table that involve several of its values: functions of (scene with the values in `at`, table, file).
_RULES_BY_TABLE = {
    "sweep": _check_sweep,
    "branch": _check_branch,
    "locus": _check_locus,
    "margin": _check_margin,
    "fit": _check_fit,
    "map": _check_map,
    "spectrum": _check_spectrum,
    "basins": _check_basins,
}
