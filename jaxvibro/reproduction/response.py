"""Reproduce figure 10: the frequency response between compliant walls, and the parameters that the paper omits."""

from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import msgspec
import numpy as np

from .. import plot
from ..branches.branch import Branch, Special
from ..branches.follow import follow
from ..branches.peaks import peak, peaks
from ..loci.point_continuation import parameter_gradient, prepare_point
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..plot.style import COLOURS
from ..scene.state import State
from . import fitting
from .attractor_checks import stable_labels_at
from .claim import number_claim, own_claim, statement_claim
from .closed_forms import forced_motion
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes, trim_labels
from .special_points import ROUNDING

STIFFNESSES = (10, 50)
PRINTED_FOLDS, PRINTED_GRAZING = ("1.48", "1.74"), "1.18"  # as printed in the paper
CONTACT_DAMPINGS = ("left.damping", "right.damping")  # gamma2
FIT_NAMES = ("amplitude", "damping", CONTACT_DAMPINGS)
LOWER_BOUNDS, UPPER_BOUNDS = (0.05, 0.0, 0.0), (2.0, 0.5, 1.0)  # of A, gamma, gamma2
FIT_STARTS = tuple(product((0.3, 0.6), (0.05, 0.2), (0.05, 0.4)))
N_SAMPLES = 12  # values of gamma on either side of the fit at which the slope of an SN is checked
GRAZING_FRACTION = 0.95  # relative to the gamma beyond which P100 does not graze and the SN does not exist
HALF_DIGIT = 0.005  # half a unit of the last printed digit
SOLUTION_TOLERANCE = 1e-8  # largest difference of equal solutions
FREQUENCY_OFFSET = 0.05  # from the frequency of a jump to one with a single attractor
STIFFNESS_SERIES = 10.0, 50.0, 250.0
TOP_FREQUENCIES = 1.2, 1.4  # on the top of the curves of all these stiffnesses

PEAK_LABEL = r"$\max|X|\,/\,d$"

CAPTION = (
    "The largest x on the orbits against the drive's frequency, A = {0:g}, gamma2 = {1:g}, gamma = {2:.6f} fitted to "
    "both saddle-nodes. P100 and P111, stable (solid) and unstable (dashed), for two stiffnesses of the walls. "
    "P111 has another saddle-node within 1e-4 of the upper grazing, below its marker."
)


class FrequencyResponse(NamedTuple):
    """Branches in the frequency, the highest saddle-node of P111 and the highest grazing of P100, None without one."""

    branches: tuple[Branch, ...]
    fold: Special | None
    grazing: Special | None


def reproduce_figure(file, progress):
    """Reproduce figure 10 and its claims."""
    scenes, table = [panel_file.scene.make() for panel_file in panel_files(file)], file.branch
    initial_responses = [frequency_response(scene, table) for scene in scenes]
    printed_folds = [float(item) for item in PRINTED_FOLDS]
    fold_points = [prepare_point(item.fold, ("damping",)) for item in initial_responses]
    joint_fit = fitting.fit_values(
        fold_points, printed_folds, [float(scenes[0].damping)], LOWER_BOUNDS[1], UPPER_BOUNDS[1]
    )
    gamma = float(joint_fit.values[0])
    responses = [frequency_response(scene.replace(damping=gamma), table) for scene in scenes]
    claims = [
        *_fit_claims(responses, joint_fit),
        *_single_fit_claims(fold_points, printed_folds),
        _grazing_claim(scenes[0]),
        *_three_parameter_claims(initial_responses, printed_folds),
    ]
    claims += [*_coexistence_claims(responses), _flat_top_claim(scenes[0].replace(damping=gamma), table)]
    caption = CAPTION.format(float(scenes[0].amplitude), float(scenes[0].left.damping), gamma)
    with figure_style():
        return FigureResult(_picture(scenes, responses), caption, tuple(claims))


def frequency_response(scene, table):
    """Return the `FrequencyResponse` of a scene by the [branch] table of a scene file, each branch up to its grazings.

    P100 is followed from both ends of the range, P111 from the frequency of the scene.
    """
    lower, upper = table.bounds
    branches = [_follow_p100(scene, frequency, table) for frequency in (lower, upper)]
    branches.append(_follow_p111(scene, table))
    branches = tuple(branch for branch in branches if branch is not None)
    impacting_branches = [branch for branch in branches if branch.segments[0].label != "P100"]
    folds = [point for branch in impacting_branches for point in branch.points("SN")]
    grazings = [point for branch in branches if branch not in impacting_branches for point in branch.points("GR")]
    highest_points = [max(points, key=lambda point: point.value, default=None) for points in (folds, grazings)]
    return FrequencyResponse(branches, *highest_points)


def _follow_p100(scene, frequency, table):
    """Return the branch of P100 from a frequency."""
    scene = scene.replace(frequency=frequency)
    start = State(*forced_motion(float(scene.amplitude), frequency, float(scene.damping)))
    orbit = find_orbit(scene, start, periods=1, settle=0)
    return follow(orbit, table.parameter, table.bounds, stop="GR", largest_step=table.largest_step)


def _follow_p111(scene, table):
    """Return the branch of P111; None if the motion does not approach it."""
    start = State(table.start.x, table.start.v)
    try:
        orbit = find_orbit(scene, start, periods=1, itinerary=("RL",), settle=table.settle)
    except OrbitError:
        return None
    return follow(orbit, table.parameter, table.bounds, stop="GR", largest_step=table.largest_step)


def _fit_claims(responses, joint_fit):
    """Yield the claims on the three numbers at the gamma that fits both saddle-nodes best."""
    gamma = float(joint_fit.values[0])
    gamma_text = f"gamma {gamma:.6f}, the least-squares fit to both SN"
    for stiffness, printed, point, response in zip(
        STIFFNESSES, PRINTED_FOLDS, joint_fit.points, responses, strict=True
    ):
        value = point.value, abs(point.value - response.fold.value) + ROUNDING
        yield number_claim("10", f"SN at k2 = {stiffness} ({gamma_text})", printed, value)
    value = responses[0].grazing.value, abs(responses[0].grazing.value - responses[1].grazing.value) + ROUNDING
    reason = "It depends on A and gamma alone, and no gamma gives 1.18: see below."
    yield number_claim("10", f"GR, of P100 ({gamma_text})", PRINTED_GRAZING, value, reason)


def _single_fit_claims(fold_points, printed_folds):
    """Yield the claims on the gamma of each saddle-node alone."""
    fits = [
        fitting.fit_values([estimate], [value], estimate.parameter_values, LOWER_BOUNDS[1], UPPER_BOUNDS[1])
        for estimate, value in zip(fold_points, printed_folds, strict=True)
    ]
    (estimate, other_estimate), (first_slope, second_slope) = (
        [float(fit.values[0]) for fit in fits],
        [fit.jacobian.item() for fit in fits],
    )
    tolerance = HALF_DIGIT / abs(first_slope) + HALF_DIGIT / abs(second_slope)
    text = (
        f"one gamma fits both SN: {estimate:.6f} from k2 = {STIFFNESSES[0]}, {other_estimate:.6f} from k2 ="
        f" {STIFFNESSES[1]} (difference)"
    )
    yield own_claim("10", text, (abs(estimate - other_estimate), ROUNDING), high=tolerance)
    for stiffness, point in zip(STIFFNESSES, fold_points, strict=True):
        max_slope, (lower, upper) = _slope_range(point)
        text = (
            f"no other gamma from {lower:g} to {upper:.3f} does: the frequency of the SN decreases with gamma,"
            f" k2 = {stiffness} (largest slope)"
        )
        yield own_claim("10", text, (max_slope, 1e-9), high=0.0)


def _slope_range(point):
    """Return (largest d value / d gamma, (low, high)) over the gammas at which P100 grazes and the point exists."""
    amplitude = float(point.problem.scene.amplitude)
    max_gamma = GRAZING_FRACTION * np.sqrt(0.5 * (1.0 - np.sqrt(1.0 - amplitude**2)))  # 2 gamma sqrt(1 - gamma^2) = A
    slope_points = [(float(parameter_gradient(point)[0]), float(point.parameter_values[0]))]
    for end_gamma in (LOWER_BOUNDS[1], max_gamma):
        current_point = point
        for gamma in np.linspace(float(point.parameter_values[0]), end_gamma, N_SAMPLES + 1)[1:]:
            (current_point,), _ = fitting.move_points([current_point], [gamma])
            slope_points.append((float(parameter_gradient(current_point)[0]), float(current_point.parameter_values[0])))
    gammas = [gamma for _, gamma in slope_points]
    return max(slope_points)[0], (min(gammas), max(gammas))


def _grazing_claim(scene):
    """Return the claim that a gamma gives the printed GR with the printed A: at most sqrt(1 + A), at gamma = 0."""
    amplitude = float(scene.amplitude)
    text = f"a GR at {PRINTED_GRAZING} is possible at A = {amplitude:g} (the highest for any gamma)"
    reason = f"It would need A of at least {float(PRINTED_GRAZING) ** 2 - 1.0:.4f}, were gamma zero."
    return statement_claim(
        "10", text, (np.sqrt(1.0 + amplitude), ROUNDING), low=float(PRINTED_GRAZING) - HALF_DIGIT, reason=reason
    )


def _three_parameter_claims(responses, printed_folds):
    """Yield the claims on A, gamma and gamma2 from the three printed numbers."""
    points = [
        *(prepare_point(item.fold, FIT_NAMES) for item in responses),
        prepare_point(responses[0].grazing, FIT_NAMES),
    ]
    targets = [*printed_folds, float(PRINTED_GRAZING)]
    fits = [fitting.fit_values(points, targets, start, LOWER_BOUNDS, UPPER_BOUNDS) for start in FIT_STARTS]
    best_fit = min(fits, key=lambda fit: abs(fit.misfits).max())
    uncertainties = abs(np.linalg.inv(best_fit.jacobian)) @ np.full(3, HALF_DIGIT)
    result_rows = zip(("A", "gamma", "gamma2"), best_fit.values, uncertainties, strict=True)
    values_text = ", ".join(
        f"{name} = {value:.6f} (digits: ± {uncertainty:.2g})" for name, value, uncertainty in result_rows
    )
    text = (
        f"all three numbers are reproduced by {values_text} (largest misfit; condition of the derivative"
        f" {best_fit.condition:.3g})"
    )
    yield own_claim("10", text, (float(abs(best_fit.misfits).max()), ROUNDING), high=1e-10)
    solutions = [fit.values for fit in fits if fit.converged and abs(fit.misfits).max() < SOLUTION_TOLERANCE]
    distinct_solutions = [
        item
        for index, item in enumerate(solutions)
        if all(abs(item - earlier).max() > SOLUTION_TOLERANCE for earlier in solutions[:index])
    ]
    text = (
        f"no other values do: {len(solutions)} of {len(fits)} initial guesses lead to a solution"
        " (number of distinct ones)"
    )
    yield own_claim("10", text, (float(len(distinct_solutions)), 0.0), low=1.0, high=1.0)


def _coexistence_claims(responses):
    """Yield the claims that two stable motions exist between grazing and saddle-node, and one on either side."""
    for stiffness, response in zip(STIFFNESSES, responses, strict=True):
        lower, upper = response.grazing.value, response.fold.value
        expected_labels = [
            (frequency, ["P100", "P111"]) for frequency in np.linspace(lower, upper, N_SAMPLES + 2)[1:-1]
        ]
        expected_labels += [(lower - FREQUENCY_OFFSET, ["P111"]), (upper + FREQUENCY_OFFSET, ["P100"])]
        n_wrong = sum(
            sorted(stable_labels_at(response.branches, frequency)) != labels for frequency, labels in expected_labels
        )
        text = (
            f"k2 = {stiffness}: P100 and P111 are stable from omega {lower:.6g}, where a downward sweep jumps, to"
            f" {upper:.6g}, where an "
            f"upward one drops from x = {peak(response.fold.orbit):.4g}; one of them outside (exceptions among"
            f" {len(expected_labels)} frequencies)"
        )
        yield own_claim("10", text, (float(n_wrong), 0.0), high=0.0)


def _flat_top_claim(scene, table):
    """Return the claim that the top of the curve becomes flatter for stiffer walls."""
    table, rises = msgspec.structs.replace(table, bounds=TOP_FREQUENCIES), []
    for stiffness in STIFFNESS_SERIES:
        stiff_scene = scene.replace(**{"left.stiffness": stiffness, "right.stiffness": stiffness})
        peak_values = peaks(_follow_p111(stiff_scene, table))
        rises.append(abs(float(peak_values[-1] - peak_values[0])))
    rises_text = ", ".join(
        f"{rise:.4g} at k2 = {stiffness:g}" for rise, stiffness in zip(rises, STIFFNESS_SERIES, strict=True)
    )
    lower, upper = TOP_FREQUENCIES
    text = (
        f"the top becomes flat as k2 grows: from omega {lower:g} to {upper:g} the largest x rises by {rises_text}"
        " (largest ratio)"
    )
    ratios = [after / before for before, after in pairwise(rises)]
    return own_claim("10", text, (max(ratios), SOLUTION_TOLERANCE), high=1.0)


def select_special_points(branch):
    """Return a branch with only its SN and GR, for a figure that shows no others."""
    return replace(branch, special=tuple(special for special in branch.special if special.kind in ("SN", "GR")))


def _picture(scenes, responses):
    figure, axes_grid = make_figure(2, 1, 2.7)
    for (ax,), scene, response in zip(axes_grid, scenes, responses, strict=True):
        for branch in reversed(response.branches):  # P100 last: its GR hides an SN at nearly the same point
            plot.branch(
                select_special_points(branch), "peak", ax, COLOURS[2 if branch.segments[0].label == "P100" else 7]
            )
        ax.set_title(f"$k_2$ = {float(scene.left.stiffness):g}", loc="left")
        ax.set_ylim(0.0)
    trim_labels(axes_grid, max_ticks=9)
    for (ax,) in axes_grid:
        ax.set_ylabel(PEAK_LABEL)
    add_legend(figure, axes_grid, columns=3)
    return png_bytes(figure)
