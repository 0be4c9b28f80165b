"""Reproduce figures 10 and 11: the frequency response between compliant walls."""

from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import msgspec
import numpy as np

from .. import plot
from ..branches.branch import Branch, Special
from ..branches.follow import follow
from ..branches.peaks import peak, peaks
from ..loci.point_continuation import continue_to_values, make_continued_point, value_gradient
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..plot.style import COLOURS, SYMBOLS
from ..scene.state import State
from .attractor_checks import stable_labels_at
from .claim import additional_claim, number_claim, statement_claim
from .closed_forms import forced_motion_state, grazing_amplitude
from .figure_panels import FigureResult, add_figure_legend, make_figure, panel_scene_files, png_bytes, trim_axis_labels
from .special_points import ROUNDING, fit_parameters, move_continued_points

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

CAPTION_10 = (
    "The largest x on the orbits against the drive's frequency, A = {0:g}, gamma2 = {1:g}, gamma = {2:.6f} fitted to "
    "both saddle-nodes. P100 and P111, stable (solid) and unstable (dashed), for two stiffnesses of the walls. "
    "P111 has another saddle-node within 1e-4 of the upper grazing, below its marker."
)


class FrequencyResponse(NamedTuple):
    """Frequency response of a scene.

    Attributes
    ----------
    branches : tuple of Branch
        Branches of P100 and P111 in the frequency.
    fold : Special or None
        Saddle-node of P111 with the highest frequency; None if there is none.
    grazing : Special or None
        Grazing of P100 with the highest frequency; None if there is none.
    """

    branches: tuple[Branch, ...]
    fold: Special | None
    grazing: Special | None


def reproduce_figure_10(scene_file, show_progress):
    """Reproduce figure 10 and its claims."""
    panel_scenes, branch_table = (
        [panel_scene_file.scene.make() for panel_scene_file in panel_scene_files(scene_file)],
        scene_file.branch,
    )
    initial_responses = [frequency_response(scene, branch_table) for scene in panel_scenes]
    printed_fold_frequencies = [float(printed_number) for printed_number in PRINTED_FOLDS]
    continued_folds = [make_continued_point(response.fold, ("damping",)) for response in initial_responses]
    joint_fit = fit_parameters(
        continued_folds, printed_fold_frequencies, [float(panel_scenes[0].damping)], LOWER_BOUNDS[1], UPPER_BOUNDS[1]
    )
    gamma = float(joint_fit.values[0])
    responses = [frequency_response(scene.replace(damping=gamma), branch_table) for scene in panel_scenes]
    claims = [
        *_joint_fit_claims(responses, joint_fit),
        *_single_fit_claims(continued_folds, printed_fold_frequencies),
        _grazing_claim(panel_scenes[0]),
        *_three_parameter_claims(initial_responses, printed_fold_frequencies),
    ]
    claims += [*_coexistence_claims(responses), _flat_top_claim(panel_scenes[0].replace(damping=gamma), branch_table)]
    caption = CAPTION_10.format(float(panel_scenes[0].amplitude), float(panel_scenes[0].left.damping), gamma)
    return FigureResult(_figure_10_png(panel_scenes, responses), caption, tuple(claims))


def frequency_response(scene, branch_table):
    """Return the `FrequencyResponse` of a scene, with the settings of a [branch] table.

    P100 is continued from both ends of the frequency range, and P111 from the frequency of the scene. Each branch ends
    at its grazings.
    """
    lower_frequency, upper_frequency = branch_table.bounds
    branches = [
        _follow_p100(scene, start_frequency, branch_table) for start_frequency in (lower_frequency, upper_frequency)
    ]
    branches.append(_follow_p111(scene, branch_table))
    branches = tuple(branch for branch in branches if branch is not None)
    impacting_branches = [branch for branch in branches if branch.segments[0].label != "P100"]
    folds = [special_point for branch in impacting_branches for special_point in branch.points("SN")]
    grazings = [
        special_point
        for branch in branches
        if branch not in impacting_branches
        for special_point in branch.points("GR")
    ]
    highest_special_points = [
        max(special_points, key=lambda special_point: special_point.value, default=None)
        for special_points in (folds, grazings)
    ]
    return FrequencyResponse(branches, *highest_special_points)


def _follow_p100(scene, start_frequency, branch_table):
    """Return the branch of P100 that starts at a frequency."""
    scene = scene.replace(frequency=start_frequency)
    initial_state = State(*forced_motion_state(float(scene.amplitude), start_frequency, float(scene.damping)))
    orbit = find_orbit(scene, initial_state, periods=1, settle=0)
    return follow(orbit, branch_table.parameter, branch_table.bounds, stop="GR", largest_step=branch_table.largest_step)


def _follow_p111(scene, branch_table):
    """Return the branch of P111; None if the motion from the start of the [branch] table does not approach P111."""
    initial_state = State(branch_table.start.x, branch_table.start.v)
    try:
        orbit = find_orbit(scene, initial_state, periods=1, itinerary=("RL",), settle=branch_table.settle)
    except OrbitError:
        return None
    return follow(orbit, branch_table.parameter, branch_table.bounds, stop="GR", largest_step=branch_table.largest_step)


def _joint_fit_claims(responses, joint_fit):
    """Yield the claims on the printed saddle-nodes and grazing, at the gamma that fits both saddle-nodes best."""
    gamma = float(joint_fit.values[0])
    gamma_text = f"gamma {gamma:.6f}, the least-squares fit to both SN"
    for stiffness, printed_number, continued_fold, response in zip(
        STIFFNESSES, PRINTED_FOLDS, joint_fit.points, responses, strict=True
    ):
        value_and_error = continued_fold.value, abs(continued_fold.value - response.fold.value) + ROUNDING
        yield number_claim("10", f"SN at k2 = {stiffness} ({gamma_text})", printed_number, value_and_error)
    value_and_error = (
        responses[0].grazing.value,
        abs(responses[0].grazing.value - responses[1].grazing.value) + ROUNDING,
    )
    reason = "It depends on A and gamma alone, and no gamma gives 1.18: see below."
    yield number_claim("10", f"GR, of P100 ({gamma_text})", PRINTED_GRAZING, value_and_error, reason)


def _single_fit_claims(continued_folds, printed_fold_frequencies):
    """Yield the claims on the values of gamma that are fitted to each saddle-node alone."""
    fits = [
        fit_parameters(
            [continued_fold], [printed_frequency], continued_fold.parameter_values, LOWER_BOUNDS[1], UPPER_BOUNDS[1]
        )
        for continued_fold, printed_frequency in zip(continued_folds, printed_fold_frequencies, strict=True)
    ]
    (first_gamma, second_gamma), (first_fold_slope, second_fold_slope) = (
        [float(fit.values[0]) for fit in fits],
        [fit.jacobian.item() for fit in fits],
    )
    gamma_tolerance = HALF_DIGIT / abs(first_fold_slope) + HALF_DIGIT / abs(second_fold_slope)
    claim_text = (
        f"one gamma fits both SN: {first_gamma:.6f} from k2 = {STIFFNESSES[0]}, {second_gamma:.6f} from k2 ="
        f" {STIFFNESSES[1]} (difference)"
    )
    yield additional_claim("10", claim_text, (abs(first_gamma - second_gamma), ROUNDING), high=gamma_tolerance)
    for stiffness, continued_fold in zip(STIFFNESSES, continued_folds, strict=True):
        max_slope, (lower_gamma, upper_gamma) = _max_fold_slope(continued_fold)
        claim_text = (
            f"no other gamma from {lower_gamma:g} to {upper_gamma:.3f} does: the frequency of the SN decreases"
            " with gamma,"
            f" k2 = {stiffness} (largest slope)"
        )
        yield additional_claim("10", claim_text, (max_slope, 1e-9), high=0.0)


def _max_fold_slope(continued_fold):
    """Return (largest derivative of the saddle-node's frequency with respect to gamma, (lower, upper) gamma).

    The derivative is computed at values of gamma between these bounds, at which P100 grazes and the saddle-node exists.
    """
    amplitude = float(continued_fold.problem.scene.amplitude)
    max_gamma = GRAZING_FRACTION * np.sqrt(0.5 * (1.0 - np.sqrt(1.0 - amplitude**2)))  # 2 gamma sqrt(1 - gamma^2) = A
    slope_gamma_pairs = [(float(value_gradient(continued_fold)[0]), float(continued_fold.parameter_values[0]))]
    for end_gamma in (LOWER_BOUNDS[1], max_gamma):
        current_fold = continued_fold
        for gamma in np.linspace(float(continued_fold.parameter_values[0]), end_gamma, N_SAMPLES + 1)[1:]:
            (current_fold,), _ = move_continued_points([current_fold], [gamma])
            slope_gamma_pairs.append((float(value_gradient(current_fold)[0]), float(current_fold.parameter_values[0])))
    gammas = [gamma for _, gamma in slope_gamma_pairs]
    return max(slope_gamma_pairs)[0], (min(gammas), max(gammas))


def _grazing_claim(scene):
    """Return the claim that some gamma gives the printed GR at the printed A.

    The highest frequency of a GR is sqrt(1 + A), at gamma = 0.
    """
    amplitude = float(scene.amplitude)
    claim_text = f"a GR at {PRINTED_GRAZING} is possible at A = {amplitude:g} (the highest for any gamma)"
    reason = f"It would need A of at least {float(PRINTED_GRAZING) ** 2 - 1.0:.4f}, were gamma zero."
    return statement_claim(
        "10", claim_text, (np.sqrt(1.0 + amplitude), ROUNDING), low=float(PRINTED_GRAZING) - HALF_DIGIT, reason=reason
    )


def _three_parameter_claims(responses, printed_fold_frequencies):
    """Yield the claims on A, gamma and gamma2, fitted to the three printed frequencies."""
    continued_points = [
        *(make_continued_point(response.fold, FIT_NAMES) for response in responses),
        make_continued_point(responses[0].grazing, FIT_NAMES),
    ]
    target_frequencies = [*printed_fold_frequencies, float(PRINTED_GRAZING)]
    fits = [
        fit_parameters(continued_points, target_frequencies, initial_parameters, LOWER_BOUNDS, UPPER_BOUNDS)
        for initial_parameters in FIT_STARTS
    ]
    best_fit = min(fits, key=lambda fit: abs(fit.misfits).max())
    digit_uncertainties = abs(np.linalg.inv(best_fit.jacobian)) @ np.full(3, HALF_DIGIT)
    parameter_rows = zip(("A", "gamma", "gamma2"), best_fit.values, digit_uncertainties, strict=True)
    values_text = ", ".join(
        f"{parameter_name} = {parameter_value:.6f} (digits: ± {digit_uncertainty:.2g})"
        for parameter_name, parameter_value, digit_uncertainty in parameter_rows
    )
    claim_text = (
        f"all three numbers are reproduced by {values_text} (largest misfit; condition of the derivative"
        f" {best_fit.condition_number:.3g})"
    )
    yield additional_claim("10", claim_text, (float(abs(best_fit.misfits).max()), ROUNDING), high=1e-10)
    solutions = [fit.values for fit in fits if fit.converged and abs(fit.misfits).max() < SOLUTION_TOLERANCE]
    distinct_solutions = [
        solution
        for index, solution in enumerate(solutions)
        if all(abs(solution - earlier_solution).max() > SOLUTION_TOLERANCE for earlier_solution in solutions[:index])
    ]
    claim_text = (
        f"no other values do: {len(solutions)} of {len(fits)} initial guesses lead to a solution"
        " (number of distinct ones)"
    )
    yield additional_claim("10", claim_text, (float(len(distinct_solutions)), 0.0), low=1.0, high=1.0)


def _coexistence_claims(responses):
    """Yield the claims that two stable motions exist between grazing and saddle-node, and one outside."""
    for stiffness, response in zip(STIFFNESSES, responses, strict=True):
        lower_frequency, upper_frequency = response.grazing.value, response.fold.value
        expected_by_frequency = [
            (frequency, ["P100", "P111"])
            for frequency in np.linspace(lower_frequency, upper_frequency, N_SAMPLES + 2)[1:-1]
        ]
        expected_by_frequency += [
            (lower_frequency - FREQUENCY_OFFSET, ["P111"]),
            (upper_frequency + FREQUENCY_OFFSET, ["P100"]),
        ]
        n_exceptions = sum(
            sorted(stable_labels_at(response.branches, frequency)) != expected_labels
            for frequency, expected_labels in expected_by_frequency
        )
        claim_text = (
            f"k2 = {stiffness}: P100 and P111 are stable from omega {lower_frequency:.6g}, where a downward sweep"
            " jumps, to"
            f" {upper_frequency:.6g}, where an "
            f"upward one drops from x = {peak(response.fold.orbit):.4g}; one of them outside (exceptions among"
            f" {len(expected_by_frequency)} frequencies)"
        )
        yield additional_claim("10", claim_text, (float(n_exceptions), 0.0), high=0.0)


def _flat_top_claim(scene, branch_table):
    """Return the claim that the top of the response curve becomes flatter for stiffer walls."""
    branch_table, rises_over_frequency = msgspec.structs.replace(branch_table, bounds=TOP_FREQUENCIES), []
    for stiffness in STIFFNESS_SERIES:
        stiff_scene = scene.replace(**{"left.stiffness": stiffness, "right.stiffness": stiffness})
        peak_values = peaks(_follow_p111(stiff_scene, branch_table))
        rises_over_frequency.append(abs(float(peak_values[-1] - peak_values[0])))
    rises_text = ", ".join(
        f"{rise_over_frequency:.4g} at k2 = {stiffness:g}"
        for rise_over_frequency, stiffness in zip(rises_over_frequency, STIFFNESS_SERIES, strict=True)
    )
    lower_frequency, upper_frequency = TOP_FREQUENCIES
    claim_text = (
        f"the top becomes flat as k2 grows: from omega {lower_frequency:g} to {upper_frequency:g} the largest x"
        f" rises by {rises_text}"
        " (largest ratio)"
    )
    rise_ratios = [next_rise / previous_rise for previous_rise, next_rise in pairwise(rises_over_frequency)]
    return additional_claim("10", claim_text, (max(rise_ratios), SOLUTION_TOLERANCE), high=1.0)


def keep_folds_and_grazings(branch):
    """Return a branch with only the special points SN and GR."""
    return replace(
        branch, special=tuple(special_point for special_point in branch.special if special_point.kind in ("SN", "GR"))
    )


def _figure_10_png(panel_scenes, responses):
    figure, axes_grid = make_figure(2, 1, 2.7)
    for (ax,), scene, response in zip(axes_grid, panel_scenes, responses, strict=True):
        for branch in reversed(response.branches):  # P100 last: its GR hides an SN at nearly the same point
            plot.branch(
                keep_folds_and_grazings(branch), "peak", ax, COLOURS[2 if branch.segments[0].label == "P100" else 7]
            )
        ax.set_title(f"$k_2$ = {float(scene.left.stiffness):g}", loc="left")
        ax.set_ylim(0.0)
    trim_axis_labels(axes_grid, max_ticks=9)
    for (ax,) in axes_grid:
        ax.set_ylabel(PEAK_LABEL)
    add_figure_legend(figure, axes_grid, n_columns=3)
    return png_bytes(figure)


CURVE_COLOURS = tuple(COLOURS[k] for k in (0, 5, 7, 3))
N_CURVE_POINTS = 40  # points of the curve of the saddle-node
LOWEST_AMPLITUDE = 0.155  # start of this curve; P100 grazes above 2 gamma sqrt(1 - gamma^2) = 0.1518

CAPTION_11 = (
    "Above, the largest x on P100 and P111 against the drive frequency at four amplitudes; below, the amplitudes of "
    "the saddle-node of P111 and of the grazing of P100. P100 and P111 coexist between them."
)


def reproduce_figure_11(scene_file, show_progress):
    """Reproduce figure 11; the paper makes no claims about it."""
    scene_responses = [
        (panel_scene_file.scene.make(), frequency_response(panel_scene_file.scene.make(), scene_file.branch))
        for panel_scene_file in panel_scene_files(scene_file)
    ]
    return FigureResult(_figure_11_png(scene_file, scene_responses), CAPTION_11, ())


def trace_special_point(special_point, amplitudes):
    """Continue a special point in the amplitude and return the curve as (frequencies, amplitudes).

    The curve ends at the last of the `amplitudes` at which the special point exists.
    """
    continued_point, curve_points = make_continued_point(special_point, ("amplitude",)), []
    for amplitude in amplitudes:
        continued_point, move_fraction = continue_to_values(continued_point, [amplitude])
        if move_fraction < 1.0:
            break
        curve_points.append((continued_point.value, amplitude))
    return np.array(curve_points).T


def _figure_11_png(scene_file, scene_responses):
    figure, ((upper_ax,), (lower_ax,)) = make_figure(2, 1, 2.9)
    scene_folds = [(scene, response.fold) for scene, response in scene_responses if response.fold is not None]
    for colour, (scene, response) in zip(CURVE_COLOURS, scene_responses, strict=True):
        for branch in reversed(response.branches):
            plot.branch(keep_folds_and_grazings(branch), "peak", upper_ax, colour)
        lower_ax.axhline(float(scene.amplitude), color=colour, linewidth=0.8)
        upper_ax.plot([], [], color=colour, label=f"{SYMBOLS['amplitude']} = {float(scene.amplitude):g}")
    upper_ax.set(ylim=(0.0, None))
    scene, fold_point = scene_folds[0]
    start_amplitude, max_amplitude = (
        float(scene.amplitude),
        1.25 * max(float(scene.amplitude) for scene, _ in scene_responses),
    )
    lower_curve, upper_curve = (
        trace_special_point(fold_point, np.linspace(start_amplitude, end_amplitude, N_CURVE_POINTS))
        for end_amplitude in (LOWEST_AMPLITUDE, max_amplitude)
    )
    lower_ax.plot(*np.hstack([lower_curve[:, ::-1], upper_curve]), color="black", label="saddle-node of P111")
    grazing_frequencies = np.linspace(*scene_file.branch.bounds, 400)
    lower_ax.plot(
        grazing_frequencies,
        grazing_amplitude(grazing_frequencies, float(scene.damping)),
        color="black",
        linestyle=":",
        label="grazing of P100",
    )
    lower_ax.set(
        xlim=upper_ax.get_xlim(), ylim=(0.0, max_amplitude), xlabel=upper_ax.get_xlabel(), ylabel="drive amplitude $A$"
    )
    axes_grid = np.array([[upper_ax], [lower_ax]])
    trim_axis_labels(axes_grid, max_ticks=9)
    upper_ax.set_ylabel(PEAK_LABEL)
    lower_ax.set_ylabel("$A$")
    add_figure_legend(figure, axes_grid, n_columns=3, excluded_artist_ids=("branch",))
    return png_bytes(figure)
