"""Check claims on P101 and P110 with one wall, fixed or moving, against closed forms."""

import numpy as np

from .. import plot
from ..branches.explore import explore
from ..scene.scene import Motion, Wall, make_scene
from . import closed_forms
from .claim import additional_claim, statement_claim
from .figure_panels import (
    FigureResult,
    add_figure_legend,
    make_figure,
    panel_scene_files,
    png_bytes,
    trim_axis_labels,
)
from .special_points import ROUNDING, explore_twice, special_point_value

WALL_MOTION = (0.1, 0.5)  # amplitude and phase of the moving wall
TOLERANCE = 1e-9

CAPTION = (
    "x at phase 0 of the drive against its amplitude, one wall, at three frequencies: P101 begins in a saddle-node "
    "only where sin(r T) < 0."
)


def reproduce_wall_diagrams(scene_file, show_progress):
    """Reproduce the diagrams with one wall and their claims."""
    panel_results, claims = [], []
    for panel_scene_file in panel_scene_files(scene_file):
        scene = panel_scene_file.scene.make()
        diagrams = explore_twice(scene, panel_scene_file.explore)
        panel_results.append((scene, diagrams.first))
        claims += _fold_claims(scene, diagrams)
    claims += [*_mirror_claims(scene_file, *panel_results[0]), _moving_wall_fold_claim(scene_file, panel_results[0][0])]
    return FigureResult(_figure_png(panel_results), CAPTION, tuple(claims))


def _closed_form_fold(scene):
    wall_position = float(scene.right.position)
    return closed_forms.single_wall_fold(
        float(scene.frequency), float(scene.damping), float(scene.restitution), wall_position
    )


def _fold_claims(scene, diagrams):
    """Yield the claims on the existence of the saddle-node of P101: our condition, and the condition of (19)."""
    frequency, damped_frequency = float(scene.frequency), float(np.sqrt(1.0 - float(scene.damping) ** 2))
    fold_amplitude, fold_speed = (float(value) for value in _closed_form_fold(scene))
    located_fold = special_point_value(diagrams, "SN", "P101")
    frequency_text = f"frequency {frequency:g}"
    n_folds = float(sum(special_point.label == "P101" for special_point in diagrams.first.points("SN")))
    meets_own_condition, meets_paper_condition = (
        np.sin(2.0 * np.pi * damped_frequency / frequency) < 0,
        np.sin(np.pi * damped_frequency / frequency) > 0,
    )
    if meets_own_condition:
        claim_text = (
            f"P101 has an SN where sin(r T) < 0, {frequency_text}: at A_c = {fold_amplitude:.12g} (located minus"
            " closed form)"
        )
        yield additional_claim(
            "one wall", claim_text, (located_fold[0] - fold_amplitude, located_fold[1]), low=-TOLERANCE, high=TOLERANCE
        )
    else:
        claim_text = (
            f"P101 has no SN where sin(r T) > 0, {frequency_text} (number of them; the closed form's u is"
            f" {fold_speed:.3g})"
        )
        yield additional_claim("one wall", claim_text, (n_folds, 0.0), high=0.0)
    claim_verb = "has" if meets_paper_condition else "has no"
    reason = (
        "The condition has the form of (19) with another sign and twice the time: sin(r T) < 0, not sin(r T / 2) > 0."
    )
    claim_text = f'"the condition is the same as (19)": {frequency_text}, P101 {claim_verb} SN (number of them)'
    claimed_min_count, claimed_max_count = (1.0, np.inf) if meets_paper_condition else (-np.inf, 0.0)
    yield statement_claim(
        "one wall", claim_text, (n_folds, 0.0), low=claimed_min_count, high=claimed_max_count, reason=reason
    )


def _mirror_claims(scene_file, scene, diagram):
    """Yield the claim that P110 on a left wall is the mirror image of P101."""
    scene_param_values = (
        float(getattr(scene, parameter_name)) for parameter_name in ("amplitude", "frequency", "damping", "restitution")
    )
    mirror_scene = make_scene(*scene_param_values, (-float(scene.right.position), None))
    explore_table = scene_file.explore
    mirror_diagram = explore(
        mirror_scene, explore_table.parameter, explore_table.bounds, explore_table.max_period, explore_table.seed
    )
    fold_values = [special_point.value for special_point in diagram.points("SN") if special_point.label == "P101"]
    mirror_fold_values = [
        special_point.value for special_point in mirror_diagram.points("SN") if special_point.label == "P110"
    ]
    fold_difference = abs(fold_values[0] - mirror_fold_values[0]) if fold_values and mirror_fold_values else np.nan
    claim_text = f"P110 on a wall to the left has the SN of P101, frequency {float(scene.frequency):g} (difference)"
    yield additional_claim("one wall", claim_text, (fold_difference, ROUNDING), high=TOLERANCE)


def _moving_wall_fold_claim(scene_file, scene):
    """Return the claim that a moving wall is equivalent to a fixed wall with another drive amplitude."""
    wall_motion = Motion(*WALL_MOTION)
    scene_param_values = (
        float(getattr(scene, parameter_name)) for parameter_name in ("amplitude", "frequency", "damping", "restitution")
    )
    moving_scene = make_scene(*scene_param_values, (None, Wall(float(scene.right.position), motion=wall_motion)))
    located_fold = special_point_value(explore_twice(moving_scene, scene_file.explore), "SN", "P101")
    exact_fold_amplitude = closed_forms.moving_wall_amplitude(
        float(_closed_form_fold(scene)[0]), float(scene.frequency), float(scene.damping), wall_motion
    )
    claim_text = (
        f"a wall moving by {WALL_MOTION[0]:g} cos(omega t + {WALL_MOTION[1]:g}), frequency"
        f" {float(scene.frequency):g}: SN of "
        f"P101 at A = {exact_fold_amplitude:.12g} (located minus closed form)"
    )
    return additional_claim(
        "moving wall",
        claim_text,
        (located_fold[0] - exact_fold_amplitude, located_fold[1]),
        low=-TOLERANCE,
        high=TOLERANCE,
    )


def _figure_png(panel_results):
    figure, axes_grid = make_figure(1, len(panel_results), 2.4)
    for ax, (scene, diagram) in zip(axes_grid.flat, panel_results, strict=True):
        for branch in diagram.branches:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"$\\omega$ = {float(scene.frequency):g}", loc="left")
    trim_axis_labels(axes_grid, has_shared_ranges=False, max_ticks=4)
    add_figure_legend(figure, axes_grid, excluded_artist_ids=("branch",))
    return png_bytes(figure)
