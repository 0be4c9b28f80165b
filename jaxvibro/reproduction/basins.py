"""Reproduce figure 5: basins of attraction, and the stable manifolds of the saddles between them."""

import numpy as np
import scipy
from tqdm import tqdm

from .. import plot
from ..attractors.basins import basins
from ..attractors.find import find_attractors
from ..attractors.manifold import manifold
from ..branches.explore import explore
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from .attractor_checks import basin_shares_text, unresolved_allowance
from .claim import additional_claim, statement_claim
from .figure_panels import FigureResult, make_figure, panel_scene_files, png_bytes, trim_axis_labels

PANEL_LETTERS = "ab"
SAMPLES_PER_CELL = 4  # samples of a manifold per width of a cell
MANIFOLD_LENGTH = 60.0  # length of a manifold on each side of a saddle

CAPTION = (
    "Basins of attraction on the section at phase 0, at the amplitude of the paper's figure (a) and at one with "
    "chaotic and periodic attractors (b). Chaos is white. Lines are the stable manifolds of the saddles."
)


def reproduce_figure_5(scene_file, diagram_scene_file, show_progress):
    """Reproduce figure 5 and its claims.

    `scene_file` is the scene file of the figure. The saddles are taken from the bifurcation diagram of
    `diagram_scene_file`."""
    explore_table = diagram_scene_file.explore
    diagram = explore(
        diagram_scene_file.scene.make(),
        explore_table.parameter,
        explore_table.bounds,
        explore_table.max_period,
        explore_table.seed,
    )
    panel_results, claims = [], []
    for panel_scene_file in tqdm(panel_scene_files(scene_file), "basins", disable=not show_progress):
        scene, basins_table = panel_scene_file.scene.make(), panel_scene_file.basins
        attractors = find_attractors(scene, basins_table.starts, basins_table.seed)
        basin_data = basins(scene, *basins_table.grid, basins_table.phase, attractors)
        manifold_by_saddle = {
            saddle: manifold(saddle, "stable", MANIFOLD_LENGTH, basins_table.phase)
            for saddle in find_saddles(scene, diagram)
        }
        panel_results.append((scene, basin_data, manifold_by_saddle))
        claims += _chaos_claims(scene, attractors, len(panel_results) == 1)
    claims += _boundary_claims(*panel_results[0])
    return FigureResult(
        _figure_png(panel_results),
        CAPTION,
        tuple(claims),
        {
            f".{panel_letter}": panel_result[1]
            for panel_letter, panel_result in zip(PANEL_LETTERS, panel_results, strict=True)
        },
    )


def find_saddles(scene, diagram):
    """Return the saddles of period one on a diagram, at the amplitude of a scene.

    These saddles have a real multiplier above 1.
    """
    scene_amplitude, saddles = float(scene.parameter(diagram.name)), []
    for branch in diagram.branches:
        if branch.data.sizes["period"] > 1:
            continue
        amplitude_offsets = branch.values - scene_amplitude
        for row in np.flatnonzero(amplitude_offsets[:-1] * amplitude_offsets[1:] <= 0):
            orbit = _find_orbit_between(scene, branch, int(row))
            if orbit is None:
                continue
            larger_multiplier = orbit.multipliers[0]
            is_known = any(
                abs(orbit.state.x - saddle.state.x) + abs(orbit.state.v - saddle.state.v) < 1e-6 for saddle in saddles
            )
            if not larger_multiplier.imag and larger_multiplier.real > 1 and not is_known:
                saddles.append(orbit)
    return saddles


def _find_orbit_between(scene, branch, first_row):
    """Return the orbit of a scene between two consecutive points of a branch.

    Newton's method starts at the first point, then at the second. The result is None if neither start leads to an orbit
    with the label of the starting point.
    """
    for neighbour_orbit in (branch.orbit(first_row), branch.orbit(first_row + 1)):
        try:
            orbit = find_orbit(scene, neighbour_orbit.state, periods=1, settle=0)
        except OrbitError:
            continue
        if orbit.label == neighbour_orbit.label:
            return orbit
    return None


def _chaos_claims(scene, attractors, is_paper_amplitude):
    """Yield the claims on chaotic attractors.

    `is_paper_amplitude` is True at the amplitude of the paper, and False at the additional amplitude.
    """
    n_chaotic = sum(attractor.kind == "chaotic" for attractor in attractors)
    amplitude, allowance = float(scene.amplitude), unresolved_allowance(attractors)
    reason = f"The attractors are {basin_shares_text(attractors)}."
    if is_paper_amplitude:
        claim_text = f"white is a chaotic attractor, A = {amplitude:g} (number of chaotic attractors)"
        yield statement_claim(
            "5", claim_text, (float(n_chaotic), 0.0), low=1.0, reason=reason, unresolved_allowance=allowance
        )
        return
    n_chaotic_periodic_pairs = float(min(n_chaotic, sum(attractor.kind == "periodic" for attractor in attractors)))
    claim_text = (
        f"such a figure is at A = {amplitude:g}: {basin_shares_text(attractors)} (pairs of chaotic and"
        " periodic attractors)"
    )
    yield additional_claim(
        "5", claim_text, (n_chaotic_periodic_pairs, 0.0), low=1.0, reason=reason, unresolved_allowance=allowance
    )
    n_chaotic_mirrors = sum(
        attractor.kind == "chaotic" and attractor.mirror_of not in (None, index)
        for index, attractor in enumerate(attractors)
    )
    claim_text = f"two chaotic attractors at A = {amplitude:g} that are mirror images (number of them)"
    yield additional_claim(
        "5",
        claim_text,
        (float(n_chaotic_mirrors), 0.0),
        low=2.0,
        high=2.0,
        reason=reason,
        unresolved_allowance=allowance,
    )


def _boundary_claims(scene, basin_data, manifold_by_saddle):
    """Yield two claims: the basin boundary is the stable manifold of the symmetric saddle, or those of all saddles."""
    symmetric_manifolds = [
        manifold_data for saddle, manifold_data in manifold_by_saddle.items() if saddle.label == "P111"
    ]
    share_elsewhere, n_boundary_cells = boundary_share_elsewhere(basin_data, symmetric_manifolds)
    other_saddle_labels = ", ".join(sorted({saddle.label for saddle in manifold_by_saddle} - {"P111"}))
    reason = f"The rest of the boundary consists of stable manifolds of the saddles {other_saddle_labels}, born in SN2."
    claim_text = (
        "the boundary is the stable manifold of the unstable symmetric motion (share of the boundary cells elsewhere)"
    )
    share_error = np.sqrt(share_elsewhere * (1.0 - share_elsewhere) / n_boundary_cells)
    yield statement_claim("5", claim_text, (share_elsewhere, float(share_error)), high=1e-3, reason=reason)
    share_elsewhere, n_boundary_cells = boundary_share_elsewhere(basin_data, list(manifold_by_saddle.values()))
    claim_text = (
        f"it is the stable manifolds of all {len(manifold_by_saddle)} saddles (share of the"
        f" {n_boundary_cells} boundary cells elsewhere)"
    )
    yield additional_claim(
        "5",
        claim_text,
        (share_elsewhere, float(np.sqrt(share_elsewhere * (1.0 - share_elsewhere) / n_boundary_cells))),
        high=1e-3,
    )


def boundary_share_elsewhere(basin_data, manifolds):
    """Return (fraction of the boundary cells more than one cell from all manifolds, number of boundary cells)."""
    cell_labels = basin_data["label"].values
    is_boundary = np.zeros(cell_labels.shape, bool)
    for axis in (0, 1):
        differs_from_next = np.diff(cell_labels, axis=axis) != 0
        lower_slices, upper_slices = (
            (slice(None), slice(start, stop)) if axis else (slice(start, stop),)
            for start, stop in ((None, -1), (1, None))
        )
        is_boundary[lower_slices] |= differs_from_next
        is_boundary[upper_slices] |= differs_from_next
    is_near_manifold = np.zeros(cell_labels.shape, bool)
    for manifold_data in manifolds:
        is_near_manifold[tuple(_manifold_cells(basin_data, manifold_data))] = True
    is_near_manifold = scipy.ndimage.binary_dilation(is_near_manifold, np.ones((3, 3), bool))
    return float((is_boundary & ~is_near_manifold).sum() / max(1, is_boundary.sum())), int(is_boundary.sum())


def _manifold_cells(basin_data, manifold_data):
    """Return the row and column indices of the cells through which a manifold passes, shape (2, samples)."""
    cell_sizes = [
        float(basin_data[coordinate_name][1] - basin_data[coordinate_name][0]) for coordinate_name in ("v", "x")
    ]
    cell_positions = np.stack(
        [
            (manifold_data[coordinate_name].values - float(basin_data[coordinate_name][0])) / cell_size
            for coordinate_name, cell_size in zip(("v", "x"), cell_sizes, strict=True)
        ]
    )
    position_steps = np.diff(cell_positions, axis=1)
    is_same_piece = np.diff(manifold_data["piece"].values) == 0
    n_samples_per_step = (
        np.where(is_same_piece, np.ceil(SAMPLES_PER_CELL * abs(position_steps).max(axis=0)), 0).astype(int) + 1
    )
    step_fractions = np.concatenate(
        [np.arange(n_step_samples) / n_step_samples for n_step_samples in n_samples_per_step]
    )
    sample_positions = np.repeat(cell_positions[:, :-1], n_samples_per_step, axis=1) + step_fractions * np.repeat(
        position_steps, n_samples_per_step, axis=1
    )
    sample_cells = np.round(sample_positions).astype(int)
    is_inside = np.all((sample_cells >= 0) & (sample_cells < np.array(basin_data["label"].shape)[:, None]), axis=0)
    return sample_cells[:, is_inside]


def _figure_png(panel_results):
    figure, axes_grid = make_figure(1, len(panel_results), 4.6)
    for ax, panel_letter, (scene, basin_data, manifold_by_saddle) in zip(
        axes_grid.flat, PANEL_LETTERS, panel_results, strict=True
    ):
        plot.basins(basin_data, ax)
        legend = ax.get_legend()
        legend_texts = [legend_text.get_text() for legend_text in legend.texts]
        legend_options = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "frameon": False}
        ax.legend(handles=legend.legend_handles, labels=legend_texts, **legend_options)
        for manifold_data in manifold_by_saddle.values():
            plot.manifold(manifold_data, ax)
        ax.set_title(f"({panel_letter}) $A$ = {float(scene.amplitude):g}", loc="left")
    trim_axis_labels(axes_grid, max_ticks=3)
    return png_bytes(figure)
