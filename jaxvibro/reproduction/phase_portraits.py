"""Reproduce figure 3: phase portraits at five amplitudes."""

from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from .. import plot
from ..attractors.find import find_attractors
from ..maps.simulate import simulate
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit
from ..scene.state import State
from .attractor_checks import basin_shares_text, unresolved_allowance
from .claim import statement_claim
from .closed_forms import forced_motion_state, grazing_amplitude
from .figure_panels import FigureResult, make_figure, panel_scene_files, png_bytes, trim_axis_labels

PANEL_LETTERS = "abcde"
CLAIMED_LABELS = ("P100", "P111", "P111", "P112", "P121")  # in the order of the panels
SYMMETRIC_PANEL, ASYMMETRIC_PANEL = 1, 2  # panels that the paper calls symmetric and asymmetric
SAMPLES_PER_PERIOD, CHAOTIC_PERIODS = 400, 60  # per drive period; drive periods of a chaotic motion
ROUNDING, ASYMMETRY_TOLERANCE = 1e-9, 1e-6  # of impact speeds; a larger difference is an asymmetry

CAPTION = (
    "Phase portraits at five amplitudes: the motion that the paper names if it is an attractor, else the attractor "
    "with the largest basin; if chaotic, 60 drive periods. Dots are the states at phase 0."
)


def reproduce_figure_3(scene_file, show_progress):
    """Reproduce figure 3 and its claims."""
    panel_results = []
    for panel_scene_file in tqdm(panel_scene_files(scene_file), "portraits", disable=not show_progress):
        scene, attractors_table = panel_scene_file.scene.make(), panel_scene_file.attractors
        attractors = find_attractors(scene, attractors_table.starts, attractors_table.seed)
        panel_results.append((scene, _find_stable_motions(scene, attractors), unresolved_allowance(attractors)))
    claims = [_existence_claim(panel_index, *panel_result) for panel_index, panel_result in enumerate(panel_results)]
    claims.insert(SYMMETRIC_PANEL + 1, _symmetry_claim(*panel_results[SYMMETRIC_PANEL][:2]))
    claims.insert(ASYMMETRIC_PANEL + 2, _asymmetry_claim(*panel_results[ASYMMETRIC_PANEL][:2]))
    return FigureResult(_figure_png(panel_results), CAPTION, tuple(claims))


class StableMotion(NamedTuple):
    """Stable motion.

    Attributes
    ----------
    label : str
        Label of the motion.
    state : State
        State on the motion.
    periods : int
        Number of drive periods; 0 for a chaotic motion.
    orbit : Orbit or None
        Periodic orbit; None for a chaotic motion.
    share : float
        Basin fraction.
    """

    label: str
    state: State
    periods: int
    orbit: Orbit | None
    share: float


def _find_stable_motions(scene, attractors):
    """Return the stable motions: the attractors, and P100 if it is stable but not among the attractors.

    The basin of P100 may be too small to be sampled.
    """
    stable_motions = [
        StableMotion(motion.label, motion.state, motion.periods, motion.orbit, motion.share)
        for motion in attractors
        if motion.kind != "unresolved"
    ]
    frequency = float(scene.frequency)
    amplitude, damping = float(scene.amplitude), float(scene.damping)
    if amplitude < grazing_amplitude(frequency, damping) and not any(
        motion.label == "P100" for motion in stable_motions
    ):
        orbit = find_orbit(scene, State(*forced_motion_state(amplitude, frequency, damping)), periods=1, settle=0)
        stable_motions.append(StableMotion(orbit.label, orbit.state, 1, orbit, 0.0))
    return stable_motions


def _existence_claim(panel_index, scene, stable_motions, undetected_allowance):
    """Return the claim that the motion named by the paper is an attractor.

    `undetected_allowance` is the possible number of undetected attractors.
    """
    claim_text = f"{CLAIMED_LABELS[panel_index]} at A = {float(scene.amplitude):g} (number of such attractors)"
    n_matching_motions = float(sum(_has_claimed_label(panel_index, motion) for motion in stable_motions))
    reason = f"The attractors, with their shares of the starts: {basin_shares_text(stable_motions)}."
    return statement_claim(
        f"3{PANEL_LETTERS[panel_index]}",
        claim_text,
        (n_matching_motions, 0.0),
        low=1.0,
        reason=reason,
        unresolved_allowance=undetected_allowance,
    )


def _has_claimed_label(panel_index, motion):
    claimed_label = CLAIMED_LABELS[panel_index]
    return motion.label in (claimed_label, f"P{claimed_label[1]}{claimed_label[3]}{claimed_label[2]}")


def _symmetry_claim(scene, stable_motions):
    """Return the claim that the motion named by the paper is symmetric: equal impact speeds on both walls."""
    reason = "The symmetry breaks at a smaller amplitude: see SB in figure 4."
    claim_text = f"symmetric at A = {float(scene.amplitude):g} (least difference of the impact speeds on the walls)"
    least_difference = min(_wall_speed_differences(SYMMETRIC_PANEL, stable_motions), default=np.nan)
    return statement_claim(
        f"3{PANEL_LETTERS[SYMMETRIC_PANEL]}",
        claim_text,
        (least_difference, ROUNDING),
        high=ASYMMETRY_TOLERANCE,
        reason=reason,
    )


def _asymmetry_claim(scene, stable_motions):
    """Return the claim that the motion named by the paper is asymmetric."""
    claim_text = f"asymmetric at A = {float(scene.amplitude):g} (least difference of the impact speeds on the walls)"
    least_difference = min(_wall_speed_differences(ASYMMETRIC_PANEL, stable_motions), default=np.nan)
    return statement_claim(
        f"3{PANEL_LETTERS[ASYMMETRIC_PANEL]}", claim_text, (least_difference, ROUNDING), low=ASYMMETRY_TOLERANCE
    )


def _wall_speed_differences(panel_index, stable_motions):
    """Yield the difference of the mean impact speeds on the two walls for each motion with the claimed label."""
    for motion in (
        candidate_motion
        for candidate_motion in stable_motions
        if candidate_motion.orbit is not None and _has_claimed_label(panel_index, candidate_motion)
    ):
        impact_speeds, impact_sides = np.asarray(motion.orbit.impacts.speed), np.asarray(motion.orbit.impacts.side)
        yield abs(float(impact_speeds[impact_sides == -1].mean() - impact_speeds[impact_sides == 1].mean()))


def _figure_png(panel_results):
    figure, axes_grid = make_figure(2, 3, 2.2)
    for panel_index, (ax, (scene, stable_motions, _)) in enumerate(zip(axes_grid.flat, panel_results, strict=False)):
        motion = next(
            (
                candidate_motion
                for candidate_motion in stable_motions
                if _has_claimed_label(panel_index, candidate_motion)
            ),
            stable_motions[0],
        )
        plot.portrait(simulate(scene, motion.state, motion.periods or CHAOTIC_PERIODS, SAMPLES_PER_PERIOD), scene, ax)
        ax.set_title(f"({PANEL_LETTERS[panel_index]}) $A$ = {float(scene.amplitude):g}: {motion.label}", loc="left")
    for ax in axes_grid.flat[len(panel_results) :]:
        ax.set_axis_off()
    trim_axis_labels(axes_grid, has_shared_ranges=False, max_ticks=4)
    return png_bytes(figure)
