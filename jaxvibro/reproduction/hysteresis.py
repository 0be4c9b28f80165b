"""Reproduce figure 2: hysteresis of sweeps at two frequencies, between symmetric and unequal walls."""

import numpy as np

from .. import plot
from ..studies.compute import run_studies
from .claim import number_claim, statement_claim
from .closed_forms import forced_motion
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes, trim_labels
from .special_points import explore_twice, special_value

PANEL_LETTERS = "abcd"
# Printed jumps up and down at the two frequencies, with walls at -1 and 1.
PRINTED_JUMPS = ("2.615", "0.40"), ("4.33", "0.65")
MOTION_TOLERANCE = 1e-6  # distance from the motion without impacts
LEG_TOLERANCE = 1e-3  # difference of two legs

CAPTION = (
    "x at phase 0 of the drive against its amplitude, in sweeps down and up, over the branches of periodic motions, "
    "between walls at -1 and 1 (above) and at -1.5 and 1 (below), at two frequencies."
)


def reproduce_figure(file, progress):
    """Reproduce figure 2 and its claims."""
    results = [run_studies(item, progress=progress) for item in panel_files(file)]
    loop_edges = [_loop_edges(item) for item in results]
    with figure_style():
        picture = _picture(results)
    claims = [
        claim
        for index, printed_jumps in enumerate(PRINTED_JUMPS)
        for claim in _jump_claims(results[index], loop_edges[index], printed_jumps)
    ]
    claims += [_wider_loop_claim(results[index + 2], loop_edges[index], loop_edges[index + 2]) for index in range(2)]
    return FigureResult(
        picture,
        CAPTION,
        tuple(claims),
        {f".{letter}": item.swept for letter, item in zip(PANEL_LETTERS, results, strict=True)},
    )


def _loop_edges(results):
    """Return (value, error) of the grazing of P100 and of the first saddle-node of P111."""
    diagrams = explore_twice(results.scene, results.file.explore, results.diagram)
    return special_value(diagrams, "GR", "P100"), special_value(diagrams, "SN", "P111")


def _jump_claims(results, loop_edges, printed_jumps):
    scene = results.scene
    frequency_text = f"frequency {float(scene.frequency):g}"
    sweep_jumps = [sweep_jump(results, leg) for leg in ("up", "down")]
    event_names = ("the grazing of P100", "the saddle-node of P111")
    for direction, loop_edge, event, printed_text, jump in zip(
        ("up", "down"), loop_edges, event_names, printed_jumps, sweep_jumps, strict=True
    ):
        reason = (
            f"It is {event}. Our sweep of {results.file.sweep.count} values with transients of"
            f" {results.file.sweep.settle} periods jumps between {jump[0]:.5g} and {jump[1]:.5g}, which depends on"
            " steps and transients."
        )
        yield number_claim("2a", f"jump {direction} at {frequency_text}", printed_text, loop_edge, reason)


def sweep_jump(results, leg):
    """Return the two consecutive values between which a leg changes from or to the motion without impacts.

    They are in the order of the sweep; nan if the leg does not change.
    """
    sweep, scene = results.swept.sel(leg=leg), results.scene
    values = sweep[sweep.attrs["swept"]].transpose("step", ...).values.ravel()
    frequency, damping = float(scene.frequency), float(scene.damping)
    coordinates = zip("xv", forced_motion(values, frequency, damping), strict=True)
    differences = np.stack(
        [abs(sweep[key].transpose("step", "period").values - reference[:, None]) for key, reference in coordinates]
    )
    (rows,) = np.nonzero(np.diff(differences.max(axis=(0, 2)) > MOTION_TOLERANCE * (1.0 + values)))
    return (values[rows[0]], values[rows[0] + 1]) if len(rows) else (np.nan, np.nan)


def loop_ranges(sweep):
    """Return the (low, high) of each range of values in which two legs of a sweep in opposite directions differ."""
    values = sweep[sweep.attrs["swept"]].transpose("step", "leg").values
    down_leg, up_leg = sweep["x"].transpose("leg", "step", "period").values
    differs = abs(up_leg - down_leg[::-1]).max(axis=1) > LEG_TOLERANCE
    edges = np.flatnonzero(np.diff(np.concatenate([[False], differs, [False]])))
    return [(values[start, 1], values[stop - 1, 1]) for start, stop in edges.reshape(-1, 2)]


def _wider_loop_claim(results, narrow_edges, wide_edges):
    """Return the claim that the interval with two motions is wider between unequal walls."""
    (wide_upper, wide_upper_error), (wide_lower, wide_lower_error) = wide_edges
    (narrow_upper, narrow_upper_error), (narrow_lower, narrow_lower_error) = narrow_edges
    difference = (
        (wide_upper - wide_lower) - (narrow_upper - narrow_lower),
        wide_upper_error + wide_lower_error + narrow_upper_error + narrow_lower_error,
    )
    loop_text = (
        f"the loop of P100 and P111 at frequency {float(results.scene.frequency):g}:"
        f" {wide_upper - wide_lower:.6g} here, "
        f"{narrow_upper - narrow_lower:.6g} there"
    )
    ranges_text = " and ".join(f"{lower:.4g} to {upper:.4g}" for lower, upper in loop_ranges(results.swept))
    reason = (
        f"P100 grazes at {wide_upper:.6g} here and {narrow_upper:.6g} there, P111 begins at {wide_lower:.6g} and"
        f" {narrow_lower:.6g}. The two sweeps "
        f"differ at {ranges_text}."
    )
    return statement_claim(
        "2b", f"hysteresis is wider than in 2a ({loop_text}; the difference)", difference, low=0.0, reason=reason
    )


def _picture(results):
    figure, axes_grid = make_figure(2, 2, 2.3)
    for ax, result, letter in zip(axes_grid.flat, results, PANEL_LETTERS, strict=True):
        plot.diagram(result.swept, "x", ax)
        for branch in result.diagram_branches:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"({letter}) $\\omega$ = {float(result.scene.frequency):g}", loc="left")
    trim_labels(axes_grid)
    add_legend(figure, axes_grid, excluded_gids=("branch",))
    return png_bytes(figure)
