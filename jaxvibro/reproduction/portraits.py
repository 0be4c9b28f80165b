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
from .attractor_checks import shares_text, unresolved_excess
from .claim import statement_claim
from .closed_forms import forced_motion, grazing_amplitude
from .panels import FigureResult, figure_style, make_figure, panel_files, png_bytes, trim_labels

PANEL_LETTERS = "abcde"
CLAIMED_LABELS = ("P100", "P111", "P111", "P112", "P121")  # in the order of the panels
SYMMETRIC_PANEL, ASYMMETRIC_PANEL = 1, 2  # panels that the paper calls symmetric and asymmetric
SAMPLES_PER_PERIOD, CHAOTIC_PERIODS = 400, 60  # per drive period; drive periods of a chaotic motion
ROUNDING, ASYMMETRY_TOLERANCE = 1e-9, 1e-6  # of impact speeds; a larger difference is an asymmetry

CAPTION = (
    "Phase portraits at five amplitudes: the motion that the paper names if it is an attractor, else the attractor "
    "with the largest basin; if chaotic, 60 drive periods. Dots are the states at phase 0."
)


def reproduce_figure(file, progress):
    """Reproduce figure 3 and its claims."""
    results = []
    for panel_file in tqdm(panel_files(file), "portraits", disable=not progress):
        scene, table = panel_file.scene.make(), panel_file.attractors
        attractors = find_attractors(scene, table.starts, table.seed)
        results.append((scene, _stable_motions(scene, attractors), unresolved_excess(attractors)))
    claims = [_existence_claim(panel, *result) for panel, result in enumerate(results)]
    claims.insert(SYMMETRIC_PANEL + 1, _symmetry_claim(*results[SYMMETRIC_PANEL][:2]))
    claims.insert(ASYMMETRIC_PANEL + 2, _asymmetry_claim(*results[ASYMMETRIC_PANEL][:2]))
    with figure_style():
        return FigureResult(_picture(results), CAPTION, tuple(claims))


class StableMotion(NamedTuple):
    """Stable motion: label, state, drive periods (0 if chaotic), `Orbit` or None, and basin fraction."""

    label: str
    state: State
    periods: int
    orbit: Orbit | None
    share: float


def _stable_motions(scene, attractors):
    """Return the stable motions: the attractors, and a stable P100 whose basin may be too small to be sampled."""
    motions = [
        StableMotion(motion.label, motion.state, motion.periods, motion.orbit, motion.share)
        for motion in attractors
        if motion.kind != "unresolved"
    ]
    frequency = float(scene.frequency)
    amplitude, damping = float(scene.amplitude), float(scene.damping)
    if amplitude < grazing_amplitude(frequency, damping) and not any(motion.label == "P100" for motion in motions):
        orbit = find_orbit(scene, State(*forced_motion(amplitude, frequency, damping)), periods=1, settle=0)
        motions.append(StableMotion(orbit.label, orbit.state, 1, orbit, 0.0))
    return motions


def _existence_claim(panel, scene, motions, excess):
    """Return the claim that the named motion is an attractor; `excess` allows for unresolved ones."""
    text = f"{CLAIMED_LABELS[panel]} at A = {float(scene.amplitude):g} (number of such attractors)"
    n_matching = float(sum(_matches_claim(panel, motion) for motion in motions))
    reason = f"The attractors, with their shares of the starts: {shares_text(motions)}."
    return statement_claim(f"3{PANEL_LETTERS[panel]}", text, (n_matching, 0.0), low=1.0, reason=reason, excess=excess)


def _matches_claim(panel, motion):
    label = CLAIMED_LABELS[panel]
    return motion.label in (label, f"P{label[1]}{label[3]}{label[2]}")


def _symmetry_claim(scene, motions):
    """Return the claim that a named motion is symmetric, with equal impact speeds on both walls."""
    reason = "The symmetry breaks at a smaller amplitude: see SB in figure 4."
    text = f"symmetric at A = {float(scene.amplitude):g} (least difference of the impact speeds on the walls)"
    difference = min(_speed_differences(SYMMETRIC_PANEL, motions), default=np.nan)
    return statement_claim(
        f"3{PANEL_LETTERS[SYMMETRIC_PANEL]}", text, (difference, ROUNDING), high=ASYMMETRY_TOLERANCE, reason=reason
    )


def _asymmetry_claim(scene, motions):
    """Return the claim that a named motion is asymmetric."""
    text = f"asymmetric at A = {float(scene.amplitude):g} (least difference of the impact speeds on the walls)"
    difference = min(_speed_differences(ASYMMETRIC_PANEL, motions), default=np.nan)
    return statement_claim(f"3{PANEL_LETTERS[ASYMMETRIC_PANEL]}", text, (difference, ROUNDING), low=ASYMMETRY_TOLERANCE)


def _speed_differences(panel, motions):
    """Yield the difference of the impact speeds on the two walls for each motion that matches the claim."""
    for motion in (
        candidate for candidate in motions if candidate.orbit is not None and _matches_claim(panel, candidate)
    ):
        speed, side = np.asarray(motion.orbit.impacts.speed), np.asarray(motion.orbit.impacts.side)
        yield abs(float(speed[side == -1].mean() - speed[side == 1].mean()))


def _picture(results):
    figure, axes_grid = make_figure(2, 3, 2.2)
    for panel, (ax, (scene, motions, _)) in enumerate(zip(axes_grid.flat, results, strict=False)):
        motion = next((candidate for candidate in motions if _matches_claim(panel, candidate)), motions[0])
        plot.portrait(simulate(scene, motion.state, motion.periods or CHAOTIC_PERIODS, SAMPLES_PER_PERIOD), scene, ax)
        ax.set_title(f"({PANEL_LETTERS[panel]}) $A$ = {float(scene.amplitude):g}: {motion.label}", loc="left")
    for ax in axes_grid.flat[len(results) :]:
        ax.set_axis_off()
    trim_labels(axes_grid, shared=False, max_ticks=4)
    return png_bytes(figure)
