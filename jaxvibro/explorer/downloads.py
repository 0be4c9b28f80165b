"""Write the files that a page offers: figures, and the data of all results."""

import io
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import xarray as xr

from ..branches.branch import Branch
from ..branches.diagram import Diagram
from ..loci.locus import Locus
from ..orbits.orbit import Orbit
from ..output.checksums import netcdf_bytes
from ..scene.check import ArgumentError
from . import panels
from .page_state import PageState
from .screen import DRAW_FUNCTIONS, Screen, draw_arguments

PICTURE_FORMATS = ("png", "svg", "pdf")


def panel_picture(panel: str, file_format: str, page: PageState, results: Mapping[str, Any], screen: Screen) -> bytes:
    """Return the figure of a panel as a file.

    Raises ArgumentError for another panel or format, and if there is nothing to draw.
    """
    if panel not in DRAW_FUNCTIONS or file_format not in PICTURE_FORMATS:
        raise ArgumentError(
            "picture",
            f"must be one of {', '.join(DRAW_FUNCTIONS)}, as {', '.join(PICTURE_FORMATS)}",
            f"{panel}.{file_format}",
        )
    arguments = draw_arguments(panel, page, results)
    if arguments is None:
        raise ArgumentError("picture", "requires a motion. Select an orbit first", panel)
    limits = screen.limits.get(panel, panels.Limits())
    return panels.export_picture(lambda ax: DRAW_FUNCTIONS[panel](ax, *arguments), limits, file_format)


def data_archive(page: PageState, results: Mapping[str, Any]) -> bytes:
    """Return a ZIP of the data of all results: NetCDF of curves, grids and motions, and tables as text."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as zip_file:
        for line in page.lines:
            for name, content in data_files(line.name, results[line.name]):
                zip_file.writestr(name, content)
    return buffer.getvalue()


def data_files(name: str, value: Any) -> Iterator[tuple[str, bytes]]:
    """Yield (file name, content) of the data of a result."""
    if isinstance(value, Branch | Locus):
        yield f"{name}.nc", value.content
    elif isinstance(value, xr.Dataset):
        yield f"{name}.nc", netcdf_bytes(value)
    elif isinstance(value, Orbit):
        yield f"{name}.nc", netcdf_bytes(panels.trajectory_of(value))
    elif isinstance(value, Diagram):
        for k, element in enumerate(value.branches):
            yield from data_files(f"{name}.branches_{k}", element)
    elif isinstance(value, tuple):
        for k, element in enumerate(value):
            yield from data_files(f"{name}_{k}", element)
    if hasattr(value, "table"):
        yield f"{name}.txt", f"{value.table()}\n".encode()
