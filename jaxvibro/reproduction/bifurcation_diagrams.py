"""Reproduce figures 4, 6 and 7: bifurcation diagrams against the amplitude, by sweeps and continuation."""

import math
from itertools import combinations

import numpy as np

from .. import plot
from ..attractors.find import find_attractors
from ..branches.explore import explore
from ..studies.results_dataset import make_results_dataset
from ..studies.scene_file_studies import run_studies
from .attractor_checks import basin_shares_text, crossing_rows, largest_exponent, locate_chaos_onset, stable_labels_at
from .claim import additional_claim, number_claim, statement_claim
from .figure_panels import FigureResult, add_figure_legend, make_figure, png_bytes, trim_axis_labels
from .special_points import ROUNDING, explore_twice, nearest_special_point, neighbour_labels, special_point_value

N_STARTS = 100
N_AMPLITUDES = 25  # amplitudes at which stable motions are counted
GRAZING_RANGE, MAX_PERIODS = 0.05, 8  # search range of grazings: distance in amplitude, and largest period
# Fraction of the special points in the lower panel, and margin relative to its range.
CROWD_SHARE, RANGE_MARGIN = 2.0 / 3.0, 0.05
CAPTION = (
    "x and v at phase 0 of the drive against its amplitude: sweeps down and up (dots), and all periodic motions; "
    "below, x in the range of most special points."
)
TURN_NOTE = "This branch turns at the computed value and does not exist below it."


def reproduce_figure_4(scene_file, show_progress):
    """Reproduce figure 4 and its claims."""
    study_results, diagram_with_check = _results_and_diagrams(scene_file, show_progress)
    diagram, birth_value, doubling_value = (
        diagram_with_check.first,
        special_point_value(diagram_with_check, "SN", "P112"),
        special_point_value(diagram_with_check, "PD", "P112"),
    )
    grazing_value = special_point_value(diagram_with_check, "GR", "P100")
    claims = [
        number_claim("4", "SN1, where P111 begins", "0.5", special_point_value(diagram_with_check, "SN", "P111")),
        number_claim("4", "GB1, where P100 grazes", "3.41", grazing_value),
        number_claim(
            "4",
            "SB, where P111 loses its symmetry",
            "3.45",
            special_point_value(diagram_with_check, "SB"),
            _stability_note(diagram, 3.45),
        ),
        number_claim("4", "SN2, where P112 and P121 are born", "4.51", birth_value, TURN_NOTE),
        number_claim("4", "PD of P112 and P121", "4.735", doubling_value, _stability_note(diagram, 4.735, "P112")),
        _four_motions_claim(diagram, birth_value[0], doubling_value[0]),
        number_claim(
            "4",
            "asymmetric P111 ends by grazing",
            "5.215",
            special_point_value(diagram_with_check, "GR", "P111", target_value=5.215),
            _stability_note(diagram, 5.215),
        ),
        *_chaos_claims("4", study_results.scene, "5.24", grazing_value[0]),
        _pair_grazing_claim(study_results.scene, diagram_with_check, "5.42", 3),
    ]
    return _figure_result(study_results, claims)


def _four_motions_claim(diagram, lower_amplitude, upper_amplitude):
    """Return the claim that four stable motions exist between the saddle-node and the period doubling of P112."""
    labels_per_amplitude = [
        stable_labels_at(diagram.branches, amplitude)
        for amplitude in np.linspace(lower_amplitude, upper_amplitude, N_AMPLITUDES + 2)[1:-1]
    ]
    motion_counts = [len(amplitude_labels) for amplitude_labels in labels_per_amplitude]
    labels_text = " or ".join(
        sorted({", ".join(sorted(amplitude_labels)) for amplitude_labels in labels_per_amplitude})
    )
    count_with_error = 0.5 * (max(motion_counts) + min(motion_counts)), 0.5 * (max(motion_counts) - min(motion_counts))
    claim_text = f"four motions are stable between SN2 and PD (at {N_AMPLITUDES} amplitudes: {labels_text})"
    return statement_claim("4", claim_text, count_with_error, low=4.0, high=4.0)


def _pair_grazing_claim(scene, diagram_with_check, printed_number, n_periods):
    """Return the claim that a pair of orbits of `n_periods` drive periods grazes at the printed amplitude.

    The reason of the claim names the nearest grazing of all orbits of up to `MAX_PERIODS` drive periods.
    """
    printed_value = float(printed_number)
    local_diagram = explore(
        scene, "amplitude", (printed_value - GRAZING_RANGE, printed_value + GRAZING_RANGE), MAX_PERIODS
    )
    claimed_grazing = nearest_special_point(diagram_with_check.first, "GR", printed_value, n_periods=n_periods)
    nearest_grazings = [
        special_point
        for special_point in (nearest_special_point(local_diagram, "GR", printed_value), claimed_grazing)
        if special_point is not None
    ]
    nearest_grazing = min(nearest_grazings, key=lambda special_point: abs(special_point.value - printed_value))
    nearest_labels = [
        special_point.label
        for special_point in local_diagram.points("GR")
        if abs(special_point.value - nearest_grazing.value) <= ROUNDING * abs(nearest_grazing.value)
    ]
    birth_values = [
        special_point.value
        for special_point in local_diagram.points("SN")
        if special_point.label == nearest_grazing.label and special_point.value < nearest_grazing.value
    ]
    birth_text = f", born in an SN at {max(birth_values):.9g}," if birth_values else ""
    reason = (
        f"The nearest grazing of orbits of up to {MAX_PERIODS} periods is that of"
        f" {' and '.join(nearest_labels or [nearest_grazing.label])}, of "
        f"period {len(nearest_grazing.itinerary)}{birth_text} at {nearest_grazing.value:.9g}."
    )
    if claimed_grazing is not None:
        reason += f" That of period {n_periods} belongs to {claimed_grazing.label}, at {claimed_grazing.value:.9g}."
    claim_text = f"GB2, where a period-{n_periods} pair grazes"
    return number_claim(
        "4",
        claim_text,
        printed_number,
        special_point_value(diagram_with_check, "GR", target_value=printed_value, n_periods=n_periods),
        reason,
    )


def _stability_note(diagram, amplitude, orbit_label="P111"):
    """Return the note that an orbit with a label is stable at an amplitude, with the bound on its multipliers.

    The bound is the largest magnitude of the multipliers at the neighbouring points of the branch. If several orbits
    have the label, the smallest bound is used. The stability itself is not checked.
    """
    multiplier_magnitudes = [
        abs(branch.multipliers[row : row + 2]).max()
        for branch in diagram.branches
        for segment in branch.segments
        if segment.label == orbit_label
        for row in crossing_rows(branch, segment, amplitude)
    ]
    return (
        f"At {amplitude:g} {orbit_label} is still stable: its multipliers there are at most"
        f" {min(multiplier_magnitudes, default=np.nan):.3f}."
    )


SPECIAL_POINTS = {
    "SN of P111": ("SN", "P111"),
    "GR of P100": ("GR", "P100"),
    "SB": ("SB", None),
    "SN of P112": ("SN", "P112"),
    "PD of P112": ("PD", "P112"),
    "GR of P111": ("GR", "P111"),
}


def reproduce_figure_6(scene_file, slower_scene_file, show_progress):
    """Reproduce figure 6 and its claims.

    `slower_scene_file` is the scene file of figure 4, with which the claims compare figure 6.
    """
    study_results, diagram_with_check = _results_and_diagrams(scene_file, show_progress)
    slower_with_check = explore_twice(slower_scene_file.scene.make(), slower_scene_file.explore)
    faster_values, slower_values = (
        {
            event_name: special_point_value(diagram_pair, *kind_and_label)
            for event_name, kind_and_label in SPECIAL_POINTS.items()
        }
        for diagram_pair in (diagram_with_check, slower_with_check)
    )
    order_exchanges = [
        f"{event_name} and {other_event}"
        for event_name, other_event in combinations(SPECIAL_POINTS, 2)
        if (faster_values[event_name][0] < faster_values[other_event][0])
        != (slower_values[event_name][0] < slower_values[other_event][0])
    ]
    order_text = " < ".join(sorted(faster_values, key=lambda event_name: faster_values[event_name][0]))
    reason = f"The order is {order_text}; exchanged are {'; '.join(order_exchanges)}."
    claim_text = "the same order of events as in figure 4 (number of exchanged pairs)"
    least_change_event = min(
        faster_values, key=lambda event_name: faster_values[event_name][0] - slower_values[event_name][0]
    )
    difference_with_error = (
        faster_values[least_change_event][0] - slower_values[least_change_event][0],
        faster_values[least_change_event][1] + slower_values[least_change_event][1],
    )
    claims = [
        statement_claim("6", claim_text, (float(len(order_exchanges)), 0.0), high=0.0, reason=reason),
        statement_claim(
            "6", f"each at a larger A (least difference, of {least_change_event})", difference_with_error, low=0.0
        ),
    ]
    return _figure_result(study_results, claims)


def reproduce_figure_7(scene_file, show_progress):
    """Reproduce figure 7 and its claims."""
    study_results, diagram_with_check = _results_and_diagrams(scene_file, show_progress)
    diagram, grazing_value = diagram_with_check.first, special_point_value(diagram_with_check, "GR", "P100")
    nearest_fold = nearest_special_point(diagram, "SN", 5.51)
    reason = f"The SN nearest to 5.51 is that of {nearest_fold.label}, at {nearest_fold.value:.9g}."
    claims = [
        statement_claim("7", "no SB (number of them)", (float(len(diagram.points("SB"))), 0.0), high=0.0),
        number_claim(
            "7",
            "P111 begins at an SN",
            "0.7",
            special_point_value(diagram_with_check, "SN", "P111"),
            _stability_note(diagram, 0.7),
        ),
        number_claim("7", "GR, of P100", "3.41", grazing_value),
        number_claim(
            "7",
            "second SN, of P111",
            "5.51",
            special_point_value(diagram_with_check, "SN", "P111", target_value=5.51),
            reason,
        ),
        *_chaos_claims("7", study_results.scene, "6.75", grazing_value[0]),
        *_period_two_claims(diagram_with_check, 6.75),
    ]
    return _figure_result(study_results, claims)


def _period_two_claims(diagram_with_check, amplitude):
    """Yield the claims that a stable motion of period two exists above an amplitude, and that it grazes."""
    amplitude_grid = np.linspace(amplitude, diagram_with_check.first.bounds[1], N_AMPLITUDES + 1)[1:]
    period_two_branches = [branch for branch in diagram_with_check.first.branches if branch.data.sizes["period"] == 2]
    labels_per_amplitude = [stable_labels_at(period_two_branches, grid_amplitude) for grid_amplitude in amplitude_grid]
    labels_text = ", ".join(sorted({label for amplitude_labels in labels_per_amplitude for label in amplitude_labels}))
    claim_text = (
        f"then a period-2 pair (number of {N_AMPLITUDES} amplitudes above {amplitude:g} with a stable"
        f" one: {labels_text})"
    )
    yield statement_claim("7", claim_text, (float(sum(map(bool, labels_per_amplitude))), 0.0), low=1.0)
    later_grazings = [
        special_point
        for special_point in diagram_with_check.first.points("GR")
        if len(special_point.itinerary) == 2 and special_point.value > amplitude
    ]
    if later_grazings:
        first_grazing = min(later_grazings, key=lambda special_point: special_point.value)
        claim_text = (
            f"that motion grazes: {' and '.join(sorted(neighbour_labels(first_grazing)))} meet there (amplitude)"
        )
        yield additional_claim(
            "7",
            claim_text,
            special_point_value(diagram_with_check, "GR", target_value=first_grazing.value, n_periods=2),
            low=amplitude,
        )


def _chaos_claims(figure_label, scene, printed_number, lower_amplitude):
    """Yield the claims that the motion is chaotic at a printed amplitude, and that chaos begins there.

    The onset of chaos is searched for between `lower_amplitude` and the printed amplitude.
    """
    amplitude = float(printed_number)
    claim_scene = scene.replace(amplitude=amplitude)
    attractors = find_attractors(claim_scene, N_STARTS)
    exponent_with_error, allowance = largest_exponent(claim_scene, attractors)
    claim_text = f"chaos at {printed_number} (largest exponent per period; attractors: {basin_shares_text(attractors)})"
    yield statement_claim(figure_label, claim_text, exponent_with_error, low=0.0, unresolved_allowance=allowance)
    onset_amplitude, onset_error, n_chaotic_starts, onset_exponent = locate_chaos_onset(
        scene, lower_amplitude, amplitude
    )
    reason = (
        f"There is chaos at {onset_amplitude:.4g} already, from {n_chaotic_starts} starts, with an exponent of"
        f" {onset_exponent:.3g} per period; the amplitudes are {onset_error:g} apart."
    )
    yield number_claim(
        figure_label,
        "chaos begins (the same number as an onset)",
        printed_number,
        (onset_amplitude, onset_error),
        reason,
    )


def _results_and_diagrams(scene_file, show_progress):
    study_results = run_studies(scene_file, show_progress=show_progress)
    return study_results, explore_twice(study_results.scene, scene_file.explore, study_results.diagram)


def _figure_result(study_results, claims):
    return FigureResult(_figure_png(study_results), CAPTION, tuple(claims), {"": make_results_dataset(study_results)})


def _figure_png(study_results):
    figure, axes_grid = make_figure(3, 1, 2.5)
    for (ax,), coordinate_name in zip(axes_grid, "xvx", strict=True):
        plot.diagram(study_results.swept, coordinate_name, ax, faint=True)
        for branch in study_results.diagram_branches:
            plot.branch(branch, coordinate_name, ax)
    axes_grid[2, 0].set_xlim(
        *_range_of_most_points(
            [special_point.value for branch in study_results.diagram_branches for special_point in branch.special]
        )
    )
    for axes_block in (axes_grid[:2], axes_grid[2:]):
        trim_axis_labels(axes_block, max_ticks=9)
        plot.mark_points(study_results.diagram_branches, axes_block[0, 0])
        axes_block[-1, 0].tick_params(labelbottom=True)
    add_figure_legend(figure, axes_grid, n_columns=2)
    return png_bytes(figure)


def _range_of_most_points(special_values):
    """Return the smallest range that contains the fraction `CROWD_SHARE` of some values, with a margin."""
    special_values = np.sort(special_values)
    n_values_in_range = math.ceil(CROWD_SHARE * len(special_values))
    first_index = int(
        np.argmin(
            special_values[n_values_in_range - 1 :] - special_values[: len(special_values) - n_values_in_range + 1]
        )
    )
    lower, upper = special_values[[first_index, first_index + n_values_in_range - 1]]
    return lower - RANGE_MARGIN * (upper - lower), upper + RANGE_MARGIN * (upper - lower)
