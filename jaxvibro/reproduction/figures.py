"""List the jobs: the scene files of each figure, and the function that reproduces it."""

from collections.abc import Callable
from typing import NamedTuple

from . import (
    amplitudes,
    coexistence,
    compliant,
    diagrams,
    errata,
    exponents,
    hysteresis,
    portraits,
    response,
    single_wall,
)
from . import basins as fifth
from .panels import FigureResult


class FigureJob(NamedTuple):
    """Title, names of the scene files without ending, and a function of these `SceneFile` records.

    The function returns a `panels.FigureResult`.
    """

    title: str
    files: tuple[str, ...]
    reproduce: Callable[..., FigureResult]


JOBS = {
    "fig2": FigureJob("Figure 2: hysteresis", ("fig2",), hysteresis.reproduce_figure),
    "fig3": FigureJob("Figure 3: phase portraits", ("fig3",), portraits.reproduce_figure),
    "fig4": FigureJob("Figure 4: the diagram", ("fig4",), diagrams.reproduce_figure_4),
    "fig5": FigureJob("Figure 5: basins of attraction", ("fig5", "fig4"), fifth.reproduce_figure),
    "fig6": FigureJob("Figure 6: the diagram, the drive faster", ("fig6", "fig4"), diagrams.reproduce_figure_6),
    "fig7": FigureJob("Figure 7: the diagram, unequal walls", ("fig7",), diagrams.reproduce_figure_7),
    "fig8": FigureJob("Figure 8: Lyapunov exponents", ("fig8",), exponents.reproduce_figure),
    "fig9": FigureJob("Figure 9: the compliant wall", ("fig9",), compliant.reproduce_figure),
    "fig10": FigureJob("Figure 10: the response between compliant walls", ("fig10",), response.reproduce_figure),
    "fig11": FigureJob("Figure 11: the response at four amplitudes", ("fig11",), amplitudes.reproduce_figure),
    "fig12": FigureJob("Figure 12: where two motions exist together", ("fig12",), coexistence.reproduce_figure),
    "walls": FigureJob("One wall, and a moving one", ("walls",), single_wall.reproduce_figure),
    "formulas": FigureJob("Formulas", ("formulas",), errata.reproduce_formulas),
}
