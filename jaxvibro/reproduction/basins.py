"""Reproduce figure 5: basins of attraction, and the manifolds of the saddles between them."""

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
from .attractor_checks import shares_text, unresolved_excess
from .claim import own_claim, statement_claim
from .panels import FigureResult, figure_style, make_figure, panel_files, png_bytes, trim_labels

PANEL_LETTERS = "ab"
SAMPLES_PER_CELL = 4  # samples of a manifold per width of a cell
MANIFOLD_LENGTH = 60.0  # length of a manifold on each side of a saddle

CAPTION = (
    "Basins of attraction on the section at phase 0, at the amplitude of the paper's figure (a) and at one with "
    "chaotic and periodic attractors (b). Chaos is white. Lines are the stable manifolds of the saddles."
)


def reproduce_figure(file, diagram_file, progress):
    """Reproduce figure 5 and its claims; `diagram_file` is the scene file of the diagram with the saddles."""
    explore_table = diagram_file.explore
    diagram = explore(
        diagram_file.scene.make(),
        explore_table.parameter,
        explore_table.bounds,
        explore_table.max_period,
        explore_table.seed,
    )
    results, claims = [], []
    for panel_file in tqdm(panel_files(file), "basins", disable=not progress):
        scene, basins_table = panel_file.scene.make(), panel_file.basins
        attractors = find_attractors(scene, basins_table.starts, basins_table.seed)
        basin_data = basins(scene, *basins_table.grid, basins_table.phase, attractors)
        manifolds = {
            orbit: manifold(orbit, "stable", MANIFOLD_LENGTH, basins_table.phase)
            for orbit in find_saddles(scene, diagram)
        }
        results.append((scene, basin_data, manifolds))
        claims += _chaos_claims(scene, attractors, len(results) == 1)
    claims += _boundary_claims(*results[0])
    with figure_style():
        return FigureResult(
            _picture(results),
            CAPTION,
            tuple(claims),
            {f".{letter}": result[1] for letter, result in zip(PANEL_LETTERS, results, strict=True)},
        )


def find_saddles(scene, diagram):
    """Return the orbits of one period with a multiplier above 1, on a diagram at the amplitude of a scene."""
    amplitude, saddles = float(scene.parameter(diagram.name)), []
    for branch in diagram.branches:
        if branch.data.sizes["period"] > 1:
            continue
        offsets = branch.values - amplitude
        for row in np.flatnonzero(offsets[:-1] * offsets[1:] <= 0):
            orbit = _orbit_between(scene, branch, int(row))
            if orbit is None:
                continue
            multiplier = orbit.multipliers[0]
            is_known = any(
                abs(orbit.state.x - saddle.state.x) + abs(orbit.state.v - saddle.state.v) < 1e-6 for saddle in saddles
            )
            if not multiplier.imag and multiplier.real > 1 and not is_known:
                saddles.append(orbit)
    return saddles


def _orbit_between(scene, branch, row):
    """Return the orbit between two consecutive points of a branch, found from either; None if neither leads to it."""
    for neighbour in (branch.orbit(row), branch.orbit(row + 1)):
        try:
            orbit = find_orbit(scene, neighbour.state, periods=1, settle=0)
        except OrbitError:
            continue
        if orbit.label == neighbour.label:
            return orbit
    return None


def _chaos_claims(scene, attractors, claimed_by_paper):
    """Yield the claims on chaotic attractors, at the amplitude of the paper and at ours."""
    n_chaotic = sum(attractor.kind == "chaotic" for attractor in attractors)
    amplitude, excess = float(scene.amplitude), unresolved_excess(attractors)
    reason = f"The attractors are {shares_text(attractors)}."
    if claimed_by_paper:
        text = f"white is a chaotic attractor, A = {amplitude:g} (number of chaotic attractors)"
        yield statement_claim("5", text, (float(n_chaotic), 0.0), low=1.0, reason=reason, excess=excess)
        return
    n_pairs = float(min(n_chaotic, sum(attractor.kind == "periodic" for attractor in attractors)))
    text = (
        f"such a figure is at A = {amplitude:g}: {shares_text(attractors)} (pairs of chaotic and periodic attractors)"
    )
    yield own_claim("5", text, (n_pairs, 0.0), low=1.0, reason=reason, excess=excess)
    n_mirror_images = sum(
        attractor.kind == "chaotic" and attractor.mirror_of not in (None, k) for k, attractor in enumerate(attractors)
    )
    text = f"two chaotic attractors at A = {amplitude:g} that are mirror images (number of them)"
    yield own_claim("5", text, (float(n_mirror_images), 0.0), low=2.0, high=2.0, reason=reason, excess=excess)


def _boundary_claims(scene, basin_data, manifolds):
    """Yield the claims that the basin boundary is the stable manifold of the symmetric saddle, or of all saddles."""
    symmetric_manifolds = [curve for orbit, curve in manifolds.items() if orbit.label == "P111"]
    share, n_cells = share_beyond(basin_data, symmetric_manifolds)
    other_labels = ", ".join(sorted({orbit.label for orbit in manifolds} - {"P111"}))
    reason = f"The rest of the boundary consists of stable manifolds of the saddles {other_labels}, born in SN2."
    text = (
        "the boundary is the stable manifold of the unstable symmetric motion (share of the boundary cells elsewhere)"
    )
    error = np.sqrt(share * (1.0 - share) / n_cells)
    yield statement_claim("5", text, (share, float(error)), high=1e-3, reason=reason)
    share, n_cells = share_beyond(basin_data, list(manifolds.values()))
    text = (
        f"it is the stable manifolds of all {len(manifolds)} saddles (share of the {n_cells} boundary cells elsewhere)"
    )
    yield own_claim("5", text, (share, float(np.sqrt(share * (1.0 - share) / n_cells))), high=1e-3)


def share_beyond(basin_data, manifolds):
    """Return (fraction of the boundary cells that are more than one cell from all curves, number of boundary cells)."""
    labels = basin_data["label"].values
    is_boundary = np.zeros(labels.shape, bool)
    for axis in (0, 1):
        differs = np.diff(labels, axis=axis) != 0
        lower_cells, upper_cells = (
            (slice(None), slice(start, stop)) if axis else (slice(start, stop),)
            for start, stop in ((None, -1), (1, None))
        )
        is_boundary[lower_cells] |= differs
        is_boundary[upper_cells] |= differs
    is_near = np.zeros(labels.shape, bool)
    for curve in manifolds:
        is_near[tuple(_manifold_cells(basin_data, curve))] = True
    is_near = scipy.ndimage.binary_dilation(is_near, np.ones((3, 3), bool))
    return float((is_boundary & ~is_near).sum() / max(1, is_boundary.sum())), int(is_boundary.sum())


def _manifold_cells(basin_data, curve):
    """Return (rows, columns) of the cells through which a manifold passes."""
    cell_sizes = [float(basin_data[key][1] - basin_data[key][0]) for key in ("v", "x")]
    positions = np.stack(
        [
            (curve[key].values - float(basin_data[key][0])) / size
            for key, size in zip(("v", "x"), cell_sizes, strict=True)
        ]
    )
    steps = np.diff(positions, axis=1)
    is_joined = np.diff(curve["piece"].values) == 0
    n_samples = np.where(is_joined, np.ceil(SAMPLES_PER_CELL * abs(steps).max(axis=0)), 0).astype(int) + 1
    fractions = np.concatenate([np.arange(n) / n for n in n_samples])
    points = np.repeat(positions[:, :-1], n_samples, axis=1) + fractions * np.repeat(steps, n_samples, axis=1)
    cells = np.round(points).astype(int)
    inside = np.all((cells >= 0) & (cells < np.array(basin_data["label"].shape)[:, None]), axis=0)
    return cells[:, inside]


def _picture(results):
    figure, axes_grid = make_figure(1, len(results), 4.6)
    for ax, letter, (scene, basin_data, manifolds) in zip(axes_grid.flat, PANEL_LETTERS, results, strict=True):
        plot.basins(basin_data, ax)
        legend = ax.get_legend()
        texts = [text.get_text() for text in legend.texts]
        legend_options = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "frameon": False}
        ax.legend(handles=legend.legend_handles, labels=texts, **legend_options)
        for curve in manifolds.values():
            plot.manifold(curve, ax)
        ax.set_title(f"({letter}) $A$ = {float(scene.amplitude):g}", loc="left")
    trim_labels(axes_grid, max_ticks=3)
    return png_bytes(figure)
