"""Reproduce figure 2: hysteresis of sweeps at two frequencies, between symmetric and unequal walls."""

import numpy as np

from .. import plot
from ..output.equal_runs import find_equal_runs
from ..studies.scene_file_studies import run_studies
from .claim import number_claim, statement_claim
from .closed_forms import forced_motion_state
from .figure_panels import (
    FigureResult,
    add_figure_legend,
    make_figure,
    panel_scene_files,
    png_bytes,
    trim_axis_labels,
)
from .special_points import explore_twice, special_point_value

PANEL_LETTERS = "abcd"
# Printed jumps up and down at the two frequencies, with walls at -1 and 1.
PRINTED_JUMPS = ("2.615", "0.40"), ("4.33", "0.65")
MOTION_TOLERANCE = 1e-6  # distance from the motion without impacts
LEG_TOLERANCE = 1e-3  # difference of two legs

CAPTION = (
    "x at phase 0 of the drive against its amplitude, in sweeps down and up, over the branches of periodic motions, "
    "between walls at -1 and 1 (above) and at -1.5 and 1 (below), at two frequencies."
)


def reproduce_figure_2(scene_file, show_progress):
    """Reproduce figure 2 and its claims."""
    panel_results = [
        run_studies(panel_scene_file, show_progress=show_progress) for panel_scene_file in panel_scene_files(scene_file)
    ]
    loop_edges = [_loop_edges(panel_result) for panel_result in panel_results]
    figure_png = _figure_png(panel_results)
    claims = [
        claim
        for frequency_index, printed_jumps in enumerate(PRINTED_JUMPS)
        for claim in _jump_claims(panel_results[frequency_index], loop_edges[frequency_index], printed_jumps)
    ]
    claims += [
        _wider_loop_claim(
            panel_results[frequency_index + 2], loop_edges[frequency_index], loop_edges[frequency_index + 2]
        )
        for frequency_index in range(2)
    ]
    return FigureResult(
        figure_png,
        CAPTION,
        tuple(claims),
        {
            f".{panel_letter}": panel_result.swept
            for panel_letter, panel_result in zip(PANEL_LETTERS, panel_results, strict=True)
        },
    )


def _loop_edges(study_results):
    """Return (value, error) of each edge of the loop: the grazing of P100 and the lowest saddle-node of P111."""
    diagrams = explore_twice(study_results.scene, study_results.file.explore, study_results.diagram)
    return special_point_value(diagrams, "GR", "P100"), special_point_value(diagrams, "SN", "P111")


def _jump_claims(study_results, loop_edges, printed_jumps):
    scene = study_results.scene
    frequency_text = f"frequency {float(scene.frequency):g}"
    jump_intervals = [find_sweep_jump(study_results, leg_name) for leg_name in ("up", "down")]
    event_names = ("the grazing of P100", "the saddle-node of P111")
    for sweep_direction, loop_edge, event_name, printed_number, jump_interval in zip(
        ("up", "down"), loop_edges, event_names, printed_jumps, jump_intervals, strict=True
    ):
        reason = (
            f"It is {event_name}. Our sweep of {study_results.file.sweep.count} values with transients of"
            f" {study_results.file.sweep.settle} periods jumps between {jump_interval[0]:.5g} and"
            f" {jump_interval[1]:.5g}, which depends on"
            " steps and transients."
        )
        yield number_claim("2a", f"jump {sweep_direction} at {frequency_text}", printed_number, loop_edge, reason)


def find_sweep_jump(study_results, leg_name):
    """Return the two consecutive parameter values of a leg between which the sweep jumps.

    At a jump the motion changes to or from the motion without impacts. The values are those of the first jump, in the
    order of the sweep, and nan without a jump.
    """
    leg_data, scene = study_results.swept.sel(leg=leg_name), study_results.scene
    parameter_values = leg_data[leg_data.attrs["swept"]].transpose("step", ...).values.ravel()
    frequency, damping = float(scene.frequency), float(scene.damping)
    forced_coordinates = zip("xv", forced_motion_state(parameter_values, frequency, damping), strict=True)
    coordinate_differences = np.stack(
        [
            abs(leg_data[coordinate_name].transpose("step", "period").values - forced_values[:, None])
            for coordinate_name, forced_values in forced_coordinates
        ]
    )
    (change_rows,) = np.nonzero(
        np.diff(coordinate_differences.max(axis=(0, 2)) > MOTION_TOLERANCE * (1.0 + parameter_values))
    )
    return (
        (parameter_values[change_rows[0]], parameter_values[change_rows[0] + 1])
        if len(change_rows)
        else (np.nan, np.nan)
    )


def hysteresis_ranges(sweep_data):
    """Return (lower, upper) of each parameter range in which the legs down and up of a sweep differ."""
    parameter_values = sweep_data[sweep_data.attrs["swept"]].transpose("step", "leg").values
    down_positions, up_positions = sweep_data["x"].transpose("leg", "step", "period").values
    is_different = abs(up_positions - down_positions[::-1]).max(axis=1) > LEG_TOLERANCE
    return [
        (parameter_values[start, 1], parameter_values[stop - 1, 1])
        for start, stop in find_equal_runs(is_different)
        if is_different[start]
    ]


def _wider_loop_claim(study_results, narrow_edges, wide_edges):
    """Return the claim that the hysteresis loop is wider between unequal walls than between symmetric walls."""
    (wide_upper, wide_upper_error), (wide_lower, wide_lower_error) = wide_edges
    (narrow_upper, narrow_upper_error), (narrow_lower, narrow_lower_error) = narrow_edges
    width_difference = (
        (wide_upper - wide_lower) - (narrow_upper - narrow_lower),
        wide_upper_error + wide_lower_error + narrow_upper_error + narrow_lower_error,
    )
    loop_text = (
        f"the loop of P100 and P111 at frequency {float(study_results.scene.frequency):g}:"
        f" {wide_upper - wide_lower:.6g} here, "
        f"{narrow_upper - narrow_lower:.6g} there"
    )
    ranges_text = " and ".join(f"{lower:.4g} to {upper:.4g}" for lower, upper in hysteresis_ranges(study_results.swept))
    reason = (
        f"P100 grazes at {wide_upper:.6g} here and {narrow_upper:.6g} there, P111 begins at {wide_lower:.6g} and"
        f" {narrow_lower:.6g}. The two sweeps "
        f"differ at {ranges_text}."
    )
    return statement_claim(
        "2b", f"hysteresis is wider than in 2a ({loop_text}; the difference)", width_difference, low=0.0, reason=reason
    )


def _figure_png(panel_results):
    figure, axes_grid = make_figure(2, 2, 2.3)
    for ax, panel_result, panel_letter in zip(axes_grid.flat, panel_results, PANEL_LETTERS, strict=True):
        plot.diagram(panel_result.swept, "x", ax)
        for branch in panel_result.diagram_branches:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"({panel_letter}) $\\omega$ = {float(panel_result.scene.frequency):g}", loc="left")
    trim_axis_labels(axes_grid)
    add_figure_legend(figure, axes_grid, excluded_artist_ids=("branch",))
    return png_bytes(figure)
