"""Reproduce figure 12: the region in amplitude and frequency in which P100 and P111 coexist, for several dampings."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
import scipy
from tqdm import tqdm

from .. import plot
from ..branches.explore import explore
from ..branches.follow import follow
from ..loci.locus import Locus, locus
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..plot.style import COLOURS
from . import closed_forms
from .claim import own_claim, statement_claim
from .panels import FigureResult, add_legend, figure_style, make_figure, panel_files, png_bytes, trim_labels

N_NODES = (32, 48)  # of Gauss-Legendre quadrature; the difference is the error bar
DIFFERENCE_STEP = 1e-3  # step of the parameter in central differences
LEFT_WALL = -1.5  # position of the left wall in the claim on unequal walls
MEETING_TOLERANCE = 0.1  # distance from omega = 1 that counts as near
# P111 is sought at a fraction of the distance from the saddle-node to the grazing; tolerance of equal amplitudes.
START_FRACTION, SAME_AMPLITUDE = 0.02, 1e-9
FIRST_STEP_RATIO, LARGEST_STEP_RATIO = 0.1, 0.3  # continuation steps, relative to the speed at the saddle-node
N_FREQUENCIES = 8  # frequencies at which coexistence is checked
AMPLITUDE_RANGE, FREQUENCY_RANGE = (0.0, 9.0), (0.55, 3.0)  # of the upper panel
TONGUE_AMPLITUDES, TONGUE_FREQUENCIES = (0.68, 1.0), (0.2, 0.55)  # of the lower panel
MIN_VISIBLE_WIDTH = 0.05  # wider tongues are shaded

CAPTION = (
    "Coexistence of P100 and P111: between the locus of the saddle-node (solid, with the closed form (19) as "
    "dots) and that of the grazing (dotted), for the dampings gamma in the figure; below, enlarged, the tongues at "
    "lower frequencies, where sin(pi r / omega) > 0 again; those of larger damping are too thin to be visible. P111 "
    "may graze in them before P100 does and then continues with more impacts."
)


def reproduce_figure(file, progress):
    """Reproduce figure 12 and its claims."""
    results = []
    for panel_file in tqdm(panel_files(file), "loci", disable=not progress):
        scene = panel_file.scene.make()
        results.append((scene, *boundary_loci(scene, panel_file), find_tongues(scene, panel_file)))
    claims = [claim for result in results for claim in _closed_form_claims(file, *result)]
    claims += [
        *_monotonicity_claims(file, [result[0] for result in results]),
        *_coexistence_claims(file, results),
        *_meeting_claims(file, results),
        _unequal_walls_claim(file),
    ]
    with figure_style():
        return FigureResult(_picture(file, results), CAPTION, tuple(claims))


def boundary_loci(scene, file):
    """Return the loci of the saddle-node of P111 and of the grazing of P100, by the [locus] table of a scene file."""
    explore_table, locus_table = file.explore, file.locus
    branches = explore(
        scene, explore_table.parameter, explore_table.bounds, explore_table.max_period, explore_table.seed
    )
    fold = min(
        (special for special in branches.points("SN") if special.label == "P111"), key=lambda special: special.value
    )
    grazing = next(special for special in branches.points("GR") if special.label == "P100")
    return tuple(
        locus(special, locus_table.parameters, locus_table.bounds, largest_step=locus_table.largest_step)
        for special in (fold, grazing)
    )


class Tongue(NamedTuple):
    """Tongue of the coexistence region: its saddle-node `Locus`, a frequency, and an earlier grazing.

    At this frequency P111 grazes at `grazing_amplitude` before P100 does; nan if it does not.
    """

    fold: Locus
    frequency: float
    grazing_amplitude: float


def find_tongues(scene, file):
    """Return the tongues below the region, omega from r / (2 k + 1) to r / (2 k), k = 1, 2, ..."""
    locus_table, restitution, damping = file.locus, float(scene.restitution), float(scene.damping)
    min_frequency, meeting_frequency, tongues = (
        locus_table.bounds["frequency"][0],
        float(closed_forms.meeting_frequency(damping)),
        [],
    )
    for k in range(1, int(0.5 * meeting_frequency / min_frequency) + 1):
        frequency = 0.5 * (max(min_frequency, meeting_frequency / (2 * k + 1)) + meeting_frequency / (2 * k))
        fold_amplitude, speed = (float(value) for value in closed_forms.symmetric_fold(frequency, damping, restitution))
        grazing_amplitude = float(closed_forms.grazing_amplitude(frequency, damping))
        start_scene = scene.replace(
            frequency=frequency, amplitude=fold_amplitude + START_FRACTION * (grazing_amplitude - fold_amplitude)
        )
        orbit = find_orbit(start_scene, closed_forms.symmetric_start(start_scene), periods=1, settle=0)
        # A tongue may be very thin.
        steps = {
            "first_step": FIRST_STEP_RATIO * speed,
            "largest_step": LARGEST_STEP_RATIO * speed,
        }
        branch = follow(orbit, "amplitude", (0.5 * fold_amplitude, grazing_amplitude), stop="GR", **steps)
        (point,) = branch.points("SN")
        earlier_grazings = [
            special.value for special in branch.points("GR") if grazing_amplitude - special.value > SAME_AMPLITUDE
        ]
        fold = locus(point, locus_table.parameters, locus_table.bounds, largest_step=locus_table.largest_step)
        tongues.append(Tongue(fold, frequency, min(earlier_grazings, default=np.nan)))
    return tuple(tongues)


def area_between(fold, grazing):
    """Return the area in (A, omega) between two loci up to the highest frequency, and its error.

    The error is the difference of splines through all points and through every second point.
    """
    fine, coarse = (
        _spline_area(*(_every_nth_point(boundary.values, step) for boundary in (fold, grazing))) for step in (1, 2)
    )
    return fine, abs(fine - coarse)


def _every_nth_point(curve, step):
    """Return every n-th point of a curve, including its ends."""
    return curve[np.unique(np.append(np.arange(0, len(curve), step), len(curve) - 1))]


def _spline_area(fold, grazing):
    (lower, upper), total = _frequency_span(fold), 0.0
    for sign, curve in ((-1.0, fold), (1.0, grazing)):
        amplitudes, frequencies = curve[np.argsort(curve[:, 1])].T
        total += sign * float(
            scipy.interpolate.CubicSpline(frequencies, amplitudes).integrate(
                max(lower, frequencies[0]), min(upper, frequencies[-1])
            )
        )
    return total


def _frequency_span(curve):
    return curve[:, 1].min(), curve[:, 1].max()


def _closed_form_area(scene, max_frequency):
    """Return ((area, error), (derivatives in damping and restitution, error)) in closed form, up to a frequency."""
    params = float(scene.damping), float(scene.restitution)
    areas = [float(closed_forms.coexistence_area(*params, max_frequency, n_nodes)) for n_nodes in N_NODES]
    gradients = [
        np.array(jax.jacfwd(closed_forms.coexistence_area, (0, 1))(*params, max_frequency, n_nodes))
        for n_nodes in N_NODES
    ]
    return (areas[1], abs(areas[1] - areas[0])), (gradients[1], abs(gradients[1] - gradients[0]).max())


def _closed_form_claims(file, scene, fold, grazing, tongues):
    """Yield the claims that the continued loci agree with the closed forms, in points and area."""
    damping = float(scene.damping)
    text = f"the SN of P111 is A_c of (19), gamma {damping:g} (largest difference along the locus)"
    yield own_claim("12", text, (_max_difference(scene, fold), 0.0), high=1e-10)
    for tongue in tongues:
        lower, upper = _frequency_span(tongue.fold.values)
        grazing_text = (
            "P111 does not graze before"
            if np.isnan(tongue.grazing_amplitude)
            else f"P111 grazes at {tongue.grazing_amplitude:.6g}"
        )
        fold_amplitude, grazing_amplitude = (float(value) for value in _boundary_amplitudes(scene, tongue.frequency))
        text = (
            f"sin(pi r / omega) > 0 again, and the SN of P111 is A_c, from omega {lower:.6g} to {upper:.6g}, gamma "
            f"{damping:g}: {fold_amplitude:.6g} at omega {tongue.frequency:.4g}, where P100 grazes at"
            f" {grazing_amplitude:.6g} and {grazing_text} "
            "(largest difference to A_c)"
        )
        yield own_claim("12", text, (_max_difference(scene, tongue.fold), 0.0), high=1e-10)
    upper = file.locus.bounds["frequency"][1]
    (exact_area, exact_error), _ = _closed_form_area(scene, upper)
    continued_area, error = area_between(fold, grazing)
    text = (
        f"area with P100 and P111 up to omega {upper:g}, gamma {damping:g}: {exact_area:.6f} in closed form (continued)"
    )
    yield own_claim("12", text, (continued_area, error), low=exact_area - 1e-6, high=exact_area + 1e-6 + exact_error)


def _max_difference(scene, fold):
    """Return the largest difference between a locus and A_c, where the speed of the closed form is positive."""
    amplitudes, frequencies = fold.values.T
    exact_amplitudes, speeds = jax.vmap(closed_forms.symmetric_fold, (0, None, None))(
        frequencies, float(scene.damping), float(scene.restitution)
    )
    return float(abs(amplitudes - exact_amplitudes)[np.asarray(speeds) > 0].max())


def _boundary_amplitudes(scene, frequency):
    """Return (A_c, sqrt(D)) at a frequency."""
    damping = float(scene.damping)
    return closed_forms.symmetric_fold(frequency, damping, float(scene.restitution))[0], closed_forms.grazing_amplitude(
        frequency, damping
    )


def _monotonicity_claims(file, scenes):
    """Yield the claims on the changes of area and width."""
    max_frequency = file.locus.bounds["frequency"][1]
    gradients = [_closed_form_area(scene, max_frequency)[1] for scene in scenes]
    error = max(gradient[1] for gradient in gradients)
    damping, restitution = np.array([gradient[0] for gradient in gradients]).T
    values_text = ", ".join(f"{value:.4g}" for value in damping)
    text = f"the region shrinks as gamma grows (derivatives of the area by gamma: {values_text}; the largest)"
    yield statement_claim("12", text, (float(damping.max()), error), high=0.0)
    values_text = ", ".join(f"{value:.4g}" for value in restitution)
    text = f"the region shrinks as R falls (derivatives of the area by R: {values_text}; the least)"
    yield statement_claim("12", text, (float(restitution.min()), error), low=0.0)
    for scene in scenes:
        damping = float(scene.damping)
        frequencies = np.linspace(float(closed_forms.meeting_frequency(damping)), max_frequency, 200)[1:]
        widths = np.asarray(
            jax.vmap(closed_forms.coexistence_width, (0, None, None))(frequencies, damping, float(scene.restitution))
        )
        text = f"the region grows away from omega = 1, gamma {damping:g} (least slope of its width above the meeting)"
        yield statement_claim(
            "12", text, (float(np.diff(widths).min() / (frequencies[1] - frequencies[0])), 1e-12), low=0.0
        )


def _coexistence_claims(file, results):
    """Yield the claims that P111 is stable between the loci, where P100 is."""
    max_frequency = file.locus.bounds["frequency"][1]
    for scene, *_ in results:
        damping = float(scene.damping)
        min_frequency, n_missing = float(closed_forms.meeting_frequency(damping)), 0
        for frequency in np.linspace(min_frequency, max_frequency, N_FREQUENCIES + 1)[1:]:
            fold_amplitude, grazing_amplitude = (float(value) for value in _boundary_amplitudes(scene, frequency))
            n_missing += not _is_p111_stable(
                scene.replace(frequency=frequency, amplitude=0.5 * (fold_amplitude + grazing_amplitude))
            )
        text = (
            f"P100 and P111 coexist between the curves, gamma {damping:g} (number of"
            f" {N_FREQUENCIES} points in the middle without a stable P111)"
        )
        yield statement_claim("12", text, (float(n_missing), 0.0), high=0.0)


def _is_p111_stable(scene):
    """Return True if the motion that starts on the closed form approaches a stable P111, symmetric or not."""
    try:
        orbit = find_orbit(scene, closed_forms.symmetric_start(scene))
    except OrbitError:
        return False
    return orbit.label == "P111" and orbit.stable


def _meeting_claims(file, results):
    """Yield the claims on the meeting of the two loci."""
    min_frequency = file.locus.bounds["frequency"][0]
    for scene, fold, _, tongues in results:
        damping, (meeting_frequency, _) = float(scene.damping), _frequency_span(fold.values)
        exact_frequency = float(closed_forms.meeting_frequency(damping))
        further_meetings = [
            frequency
            for tongue in tongues
            for frequency in reversed(_frequency_span(tongue.fold.values))
            if frequency > min_frequency
        ]
        meetings_text = (
            f", and again at {', '.join(f'{frequency:.4g}' for frequency in further_meetings)}"
            if further_meetings
            else ""
        )
        reason = f"They meet at sqrt(1 - gamma^2) = {exact_frequency:.6g}{meetings_text}."
        text = (
            f"the curves meet near omega = 1, to within {MEETING_TOLERANCE:g}, gamma {damping:g} (the highest"
            " omega of a meeting)"
        )
        yield statement_claim(
            "12",
            text,
            (meeting_frequency, abs(meeting_frequency - exact_frequency)),
            low=1.0 - MEETING_TOLERANCE,
            high=1.0 + MEETING_TOLERANCE,
            reason=reason,
        )


def _unequal_walls_claim(file):
    """Return the claim on the area between unequal walls, which have no closed form, and its derivatives."""
    file = panel_files(file)[0]
    scene = file.scene.make().replace(**{"left.position": LEFT_WALL})
    total_area, error = area_between(*boundary_loci(scene, file))
    derivatives = []
    for name in ("damping", "restitution"):
        centre_value = float(scene.parameter(name))
        area_above, area_below = (
            area_between(*boundary_loci(scene.replace(**{name: centre_value + step}), file))[0]
            for step in (DIFFERENCE_STEP, -DIFFERENCE_STEP)
        )
        derivatives.append((area_above - area_below) / (2.0 * DIFFERENCE_STEP))
    text = (
        f"walls at {LEFT_WALL:g} and 1, gamma {float(scene.damping):g}: the region exists too; the derivative of"
        " its area by "
        f"gamma is {derivatives[0]:.4g}, by R {derivatives[1]:.4g} (area)"
    )
    return own_claim("12", text, (total_area, error), low=0.0)


def _picture(file, results):
    figure, axes_grid = make_figure(2, 1, 3.3)
    (upper_ax,), (lower_ax,) = axes_grid
    for (scene, fold, grazing, tongues), colour in zip(results, COLOURS, strict=False):
        damping_text, tongue_folds = (
            f"\N{GREEK SMALL LETTER GAMMA} = {float(scene.damping):g}",
            [item.fold for item in tongues],
        )
        for ax, loci, bounds in ((upper_ax, [fold], FREQUENCY_RANGE), (lower_ax, tongue_folds, TONGUE_FREQUENCIES)):
            for item in (*loci, grazing):
                plot.locus(_select_special_points(item, bounds), ax, colour)
            for item in loci:
                _draw_closed_form(scene, item, ax, colour)
                if _max_width(scene, item) > MIN_VISIBLE_WIDTH:
                    plot.region(item, grazing, damping_text, ax, colour)
    for ax, (amplitude_range, frequency_range) in (
        (upper_ax, (AMPLITUDE_RANGE, FREQUENCY_RANGE)),
        (lower_ax, (TONGUE_AMPLITUDES, TONGUE_FREQUENCIES)),
    ):
        ax.set(xlim=amplitude_range, ylim=frequency_range)
    upper_ax.set_ylim(top=file.locus.bounds["frequency"][1])
    trim_labels(axes_grid, shared=False, max_ticks=9)
    # The panel itself shows gamma.
    add_legend(figure, axes_grid, columns=2, excluded_gids={patch.get_gid() for patch in upper_ax.patches})
    return png_bytes(figure)


def _select_special_points(curve, bounds):
    """Return a locus with its ends and only the special points in a range of frequencies."""
    inside_points = [
        special
        for special in curve.special
        if special.kind == "EP" or bounds[0] < special.values["frequency"] < bounds[1]
    ]
    return replace(curve, special=tuple(inside_points or curve.special[:1]))


def _draw_closed_form(scene, fold, ax, colour):
    frequencies = np.linspace(*_frequency_span(fold.values), 25)
    amplitudes, _ = jax.vmap(closed_forms.symmetric_fold, (0, None, None))(
        frequencies, float(scene.damping), float(scene.restitution)
    )
    legend_text = "saddle-node, closed form"
    ax.plot(amplitudes, frequencies, linestyle="none", marker="o", markersize=2.5, color=colour, label=legend_text)


def _max_width(scene, fold):
    """Return the largest distance in amplitude of a locus below the grazing of P100."""
    amplitudes, frequencies = fold.values.T
    return float((np.asarray(closed_forms.grazing_amplitude(frequencies, float(scene.damping))) - amplitudes).max())
