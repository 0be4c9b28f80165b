"""The figures and what else is judged: the scene files that each needs, and what computes it."""

from collections.abc import Callable
from typing import NamedTuple

from . import amplitudes, compliant, diagrams, edges, errata, exponents, hysteresis, portraits, response, walls
from . import basins as fifth
from .panels import Drawn


class Job(NamedTuple):
    """files: names of scene files, without ending; drawn: called with them as `SceneFile`s, gives a `panels.Drawn`."""

    title: str
    files: tuple[str, ...]
    drawn: Callable[..., Drawn]


JOBS = {
    "fig2": Job("Figure 2: hysteresis", ("fig2",), hysteresis.drawn),
    "fig3": Job("Figure 3: phase portraits", ("fig3",), portraits.drawn),
    "fig4": Job("Figure 4: the diagram", ("fig4",), diagrams.fourth),
    "fig5": Job("Figure 5: basins of attraction", ("fig5", "fig4"), fifth.drawn),
    "fig6": Job("Figure 6: the diagram, the drive faster", ("fig6", "fig4"), diagrams.sixth),
    "fig7": Job("Figure 7: the diagram, unequal walls", ("fig7",), diagrams.seventh),
    "fig8": Job("Figure 8: Lyapunov exponents", ("fig8",), exponents.drawn),
    "fig9": Job("Figure 9: the compliant wall", ("fig9",), compliant.drawn),
    "fig10": Job("Figure 10: the response between compliant walls", ("fig10",), response.drawn),
    "fig11": Job("Figure 11: the response at four amplitudes", ("fig11",), amplitudes.drawn),
    "fig12": Job("Figure 12: where two motions exist together", ("fig12",), edges.drawn),
    "walls": Job("One wall, and a moving one", ("walls",), walls.drawn),
    "formulas": Job("Formulas", ("formulas",), errata.drawn),
}
