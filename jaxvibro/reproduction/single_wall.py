"""Check the orbits P101 and P110 with one wall, fixed or moving, against closed forms and a remark of the paper."""

import numpy as np

from .. import plot
from ..branches.explore import explore
from ..scene.scene import make_scene
from ..scene.wall import Motion, Wall
from . import closed_forms
from .claim import own_claim, statement_claim
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes, trim_labels
from .special_points import ROUNDING, explore_twice, special_value

WALL_MOTION = (0.1, 0.5)  # amplitude and phase of the moving wall
TOLERANCE = 1e-9

CAPTION = (
    "x at phase 0 of the drive against its amplitude, one wall, at three frequencies: P101 begins in a saddle-node "
    "only where sin(r T) < 0."
)


def reproduce_figure(file, progress):
    """Reproduce the diagrams with one wall and their claims."""
    results, claims = [], []
    for panel_file in panel_files(file):
        scene = panel_file.scene.make()
        diagrams = explore_twice(scene, panel_file.explore)
        results.append((scene, diagrams.first))
        claims += _fold_claims(scene, diagrams)
    claims += [*_mirror_claims(file, *results[0]), _moving_wall_claim(file, results[0][0])]
    with figure_style():
        return FigureResult(_picture(results), CAPTION, tuple(claims))


def _exact_fold(scene):
    wall_position = float(scene.right.position)
    return closed_forms.single_fold(
        float(scene.frequency), float(scene.damping), float(scene.restitution), wall_position
    )


def _fold_claims(scene, diagrams):
    """Yield the claims on the saddle-node of P101, by its own condition and by that of (19)."""
    frequency, damped_frequency = float(scene.frequency), float(np.sqrt(1.0 - float(scene.damping) ** 2))
    fold_amplitude, speed = (float(value) for value in _exact_fold(scene))
    located_fold = special_value(diagrams, "SN", "P101")
    frequency_text = f"frequency {frequency:g}"
    n_folds = float(sum(special.label == "P101" for special in diagrams.first.points("SN")))
    own_condition, paper_condition = (
        np.sin(2.0 * np.pi * damped_frequency / frequency) < 0,
        np.sin(np.pi * damped_frequency / frequency) > 0,
    )
    if own_condition:
        text = (
            f"P101 has an SN where sin(r T) < 0, {frequency_text}: at A_c = {fold_amplitude:.12g} (located minus"
            " closed form)"
        )
        yield own_claim(
            "one wall", text, (located_fold[0] - fold_amplitude, located_fold[1]), low=-TOLERANCE, high=TOLERANCE
        )
    else:
        text = (
            f"P101 has no SN where sin(r T) > 0, {frequency_text} (number of them; the closed form's u is {speed:.3g})"
        )
        yield own_claim("one wall", text, (n_folds, 0.0), high=0.0)
    expectation = "has" if paper_condition else "has no"
    reason = (
        "The condition has the form of (19) with another sign and twice the time: sin(r T) < 0, not sin(r T / 2) > 0."
    )
    text = f'"the condition is the same as (19)": {frequency_text}, P101 {expectation} SN (number of them)'
    lower, upper = (1.0, np.inf) if paper_condition else (-np.inf, 0.0)
    yield statement_claim("one wall", text, (n_folds, 0.0), low=lower, high=upper, reason=reason)


def _mirror_claims(file, scene, diagram):
    """Yield the claim that P110 on a left wall is the mirror image of P101."""
    params = (float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution"))
    mirror_scene = make_scene(*params, (-float(scene.right.position), None))
    table = file.explore
    mirror_diagram = explore(mirror_scene, table.parameter, table.bounds, table.max_period, table.seed)
    fold_values = [special.value for special in diagram.points("SN") if special.label == "P101"]
    mirror_fold_values = [special.value for special in mirror_diagram.points("SN") if special.label == "P110"]
    difference = abs(fold_values[0] - mirror_fold_values[0]) if fold_values and mirror_fold_values else np.nan
    text = f"P110 on a wall to the left has the SN of P101, frequency {float(scene.frequency):g} (difference)"
    yield own_claim("one wall", text, (difference, ROUNDING), high=TOLERANCE)


def _moving_wall_claim(file, scene):
    """Return the claim that a wall moving with the drive is equivalent to a fixed wall under another drive."""
    motion = Motion(*WALL_MOTION)
    params = (float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution"))
    moving_scene = make_scene(*params, (None, Wall(float(scene.right.position), motion=motion)))
    located_fold = special_value(explore_twice(moving_scene, file.explore), "SN", "P101")
    exact_amplitude = closed_forms.equivalent_amplitude(
        float(_exact_fold(scene)[0]), float(scene.frequency), float(scene.damping), motion
    )
    text = (
        f"a wall moving by {WALL_MOTION[0]:g} cos(omega t + {WALL_MOTION[1]:g}), frequency"
        f" {float(scene.frequency):g}: SN of "
        f"P101 at A = {exact_amplitude:.12g} (located minus closed form)"
    )
    return own_claim(
        "moving wall", text, (located_fold[0] - exact_amplitude, located_fold[1]), low=-TOLERANCE, high=TOLERANCE
    )


def _picture(results):
    figure, axes_grid = make_figure(1, len(results), 2.4)
    for ax, (scene, diagram) in zip(axes_grid.flat, results, strict=True):
        for branch in diagram.branches:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"$\\omega$ = {float(scene.frequency):g}", loc="left")
    trim_labels(axes_grid, shared=False, max_ticks=4)
    add_legend(figure, axes_grid, excluded_gids=("branch",))
    return png_bytes(figure)
