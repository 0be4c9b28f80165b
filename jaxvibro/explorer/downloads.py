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
from .page_screen import DRAW_FUNCTIONS, Screen, draw_arguments
from .page_state import PageState

PICTURE_FORMATS = ("png", "svg", "pdf")


def panel_picture(panel: str, file_format: str, page: PageState, results: Mapping[str, Any], screen: Screen) -> bytes:
    """Return the figure of a panel as a file.

    Raises ArgumentError for an unknown panel or format, and if there is nothing to draw.
    """
    if panel not in DRAW_FUNCTIONS or file_format not in PICTURE_FORMATS:
        raise ArgumentError(
            "picture",
            f"must be one of {', '.join(DRAW_FUNCTIONS)}, as {', '.join(PICTURE_FORMATS)}",
            f"{panel}.{file_format}",
        )
    panel_arguments = draw_arguments(panel, page, results)
    if panel_arguments is None:
        raise ArgumentError("picture", "requires a motion. Select an orbit first", panel)
    limits = screen.limits.get(panel, panels.AxisLimits())
    return panels.export_picture(lambda ax: DRAW_FUNCTIONS[panel](ax, *panel_arguments), limits, file_format)


def data_archive(page: PageState, results: Mapping[str, Any]) -> bytes:
    """Return a ZIP archive of all results: NetCDF files of curves, grids and motions, and tables as text."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as zip_file:
        for call_line in page.lines:
            for file_name, content in result_data_files(call_line.name, results[call_line.name]):
                zip_file.writestr(file_name, content)
    return buffer.getvalue()


def result_data_files(result_name: str, result: Any) -> Iterator[tuple[str, bytes]]:
    """Yield (file name, content) of the data of a result."""
    if isinstance(result, Branch | Locus):
        yield f"{result_name}.nc", result.content
    elif isinstance(result, xr.Dataset):
        yield f"{result_name}.nc", netcdf_bytes(result)
    elif isinstance(result, Orbit):
        yield f"{result_name}.nc", netcdf_bytes(panels.trajectory_of_motion(result))
    elif isinstance(result, Diagram):
        for index, member_result in enumerate(result.branches):
            yield from result_data_files(f"{result_name}.branches_{index}", member_result)
    elif isinstance(result, tuple):
        for index, member_result in enumerate(result):
            yield from result_data_files(f"{result_name}_{index}", member_result)
    if hasattr(result, "table"):
        yield f"{result_name}.txt", f"{result.table()}\n".encode()
