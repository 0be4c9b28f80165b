"""Reproduce figures 4, 6 and 7: bifurcation diagrams against the amplitude, by sweeps and continuation."""

import math
from itertools import combinations

import numpy as np

from .. import plot
from ..attractors.find import find_attractors
from ..branches.explore import explore
from ..studies.compute import run_studies
from ..studies.results_dataset import results_dataset
from .attractor_checks import chaos_onset, largest_exponent, shares_text, stable_labels_at
from .claim import number_claim, own_claim, statement_claim
from .panels import FigureResult, add_legend, figure_style, make_figure, png_bytes, trim_labels
from .special_points import ROUNDING, explore_twice, nearest_special, neighbour_labels, special_value

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


def reproduce_figure_4(file, progress):
    """Reproduce figure 4 and its claims."""
    results, diagrams = _run_study(file, progress)
    diagram, birth, doubling = (
        diagrams.first,
        special_value(diagrams, "SN", "P112"),
        special_value(diagrams, "PD", "P112"),
    )
    grazing = special_value(diagrams, "GR", "P100")
    claims = [
        number_claim("4", "SN1, where P111 begins", "0.5", special_value(diagrams, "SN", "P111")),
        number_claim("4", "GB1, where P100 grazes", "3.41", grazing),
        number_claim(
            "4",
            "SB, where P111 loses its symmetry",
            "3.45",
            special_value(diagrams, "SB"),
            _stability_note(diagram, 3.45),
        ),
        number_claim("4", "SN2, where P112 and P121 are born", "4.51", birth, TURN_NOTE),
        number_claim("4", "PD of P112 and P121", "4.735", doubling, _stability_note(diagram, 4.735, "P112")),
        _four_motions_claim(diagram, birth[0], doubling[0]),
        number_claim(
            "4",
            "asymmetric P111 ends by grazing",
            "5.215",
            special_value(diagrams, "GR", "P111", target=5.215),
            _stability_note(diagram, 5.215),
        ),
        *_chaos_claims("4", results.scene, "5.24", grazing[0]),
        _pair_grazing_claim(results.scene, diagrams, "5.42", 3),
    ]
    return _figure_result(results, claims)


def _four_motions_claim(diagram, lower, upper):
    """Return the claim that four attractors exist between the birth of P112 and its period doubling."""
    stable_labels = [
        stable_labels_at(diagram.branches, item) for item in np.linspace(lower, upper, N_AMPLITUDES + 2)[1:-1]
    ]
    counts = [len(item) for item in stable_labels]
    labels_text = " or ".join(sorted({", ".join(sorted(item)) for item in stable_labels}))
    count_range = 0.5 * (max(counts) + min(counts)), 0.5 * (max(counts) - min(counts))
    text = f"four motions are stable between SN2 and PD (at {N_AMPLITUDES} amplitudes: {labels_text})"
    return statement_claim("4", text, count_range, low=4.0, high=4.0)


def _pair_grazing_claim(scene, diagrams, printed, periods):
    """Return the claim on the grazing of orbits of some period nearest to a printed amplitude.

    The reason names the nearest grazing of all orbits of up to `MAX_PERIODS` periods.
    """
    printed_value = float(printed)
    local_diagram = explore(
        scene, "amplitude", (printed_value - GRAZING_RANGE, printed_value + GRAZING_RANGE), MAX_PERIODS
    )
    claimed_point = nearest_special(diagrams.first, "GR", printed_value, periods=periods)
    points = [
        special
        for special in (nearest_special(local_diagram, "GR", printed_value), claimed_point)
        if special is not None
    ]
    grazing_point = min(points, key=lambda special: abs(special.value - printed_value))
    grazing_labels = [
        special.label
        for special in local_diagram.points("GR")
        if abs(special.value - grazing_point.value) <= ROUNDING * abs(grazing_point.value)
    ]
    births = [
        special.value
        for special in local_diagram.points("SN")
        if special.label == grazing_point.label and special.value < grazing_point.value
    ]
    birth_text = f", born in an SN at {max(births):.9g}," if births else ""
    reason = (
        f"The nearest grazing of orbits of up to {MAX_PERIODS} periods is that of"
        f" {' and '.join(grazing_labels or [grazing_point.label])}, of "
        f"period {len(grazing_point.itinerary)}{birth_text} at {grazing_point.value:.9g}."
    )
    if claimed_point is not None:
        reason += f" That of period {periods} belongs to {claimed_point.label}, at {claimed_point.value:.9g}."
    text = f"GB2, where a period-{periods} pair grazes"
    return number_claim(
        "4", text, printed, special_value(diagrams, "GR", target=printed_value, periods=periods), reason
    )


def _stability_note(diagram, amplitude, label="P111"):
    """Return the note that an orbit is stable at an amplitude, with its multipliers."""
    magnitudes = []
    for branch in diagram.branches:
        for segment in (candidate for candidate in branch.segments if candidate.label == label):
            values, multipliers = (
                column[segment.first : segment.last + 1] for column in (branch.values, branch.multipliers)
            )
            (rows,) = np.nonzero((values[:-1] - amplitude) * (values[1:] - amplitude) <= 0)
            magnitudes += [abs(multipliers[row : row + 2]).max() for row in rows]
    return (
        f"At {amplitude:g} {label} is still stable: its multipliers there are at most"
        f" {min(magnitudes, default=np.nan):.3f}."
    )


EVENTS = {
    "SN of P111": ("SN", "P111"),
    "GR of P100": ("GR", "P100"),
    "SB": ("SB", None),
    "SN of P112": ("SN", "P112"),
    "PD of P112": ("PD", "P112"),
    "GR of P111": ("GR", "P111"),
}


def reproduce_figure_6(file, slower_file, progress):
    """Reproduce figure 6 and its claims, which compare it with figure 4, the second scene file."""
    results, diagrams = _run_study(file, progress)
    slower_diagrams = explore_twice(slower_file.scene.make(), slower_file.explore)
    fast_values, slow_values = (
        {name: special_value(item, *event) for name, event in EVENTS.items()} for item in (diagrams, slower_diagrams)
    )
    exchanges = [
        f"{item} and {next_item}"
        for item, next_item in combinations(EVENTS, 2)
        if (fast_values[item][0] < fast_values[next_item][0]) != (slow_values[item][0] < slow_values[next_item][0])
    ]
    order_text = " < ".join(sorted(fast_values, key=lambda name: fast_values[name][0]))
    reason = f"The order is {order_text}; exchanged are {'; '.join(exchanges)}."
    text = "the same order of events as in figure 4 (number of exchanged pairs)"
    least_event = min(fast_values, key=lambda name: fast_values[name][0] - slow_values[name][0])
    difference = (
        fast_values[least_event][0] - slow_values[least_event][0],
        fast_values[least_event][1] + slow_values[least_event][1],
    )
    claims = [
        statement_claim("6", text, (float(len(exchanges)), 0.0), high=0.0, reason=reason),
        statement_claim("6", f"each at a larger A (least difference, of {least_event})", difference, low=0.0),
    ]
    return _figure_result(results, claims)


def reproduce_figure_7(file, progress):
    """Reproduce figure 7 and its claims."""
    results, diagrams = _run_study(file, progress)
    diagram, grazing = diagrams.first, special_value(diagrams, "GR", "P100")
    nearest_fold = nearest_special(diagram, "SN", 5.51)
    reason = f"The SN nearest to 5.51 is that of {nearest_fold.label}, at {nearest_fold.value:.9g}."
    claims = [
        statement_claim("7", "no SB (number of them)", (float(len(diagram.points("SB"))), 0.0), high=0.0),
        number_claim(
            "7", "P111 begins at an SN", "0.7", special_value(diagrams, "SN", "P111"), _stability_note(diagram, 0.7)
        ),
        number_claim("7", "GR, of P100", "3.41", grazing),
        number_claim("7", "second SN, of P111", "5.51", special_value(diagrams, "SN", "P111", target=5.51), reason),
        *_chaos_claims("7", results.scene, "6.75", grazing[0]),
        *_period_two_claims(diagrams, 6.75),
    ]
    return _figure_result(results, claims)


def _period_two_claims(diagrams, amplitude):
    """Yield the claims that a motion of period two follows the chaos, and on its grazing."""
    values = np.linspace(amplitude, diagrams.first.bounds[1], N_AMPLITUDES + 1)[1:]
    branches = [item for item in diagrams.first.branches if item.data.sizes["period"] == 2]
    stable_labels = [stable_labels_at(branches, item) for item in values]
    labels = ", ".join(sorted({label for item in stable_labels for label in item}))
    text = f"then a period-2 pair (number of {N_AMPLITUDES} amplitudes above {amplitude:g} with a stable one: {labels})"
    yield statement_claim("7", text, (float(sum(map(bool, stable_labels))), 0.0), low=1.0)
    later_grazings = [
        item for item in diagrams.first.points("GR") if len(item.itinerary) == 2 and item.value > amplitude
    ]
    if later_grazings:
        grazing_point = min(later_grazings, key=lambda special: special.value)
        text = f"that motion grazes: {' and '.join(sorted(neighbour_labels(grazing_point)))} meet there (amplitude)"
        yield own_claim("7", text, special_value(diagrams, "GR", target=grazing_point.value, periods=2), low=amplitude)


def _chaos_claims(figure, scene, printed, lower):
    """Yield the claims that motion is chaotic at an amplitude, by the largest exponent, and that chaos begins there.

    The onset is sought from an amplitude below which the motions are known.
    """
    amplitude = float(printed)
    printed_scene = scene.replace(amplitude=amplitude)
    attractors = find_attractors(printed_scene, N_STARTS)
    exponent, excess = largest_exponent(printed_scene, attractors)
    text = f"chaos at {printed} (largest exponent per period; attractors: {shares_text(attractors)})"
    yield statement_claim(figure, text, exponent, low=0.0, excess=excess)
    onset_amplitude, onset_error, n_chaotic, onset_exponent = chaos_onset(scene, lower, amplitude)
    reason = (
        f"There is chaos at {onset_amplitude:.4g} already, from {n_chaotic} starts, with an exponent of"
        f" {onset_exponent:.3g} per period; the amplitudes are {onset_error:g} apart."
    )
    yield number_claim(
        figure, "chaos begins (the same number as an onset)", printed, (onset_amplitude, onset_error), reason
    )


def _run_study(file, progress):
    results = run_studies(file, progress=progress)
    return results, explore_twice(results.scene, file.explore, results.diagram)


def _figure_result(results, claims):
    with figure_style():
        return FigureResult(_picture(results), CAPTION, tuple(claims), {"": results_dataset(results)})


def _picture(results):
    figure, axes_grid = make_figure(3, 1, 2.5)
    for (ax,), variable in zip(axes_grid, "xvx", strict=True):
        plot.diagram(results.swept, variable, ax, faint=True)
        for branch in results.diagram_branches:
            plot.branch(branch, variable, ax)
    axes_grid[2, 0].set_xlim(
        *_crowded_range([special.value for branch in results.diagram_branches for special in branch.special])
    )
    for axes_rows in (axes_grid[:2], axes_grid[2:]):
        trim_labels(axes_rows, max_ticks=9)
        plot.mark_points(results.diagram_branches, axes_rows[0, 0])
        axes_rows[-1, 0].tick_params(labelbottom=True)
    add_legend(figure, axes_grid, columns=2)
    return png_bytes(figure)


def _crowded_range(values):
    """Return the smallest range that contains `CROWD_SHARE` of some values, with a margin."""
    values = np.sort(values)
    count = math.ceil(CROWD_SHARE * len(values))
    start = int(np.argmin(values[count - 1 :] - values[: len(values) - count + 1]))
    lower, upper = values[[start, start + count - 1]]
    return lower - RANGE_MARGIN * (upper - lower), upper + RANGE_MARGIN * (upper - lower)
