"""What can be taken from the page: its pictures, and the data of all results."""

import io
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import xarray as xr

from ..branches.branch import Branch
from ..branches.diagram import Diagram
from ..loci.locus import Locus
from ..orbits.orbit import Orbit
from ..output.checksums import netcdf
from ..scene.check import ArgumentError
from . import panels
from .screen import DRAW, Screen, parts_of
from .shown import Shown

KINDS = ("png", "svg", "pdf")


def picture(panel: str, kind: str, now: Shown, results: Mapping[str, Any], screen: Screen) -> bytes:
    """A panel as a file. Raises ArgumentError for another panel or kind, and where there is nothing to draw."""
    if panel not in DRAW or kind not in KINDS:
        raise ArgumentError("picture", f"must be one of {', '.join(DRAW)}, as {', '.join(KINDS)}", f"{panel}.{kind}")
    parts = parts_of(panel, now, results)
    if parts is None:
        raise ArgumentError("picture", "must be of something: there is no orbit yet", panel)
    limits = screen.limits.get(panel, panels.Limits())
    return panels.exported(lambda ax: DRAW[panel](ax, *parts), limits, kind)


def archive(now: Shown, results: Mapping[str, Any]) -> bytes:
    """The data of all results as one ZIP: NetCDF of curves, grids and motions, tables as texts."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        for line in now.lines:
            for name, part in files_of(line.name, results[line.name]):
                file.writestr(name, part)
    return content.getvalue()


def files_of(name: str, value: Any) -> Iterator[tuple[str, bytes]]:
    """(file name, content) of a result's data."""
    if isinstance(value, Branch | Locus):
        yield f"{name}.nc", value.content
    elif isinstance(value, xr.Dataset):
        yield f"{name}.nc", netcdf(value)
    elif isinstance(value, Orbit):
        yield f"{name}.nc", netcdf(panels.motion_of(value))
    elif isinstance(value, Diagram):
        for k, one in enumerate(value.branches):
            yield from files_of(f"{name}.branches_{k}", one)
    elif isinstance(value, tuple):
        for k, one in enumerate(value):
            yield from files_of(f"{name}_{k}", one)
    if hasattr(value, "table"):
        yield f"{name}.txt", f"{value.table()}\n".encode()
