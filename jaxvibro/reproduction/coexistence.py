"""Reproduce figure 12: the region in amplitude and frequency in which P100 and P111 coexist."""

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
from .claim import additional_claim, statement_claim
from .figure_panels import (
    FigureResult,
    add_figure_legend,
    make_figure,
    panel_scene_files,
    png_bytes,
    trim_axis_labels,
)

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


def reproduce_figure_12(scene_file, show_progress):
    """Reproduce figure 12 and its claims."""
    panel_results = []
    for panel_scene_file in tqdm(panel_scene_files(scene_file), "loci", disable=not show_progress):
        scene = panel_scene_file.scene.make()
        panel_results.append((scene, *boundary_loci(scene, panel_scene_file), find_tongues(scene, panel_scene_file)))
    claims = [claim for panel_result in panel_results for claim in _closed_form_claims(scene_file, *panel_result)]
    claims += [
        *_region_growth_claims(scene_file, [panel_result[0] for panel_result in panel_results]),
        *_coexistence_claims(scene_file, panel_results),
        *_curve_meeting_claims(scene_file, panel_results),
        _unequal_walls_claim(scene_file),
    ]
    return FigureResult(_figure_png(scene_file, panel_results), CAPTION, tuple(claims))


def boundary_loci(scene, scene_file):
    """Compute the loci of the saddle-node of P111 and of the grazing of P100.

    The tables [explore] and [locus] of the scene file give the settings.
    """
    explore_table, locus_table = scene_file.explore, scene_file.locus
    diagram = explore(
        scene, explore_table.parameter, explore_table.bounds, explore_table.max_period, explore_table.seed
    )
    fold_point = min(
        (special_point for special_point in diagram.points("SN") if special_point.label == "P111"),
        key=lambda special_point: special_point.value,
    )
    grazing_point = next(special_point for special_point in diagram.points("GR") if special_point.label == "P100")
    return tuple(
        locus(special_point, locus_table.parameters, locus_table.bounds, largest_step=locus_table.largest_step)
        for special_point in (fold_point, grazing_point)
    )


class Tongue(NamedTuple):
    """Tongue: part of the coexistence region at frequencies below the main part.

    Attributes
    ----------
    fold : Locus
        Locus of the saddle-node of P111.
    frequency : float
        Frequency in the tongue.
    first_grazing_amplitude : float
        Lowest amplitude at which P111 grazes at this frequency, if it is below the grazing of P100; else nan.
    """

    fold: Locus
    frequency: float
    first_grazing_amplitude: float


def find_tongues(scene, scene_file):
    """Compute the tongues, at the frequencies omega from r / (2 k + 1) to r / (2 k), k = 1, 2, ...

    r is sqrt(1 - gamma^2), the natural frequency with damping. The main part of the region lies above r.
    """
    locus_table, restitution, damping = scene_file.locus, float(scene.restitution), float(scene.damping)
    min_frequency, meeting_frequency, tongues = (
        locus_table.bounds["frequency"][0],
        float(closed_forms.meeting_frequency(damping)),
        [],
    )
    for tongue_number in range(1, int(0.5 * meeting_frequency / min_frequency) + 1):
        frequency = 0.5 * (
            max(min_frequency, meeting_frequency / (2 * tongue_number + 1)) + meeting_frequency / (2 * tongue_number)
        )
        fold_amplitude, fold_speed = (
            float(value) for value in closed_forms.symmetric_fold(frequency, damping, restitution)
        )
        grazing_amplitude = float(closed_forms.grazing_amplitude(frequency, damping))
        start_scene = scene.replace(
            frequency=frequency, amplitude=fold_amplitude + START_FRACTION * (grazing_amplitude - fold_amplitude)
        )
        start_orbit = find_orbit(start_scene, closed_forms.symmetric_orbit_state(start_scene), periods=1, settle=0)
        # A tongue may be very thin.
        step_settings = {
            "first_step": FIRST_STEP_RATIO * fold_speed,
            "largest_step": LARGEST_STEP_RATIO * fold_speed,
        }
        branch = follow(start_orbit, "amplitude", (0.5 * fold_amplitude, grazing_amplitude), stop="GR", **step_settings)
        (fold_point,) = branch.points("SN")
        p111_grazing_amplitudes = [
            special_point.value
            for special_point in branch.points("GR")
            if grazing_amplitude - special_point.value > SAME_AMPLITUDE
        ]
        fold_locus = locus(
            fold_point, locus_table.parameters, locus_table.bounds, largest_step=locus_table.largest_step
        )
        tongues.append(Tongue(fold_locus, frequency, min(p111_grazing_amplitudes, default=np.nan)))
    return tuple(tongues)


def area_between_loci(fold_locus, grazing_locus):
    """Return (area, error) between two loci in (A, omega), up to the highest frequency of `fold_locus`.

    The error is the difference between splines through all points and through every second point.
    """
    fine_area, coarse_area = (
        _area_between_splines(
            *(_every_nth_point(boundary_locus.values, point_step) for boundary_locus in (fold_locus, grazing_locus))
        )
        for point_step in (1, 2)
    )
    return fine_area, abs(fine_area - coarse_area)


def _every_nth_point(curve_points, point_step):
    """Return every `point_step`-th point of a curve, and the last point."""
    return curve_points[np.unique(np.append(np.arange(0, len(curve_points), point_step), len(curve_points) - 1))]


def _area_between_splines(fold_points, grazing_points):
    (lower_frequency, upper_frequency), signed_area = _frequency_span(fold_points), 0.0
    for area_sign, curve_points in ((-1.0, fold_points), (1.0, grazing_points)):
        amplitudes, frequencies = curve_points[np.argsort(curve_points[:, 1])].T
        signed_area += area_sign * float(
            scipy.interpolate.CubicSpline(frequencies, amplitudes).integrate(
                max(lower_frequency, frequencies[0]), min(upper_frequency, frequencies[-1])
            )
        )
    return signed_area


def _frequency_span(curve_points):
    return curve_points[:, 1].min(), curve_points[:, 1].max()


def _closed_form_area(scene, max_frequency):
    """Return ((area, error), (derivatives, error)) of the coexistence region up to a frequency, in closed form.

    The derivatives are those with respect to damping and restitution.
    """
    damping_restitution = float(scene.damping), float(scene.restitution)
    areas = [float(closed_forms.coexistence_area(*damping_restitution, max_frequency, n_nodes)) for n_nodes in N_NODES]
    area_gradients = [
        np.array(jax.jacfwd(closed_forms.coexistence_area, (0, 1))(*damping_restitution, max_frequency, n_nodes))
        for n_nodes in N_NODES
    ]
    return (areas[1], abs(areas[1] - areas[0])), (area_gradients[1], abs(area_gradients[1] - area_gradients[0]).max())


def _closed_form_claims(scene_file, scene, fold_locus, grazing_locus, tongues):
    """Yield the claims that the continued loci agree with the closed forms in their points and in the area."""
    damping = float(scene.damping)
    claim_text = f"the SN of P111 is A_c of (19), gamma {damping:g} (largest difference along the locus)"
    yield additional_claim("12", claim_text, (_max_fold_difference(scene, fold_locus), 0.0), high=1e-10)
    for tongue in tongues:
        lower_frequency, upper_frequency = _frequency_span(tongue.fold.values)
        grazing_text = (
            "P111 does not graze before"
            if np.isnan(tongue.first_grazing_amplitude)
            else f"P111 grazes at {tongue.first_grazing_amplitude:.6g}"
        )
        fold_amplitude, grazing_amplitude = (
            float(value) for value in _fold_grazing_amplitudes(scene, tongue.frequency)
        )
        claim_text = (
            f"sin(pi r / omega) > 0 again, and the SN of P111 is A_c, from omega {lower_frequency:.6g} to"
            f" {upper_frequency:.6g}, gamma "
            f"{damping:g}: {fold_amplitude:.6g} at omega {tongue.frequency:.4g}, where P100 grazes at"
            f" {grazing_amplitude:.6g} and {grazing_text} "
            "(largest difference to A_c)"
        )
        yield additional_claim("12", claim_text, (_max_fold_difference(scene, tongue.fold), 0.0), high=1e-10)
    upper_frequency = scene_file.locus.bounds["frequency"][1]
    (exact_area, exact_error), _ = _closed_form_area(scene, upper_frequency)
    continued_area, continued_error = area_between_loci(fold_locus, grazing_locus)
    claim_text = (
        f"area with P100 and P111 up to omega {upper_frequency:g}, gamma {damping:g}: {exact_area:.6f} in"
        " closed form (continued)"
    )
    yield additional_claim(
        "12", claim_text, (continued_area, continued_error), low=exact_area - 1e-6, high=exact_area + 1e-6 + exact_error
    )


def _max_fold_difference(scene, fold_locus):
    """Return the largest difference in amplitude between a saddle-node locus and its closed form.

    Points at which the impact speed of the closed form is not positive are excluded.
    """
    locus_amplitudes, frequencies = fold_locus.values.T
    closed_form_amplitudes, impact_speeds = jax.vmap(closed_forms.symmetric_fold, (0, None, None))(
        frequencies, float(scene.damping), float(scene.restitution)
    )
    return float(abs(locus_amplitudes - closed_form_amplitudes)[np.asarray(impact_speeds) > 0].max())


def _fold_grazing_amplitudes(scene, frequency):
    """Return the amplitudes of the saddle-node of P111 and of the grazing of P100 at a frequency, in closed form."""
    damping = float(scene.damping)
    return closed_forms.symmetric_fold(frequency, damping, float(scene.restitution))[0], closed_forms.grazing_amplitude(
        frequency, damping
    )


def _region_growth_claims(scene_file, scenes):
    """Yield the claims on the growth of the region's area and width with the parameters."""
    max_frequency = scene_file.locus.bounds["frequency"][1]
    area_gradients = [_closed_form_area(scene, max_frequency)[1] for scene in scenes]
    max_error = max(area_gradient[1] for area_gradient in area_gradients)
    damping_derivatives, restitution_derivatives = np.array([area_gradient[0] for area_gradient in area_gradients]).T
    derivatives_text = ", ".join(f"{derivative:.4g}" for derivative in damping_derivatives)
    claim_text = (
        f"the region shrinks as gamma grows (derivatives of the area by gamma: {derivatives_text}; the largest)"
    )
    yield statement_claim("12", claim_text, (float(damping_derivatives.max()), max_error), high=0.0)
    derivatives_text = ", ".join(f"{derivative:.4g}" for derivative in restitution_derivatives)
    claim_text = f"the region shrinks as R falls (derivatives of the area by R: {derivatives_text}; the least)"
    yield statement_claim("12", claim_text, (float(restitution_derivatives.min()), max_error), low=0.0)
    for scene in scenes:
        damping = float(scene.damping)
        frequencies = np.linspace(float(closed_forms.meeting_frequency(damping)), max_frequency, 200)[1:]
        coexistence_widths = np.asarray(
            jax.vmap(closed_forms.coexistence_width, (0, None, None))(frequencies, damping, float(scene.restitution))
        )
        claim_text = (
            f"the region grows away from omega = 1, gamma {damping:g} (least slope of its width above the meeting)"
        )
        yield statement_claim(
            "12",
            claim_text,
            (float(np.diff(coexistence_widths).min() / (frequencies[1] - frequencies[0])), 1e-12),
            low=0.0,
        )


def _coexistence_claims(scene_file, panel_results):
    """Yield the claims that P100 and P111 coexist between the loci.

    A claim holds if a stable P111 exists at `N_FREQUENCIES` frequencies, each at the mean of the two amplitudes.
    """
    max_frequency = scene_file.locus.bounds["frequency"][1]
    for scene, *_ in panel_results:
        damping = float(scene.damping)
        min_frequency, n_without_p111 = float(closed_forms.meeting_frequency(damping)), 0
        for frequency in np.linspace(min_frequency, max_frequency, N_FREQUENCIES + 1)[1:]:
            fold_amplitude, grazing_amplitude = (float(value) for value in _fold_grazing_amplitudes(scene, frequency))
            n_without_p111 += not _has_stable_p111(
                scene.replace(frequency=frequency, amplitude=0.5 * (fold_amplitude + grazing_amplitude))
            )
        claim_text = (
            f"P100 and P111 coexist between the curves, gamma {damping:g} (number of"
            f" {N_FREQUENCIES} points in the middle without a stable P111)"
        )
        yield statement_claim("12", claim_text, (float(n_without_p111), 0.0), high=0.0)


def _has_stable_p111(scene):
    """Return True if the motion from the closed-form state approaches a stable P111, symmetric or asymmetric."""
    try:
        orbit = find_orbit(scene, closed_forms.symmetric_orbit_state(scene))
    except OrbitError:
        return False
    return orbit.label == "P111" and orbit.stable


def _curve_meeting_claims(scene_file, panel_results):
    """Yield the claims on the frequencies at which the two loci meet."""
    min_frequency = scene_file.locus.bounds["frequency"][0]
    for scene, fold_locus, _, tongues in panel_results:
        damping, (meeting_frequency, _) = float(scene.damping), _frequency_span(fold_locus.values)
        closed_form_frequency = float(closed_forms.meeting_frequency(damping))
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
        reason = f"They meet at sqrt(1 - gamma^2) = {closed_form_frequency:.6g}{meetings_text}."
        claim_text = (
            f"the curves meet near omega = 1, to within {MEETING_TOLERANCE:g}, gamma {damping:g} (the highest"
            " omega of a meeting)"
        )
        yield statement_claim(
            "12",
            claim_text,
            (meeting_frequency, abs(meeting_frequency - closed_form_frequency)),
            low=1.0 - MEETING_TOLERANCE,
            high=1.0 + MEETING_TOLERANCE,
            reason=reason,
        )


def _unequal_walls_claim(scene_file):
    """Return the claim on the area of the region for unequal walls, for which there is no closed form."""
    scene_file = panel_scene_files(scene_file)[0]
    scene = scene_file.scene.make().replace(**{"left.position": LEFT_WALL})
    unequal_walls_area, area_error = area_between_loci(*boundary_loci(scene, scene_file))
    gamma_r_derivatives = []
    for damping_or_restitution in ("damping", "restitution"):
        unperturbed_value = float(scene.parameter(damping_or_restitution))
        area_above, area_below = (
            area_between_loci(
                *boundary_loci(
                    scene.replace(**{damping_or_restitution: unperturbed_value + parameter_step}), scene_file
                )
            )[0]
            for parameter_step in (DIFFERENCE_STEP, -DIFFERENCE_STEP)
        )
        gamma_r_derivatives.append((area_above - area_below) / (2.0 * DIFFERENCE_STEP))
    claim_text = (
        f"walls at {LEFT_WALL:g} and 1, gamma {float(scene.damping):g}: the region exists too; the derivative of"
        " its area by "
        f"gamma is {gamma_r_derivatives[0]:.4g}, by R {gamma_r_derivatives[1]:.4g} (area)"
    )
    return additional_claim("12", claim_text, (unequal_walls_area, area_error), low=0.0)


def _figure_png(scene_file, panel_results):
    figure, axes_grid = make_figure(2, 1, 3.3)
    (upper_ax,), (lower_ax,) = axes_grid
    for (scene, fold_locus, grazing_locus, tongues), colour in zip(panel_results, COLOURS, strict=False):
        damping_text, tongue_fold_loci = (
            f"\N{GREEK SMALL LETTER GAMMA} = {float(scene.damping):g}",
            [tongue.fold for tongue in tongues],
        )
        for ax, fold_loci, frequency_bounds in (
            (upper_ax, [fold_locus], FREQUENCY_RANGE),
            (lower_ax, tongue_fold_loci, TONGUE_FREQUENCIES),
        ):
            for locus_item in (*fold_loci, grazing_locus):
                plot.locus(_select_special_points(locus_item, frequency_bounds), ax, colour)
            for drawn_fold_locus in fold_loci:
                _draw_closed_form_fold(scene, drawn_fold_locus, ax, colour)
                if _max_width_below_grazing(scene, drawn_fold_locus) > MIN_VISIBLE_WIDTH:
                    plot.region(drawn_fold_locus, grazing_locus, damping_text, ax, colour)
    for ax, (amplitude_range, frequency_range) in (
        (upper_ax, (AMPLITUDE_RANGE, FREQUENCY_RANGE)),
        (lower_ax, (TONGUE_AMPLITUDES, TONGUE_FREQUENCIES)),
    ):
        ax.set(xlim=amplitude_range, ylim=frequency_range)
    upper_ax.set_ylim(top=scene_file.locus.bounds["frequency"][1])
    trim_axis_labels(axes_grid, has_shared_ranges=False, max_ticks=9)
    # The panel itself shows gamma.
    add_figure_legend(
        figure,
        axes_grid,
        n_columns=2,
        excluded_artist_ids={region_patch.get_gid() for region_patch in upper_ax.patches},
    )
    return png_bytes(figure)


def _select_special_points(boundary_locus, frequency_bounds):
    """Return a locus with only its end points and its special points in a range of frequencies.

    If the locus has no such points, its first special point remains.
    """
    special_points_inside = [
        special_point
        for special_point in boundary_locus.special
        if special_point.kind == "EP" or frequency_bounds[0] < special_point.values["frequency"] < frequency_bounds[1]
    ]
    return replace(boundary_locus, special=tuple(special_points_inside or boundary_locus.special[:1]))


def _draw_closed_form_fold(scene, fold_locus, ax, colour):
    frequencies = np.linspace(*_frequency_span(fold_locus.values), 25)
    amplitudes, _ = jax.vmap(closed_forms.symmetric_fold, (0, None, None))(
        frequencies, float(scene.damping), float(scene.restitution)
    )
    legend_text = "saddle-node, closed form"
    ax.plot(amplitudes, frequencies, linestyle="none", marker="o", markersize=2.5, color=colour, label=legend_text)


def _max_width_below_grazing(scene, fold_locus):
    """Return the largest difference in amplitude between the grazing of P100 and a locus."""
    amplitudes, frequencies = fold_locus.values.T
    return float((np.asarray(closed_forms.grazing_amplitude(frequencies, float(scene.damping))) - amplitudes).max())
