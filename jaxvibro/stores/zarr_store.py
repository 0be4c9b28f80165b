"""Studies kept in a folder, a Zarr store (format 3) that xarray opens: killed at any moment, the next run goes on.

Each chunk is written by one worker, its files beside their places and renamed into them; then the chunk's entry in
`done`, which is a digest of these files: it says that the chunk is there, and whether it is what was written. A chunk
of blanks has no files, so that files alone would tell nothing. The store is made beside its place too, whole or not at
all, and seals what does not change in it.

Processes may share a store. Of those that create it at once the first to finish wins, and the others use its store once
they have checked that it is of the same study. Whoever writes a chunk holds a shared lock on the store's metadata file,
so that unfinished files are removed only while no chunk is being written.
"""

import errno
import hashlib
import json
import os
import shutil
import warnings
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib.metadata import version
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from .. import __version__
from ..output.atomic_folder import complete_folder, remove_abandoned
from ..output.checksums import BLANK, is_sealed, sealed
from ..output.file_lock import exclusive_lock, shared_lock
from ..scene import check
from .engines import Engine, LocalEngine
from .study import Grid, Study, size_in_bytes

FORMAT = 1
DONE, UNDECIDED = "done", "undecided"  # arrays beside the columns, an entry a chunk
NOT_DONE = 0
CHUNK = "chunk"  # their dimension
OURS = "jaxvibro_store"  # the attribute that tells such a store
SEAL, BASE = "checksum", "base"  # attributes: of the file that holds them; of all others that do not change
METADATA, CHUNKS = "zarr.json", "c"  # as Zarr names an array's description, and the folder of its chunks
PARTS = ".partial"  # how the names of Zarr's unfinished files end
VERSIONS = ("jax", "numpy", "scipy")  # whose results are only alike to rounding from one version to another


@dataclass(frozen=True)
class Store:
    """A folder in which a study is kept as it is worked out, chunk by chunk, and the engine that does so.

    path: of a Zarr store (format 3), made where it is missing; where it is there already, what it lacks is added, and
    a store of another study is refused. engine: `LocalEngine` (all devices of this process) or `DaskEngine`. The bits
    of a store are the same whichever engine, however many workers, and however often it was killed. A chunk that is
    not what was written is told, and done anew.

    `load_store` reads it, half done too, and so does xarray: `xarray.open_zarr(path, consolidated=False)`.
    """

    path: str | PathLike[str]
    engine: Engine = field(default_factory=LocalEngine)

    def open(self, study: Study) -> "Kept":
        """The store, open for a study; made where it is not there. Raises ArgumentError and OSError."""
        path = Path(self.path)
        remove_abandoned(path)
        if not os.path.lexists(path):
            _make(path, study)
        kept = Kept(str(path))
        kept.require(study)
        kept.sweep_up()
        for number in kept.damaged():
            warnings.warn(f"{path}: chunk {number} is not what was written, and is done anew", stacklevel=2)
            kept.forget(number)
        return kept


@dataclass(frozen=True)
class Kept:
    """A store that is there, as any process opens it. path: of the folder."""

    path: str

    def __reduce__(self):
        return Kept, (self.path,)

    @cached_property
    def group(self) -> zarr.Group:
        """Of Zarr, for reading and writing. Raises ArgumentError for what is no store of ours, or no longer what was
        written, OSError where it cannot be read."""
        place = Path(self.path)
        if not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), self.path)
        os.listdir(place)
        try:
            group = zarr.open_group(self.path, mode="r+", zarr_format=3)
            told = json.loads(str(group.attrs[OURS]))
            number, base = told["format"], group.attrs[BASE]
        except Exception as error:  # whatever Zarr falls over
            raise _refused(f"must be a store of jaxvibro ({type(error).__name__})", place) from None
        if number != FORMAT:
            raise _refused(f"must be of format {FORMAT}", f"format {number} in {place}")
        if not is_sealed((place / METADATA).read_bytes(), place) or base != _base(place, told["columns"]):
            raise _refused("must be as it was written, which its checksum says it is not", place)
        return group

    @cached_property
    def arrays(self) -> dict[str, zarr.Array]:
        """Those that are filled, by name."""
        return {name: array for name, array in self.group.arrays() if name in (*self.told["columns"], DONE, UNDECIDED)}

    @cached_property
    def told(self) -> dict[str, Any]:
        """What the store says of itself: format, identity, versions, columns, sizes, chunk."""
        return json.loads(str(self.group.attrs[OURS]))

    @cached_property
    def frame(self) -> xr.Dataset:
        """The study's frame, as it was when the store was made."""
        data = self._opened().drop_vars([*self.told["columns"], DONE, UNDECIDED]).load()
        data.attrs = {name: one for name, one in data.attrs.items() if name not in (OURS, SEAL, BASE)}
        return data

    def _opened(self):
        return xr.open_zarr(self.path, consolidated=False, chunks=None, decode_cf=False).set_coords(self.told["coords"])

    def require(self, study: Study) -> None:
        """Refuse another study's store, and one of other versions. Raises ArgumentError."""
        there, here = self.told, _told(study)
        for name, mine in here["identity"].items():
            theirs = there["identity"].get(name)
            if theirs != mine:
                raise _refused(f"must hold this study: {name} is another there", _difference(theirs, mine))
        for name in ("identity", "columns", "sizes", "chunk"):
            if there[name] != here[name]:
                raise _refused(f"must hold this study: its {name} are others", there[name])
        self._require_versions()

    def _require_versions(self):
        there = self.told["versions"]
        for name, mine in _versions().items():
            if there.get(name) != mine:
                rule = "must be gone on with by the versions that began it, whose bits it has"
                raise _refused(rule, f"{name} {there.get(name)}, here {mine}")

    def sweep_up(self) -> None:
        """Remove what a killed worker left unfinished, unless another process is writing a chunk at this moment."""
        with exclusive_lock(Path(self.path, METADATA)) as alone:
            for part in Path(self.path).rglob(f"*{PARTS}") if alone else ():
                part.unlink(missing_ok=True)

    def undecided(self) -> dict[int, int]:
        """{number: undecided cells} of the chunks that are done."""
        there, counts = np.flatnonzero(self._entries(DONE) != NOT_DONE), self._entries(UNDECIDED)
        return {number: int(counts[number]) for number in there.tolist()}

    def _entries(self, name):
        """An array with an entry a chunk, looked for where there is a file; what cannot be read is not there either."""
        entries, folder = self.arrays[name], Path(self.path, name, CHUNKS)
        found = np.full(entries.shape, NOT_DONE, entries.dtype)
        files = [int(file) for file in os.listdir(folder) if file.isdecimal()] if folder.is_dir() else []
        there = sorted(number for number in files if number < len(found))
        try:
            found[there] = entries.get_orthogonal_selection(there) if there else []
        except Exception:  # a damaged file, whatever Zarr's codecs fall over
            found[there] = [self._entry(name, number) for number in there]
        return found

    def _entry(self, name, number):
        try:
            return np.asarray(self.arrays[name][number : number + 1])[0]
        except Exception:  # as above
            return NOT_DONE

    def undecided_of(self, number: int) -> int | None:
        """Undecided cells of a chunk that is done, None of another."""
        return int(self._entry(UNDECIDED, number)) if self._entry(DONE, number) != NOT_DONE else None

    def put(self, number: int, parts: dict[str, np.ndarray], undecided: int) -> None:
        """Keeps a chunk; its entry in `done` is written last. Raises ArgumentError in a process of other versions."""
        self._require_versions()
        cut = self.grid.cut(number)
        with shared_lock(Path(self.path, METADATA)):
            for name in self.told["columns"]:
                self.arrays[name][cut] = parts[name]
            self.arrays[UNDECIDED][number : number + 1] = undecided
            self.arrays[DONE][number : number + 1] = self._digest(number)

    def forget(self, number: int) -> None:
        """The chunk is not done."""
        with shared_lock(Path(self.path, METADATA)):
            self.arrays[DONE][number : number + 1] = NOT_DONE

    @cached_property
    def grid(self) -> Grid:
        """The cells."""
        return Grid(self.told["sizes"], tuple(self.told["chunk"]))

    def damaged(self) -> list[int]:
        """Which of the chunks that are said to be done are not what was written."""
        marks = self._entries(DONE)
        return [number for number in np.flatnonzero(marks).tolist() if self._digest(number) != marks[number]]

    def _digest(self, number):
        """Of a chunk's files, those that there are."""
        place, whole = np.unravel_index(number, self.grid.counts), hashlib.sha256()
        for name, more in self.told["columns"].items():
            path = Path(self.path, name, CHUNKS, *map(str, place), *["0"] * more)
            content = path.read_bytes() if path.exists() else b""
            whole.update(f"{name} {number} {len(content)} ".encode() + content)
        whole.update(f"{self._entry(UNDECIDED, number)}".encode())
        return np.frombuffer(whole.digest()[:8], "<u8")[0] | np.uint64(1)

    def data(self) -> xr.Dataset:
        """The frame, and the columns of all cells: blank where they are not done. Raises ArgumentError for damage."""
        bad = self.damaged()
        if bad:
            many = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
            rule = "must be as it was written; run it again, and what is damaged is done anew"
            raise _refused(rule, f"chunk {bad[0]}{many} of {self.path}")
        data = self._opened()[list(self.told["columns"])].load()
        return self.frame.assign({name: data[name].variable for name in self.told["columns"]})


@check.host("use what was loaded before")
def load_store(path: str | PathLike[str]) -> xr.Dataset:
    """What a study's store holds, once its checksums are right: an xarray.Dataset, of a study half done too.

    path: of the folder. Cells that are not done are blank: -1 in whole numbers, nan in others. Attributes: what the
    study tells, and chunks_done of chunks. What is larger than memory, or on its way, xarray opens as it is:
    `xarray.open_zarr(path, consolidated=False)`.

    Raises ArgumentError for what is no such store, or damaged, OSError where it cannot be read.
    """
    kept = Kept(str(path))
    return kept.data().assign_attrs(chunks=kept.grid.chunks, chunks_done=len(kept.undecided()))


def _told(study):
    """What a store of a study says of itself."""
    columns = {name: len(one.more) for name, one in study.columns.items()}
    found = {"format": FORMAT, "identity": dict(study.identity), "columns": columns}
    found |= {"versions": _versions(), "sizes": dict(study.grid.sizes), "chunk": list(study.grid.chunk)}
    return found | {"coords": [str(name) for name in study.frame.coords]}


@lru_cache
def _versions():
    return {"jaxvibro": __version__} | {name: version(name) for name in VERSIONS}


def _make(path, study):
    """A store in which nothing is done, put into its place when it is whole."""
    if not path.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path.parent))
    size, free = size_in_bytes(study), shutil.disk_usage(path.parent).free
    if size > free:
        told = f"no room for up to {size / 2**30:.3g} GiB, {free / 2**30:.3g} GiB are free"
        raise OSError(errno.ENOSPC, told, str(path))
    with complete_folder(path) as part:
        plain = {name: {"_FillValue": None} for name in study.frame.variables}
        study.frame.to_zarr(part, mode="w-", consolidated=False, zarr_format=3, encoding=plain)
        group, grid = zarr.open_group(str(part), mode="r+", zarr_format=3), study.grid
        for name, one in study.columns.items():
            group.create_array(
                name,
                shape=(*grid.shape, *one.more.values()),
                chunks=(*grid.chunk, *one.more.values()),
                dtype=one.dtype,
                fill_value=one.blank,
                dimension_names=(*grid.sizes, *one.more),
                attributes=dict(one.attrs),
            )
        for name, dtype in ((DONE, np.uint64), (UNDECIDED, np.int32)):
            shape = {"shape": (grid.chunks,), "chunks": (1,), "dimension_names": (CHUNK,)}
            group.create_array(name, dtype=dtype, fill_value=NOT_DONE, compressors=None, **shape)
        told = _told(study)
        group.attrs.update({OURS: json.dumps(told), BASE: _base(part, told["columns"]), SEAL: BLANK})
        (part / METADATA).write_bytes(sealed((part / METADATA).read_bytes()))


def _base(place, columns):
    """A digest of the files in a store that do not change."""
    whole, changing = hashlib.sha256(), {*columns, DONE, UNDECIDED}
    for folder in sorted(one for one in place.iterdir() if one.is_dir()):
        all_of_it = sorted(one for one in folder.rglob("*") if one.is_file())
        for file in [folder / METADATA] if folder.name in changing else all_of_it:
            whole.update(f"{file.relative_to(place)} {file.stat().st_size} ".encode() + file.read_bytes())
    return whole.hexdigest()


def _difference(theirs, mine):
    """The first line in which two texts differ, for a complaint."""
    pairs = zip_longest(str(theirs).splitlines(), str(mine).splitlines())
    old, new = next((pair for pair in pairs if pair[0] != pair[1]), (theirs, mine))
    return f"{check.short(old)} there, {check.short(new)} here"


def _refused(rule, value):
    return check.ArgumentError("store", rule, check.short(value))
