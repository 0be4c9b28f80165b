"""List the figures of the paper with their scene files and the functions that reproduce them."""

from collections.abc import Callable
from typing import NamedTuple

from . import basins as fifth
from . import (
    bifurcation_diagrams,
    coexistence,
    compliant_walls,
    errata,
    exponents,
    frequency_response,
    hysteresis,
    phase_portraits,
    single_wall,
)
from .figure_panels import FigureResult


class FigureJob(NamedTuple):
    """Figure or set of claims to reproduce.

    Attributes
    ----------
    title : str
        Title in the report.
    files : tuple of str
        Names of the scene files, without ``.toml``.
    reproduce : callable
        Function of the `SceneFile` records and the flag `show_progress` that returns a `figure_panels.FigureResult`.
    """

    title: str
    files: tuple[str, ...]
    reproduce: Callable[..., FigureResult]


JOBS = {
    "fig2": FigureJob("Figure 2: hysteresis", ("fig2",), hysteresis.reproduce_figure_2),
    "fig3": FigureJob("Figure 3: phase portraits", ("fig3",), phase_portraits.reproduce_figure_3),
    "fig4": FigureJob("Figure 4: the diagram", ("fig4",), bifurcation_diagrams.reproduce_figure_4),
    "fig5": FigureJob("Figure 5: basins of attraction", ("fig5", "fig4"), fifth.reproduce_figure_5),
    "fig6": FigureJob(
        "Figure 6: the diagram, the drive faster", ("fig6", "fig4"), bifurcation_diagrams.reproduce_figure_6
    ),
    "fig7": FigureJob("Figure 7: the diagram, unequal walls", ("fig7",), bifurcation_diagrams.reproduce_figure_7),
    "fig8": FigureJob("Figure 8: Lyapunov exponents", ("fig8",), exponents.reproduce_figure_8),
    "fig9": FigureJob("Figure 9: the compliant wall", ("fig9",), compliant_walls.reproduce_figure_9),
    "fig10": FigureJob(
        "Figure 10: the response between compliant walls", ("fig10",), frequency_response.reproduce_figure_10
    ),
    "fig11": FigureJob(
        "Figure 11: the response at four amplitudes", ("fig11",), frequency_response.reproduce_figure_11
    ),
    "fig12": FigureJob("Figure 12: where two motions exist together", ("fig12",), coexistence.reproduce_figure_12),
    "walls": FigureJob("One wall, and a moving one", ("walls",), single_wall.reproduce_wall_diagrams),
    "formulas": FigureJob("Formulas", ("formulas",), errata.reproduce_formulas),
}
