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
from ..output.checksums import BLANK_CHECKSUM, has_valid_checksum, seal
from ..output.file_lock import exclusive_lock, shared_lock
from ..scene import check
from .engines import Engine, LocalEngine
from .study import Grid, Study, study_bytes

FORMAT_NUMBER = 1
DONE_ARRAY, UNDECIDED_ARRAY = "done", "undecided"  # arrays beside the columns, an entry a chunk
NOT_DONE = 0
CHUNK_DIMENSION = "chunk"  # their dimension
STORE_ATTRIBUTE = "jaxvibro_store"  # the attribute that tells such a store
CHECKSUM_ATTRIBUTE, DIGEST_ATTRIBUTE = (
    "checksum",
    "base",
)  # attributes: of the file that holds them; of all others that do not change
METADATA_FILE, CHUNK_FOLDER = "zarr.json", "c"  # as Zarr names an array's description, and the folder of its chunks
PARTIAL_SUFFIX = ".partial"  # how the names of Zarr's unfinished files end
VERSIONED_PACKAGES = ("jax", "numpy", "scipy")  # whose results are only alike to rounding from one version to another


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

    def open(self, study: Study) -> "OpenStore":
        """The store, open for a study; made where it is not there. Raises ArgumentError and OSError."""
        path = Path(self.path)
        remove_abandoned(path)
        if not os.path.lexists(path):
            _create_store(path, study)
        store = OpenStore(str(path))
        store.require_study(study)
        store.remove_unfinished()
        for number in store.damaged_chunks():
            warnings.warn(f"{path}: chunk {number} is not what was written, and is done anew", stacklevel=2)
            store.mark_not_done(number)
        return store


@dataclass(frozen=True)
class OpenStore:
    """A store that is there, as any process opens it. path: of the folder."""

    path: str

    def __reduce__(self):
        return OpenStore, (self.path,)

    @cached_property
    def group(self) -> zarr.Group:
        """Of Zarr, for reading and writing. Raises ArgumentError for what is no store of ours, or no longer what was
        written, OSError where it cannot be read."""
        folder = Path(self.path)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), self.path)
        os.listdir(folder)
        try:
            group = zarr.open_group(self.path, mode="r+", zarr_format=3)
            description = json.loads(str(group.attrs[STORE_ATTRIBUTE]))
            format_number, digest = description["format"], group.attrs[DIGEST_ATTRIBUTE]
        except Exception as error:  # whatever Zarr falls over
            raise _store_error(f"must be a store of jaxvibro ({type(error).__name__})", folder) from None
        if format_number != FORMAT_NUMBER:
            raise _store_error(f"must be of format {FORMAT_NUMBER}", f"format {format_number} in {folder}")
        if not has_valid_checksum((folder / METADATA_FILE).read_bytes(), folder) or digest != _constant_files_digest(
            folder, description["columns"]
        ):
            raise _store_error("must be as it was written, which its checksum says it is not", folder)
        return group

    @cached_property
    def arrays(self) -> dict[str, zarr.Array]:
        """Those that are filled, by name."""
        return {
            name: array
            for name, array in self.group.arrays()
            if name in (*self.description["columns"], DONE_ARRAY, UNDECIDED_ARRAY)
        }

    @cached_property
    def description(self) -> dict[str, Any]:
        """What the store says of itself: format, identity, versions, columns, sizes, chunk."""
        return json.loads(str(self.group.attrs[STORE_ATTRIBUTE]))

    @cached_property
    def frame(self) -> xr.Dataset:
        """The study's frame, as it was when the store was made."""
        data = self._open_dataset().drop_vars([*self.description["columns"], DONE_ARRAY, UNDECIDED_ARRAY]).load()
        data.attrs = {
            name: value
            for name, value in data.attrs.items()
            if name not in (STORE_ATTRIBUTE, CHECKSUM_ATTRIBUTE, DIGEST_ATTRIBUTE)
        }
        return data

    def _open_dataset(self):
        return xr.open_zarr(self.path, consolidated=False, chunks=None, decode_cf=False).set_coords(
            self.description["coords"]
        )

    def require_study(self, study: Study) -> None:
        """Refuse another study's store, and one of other versions. Raises ArgumentError."""
        old_description, new_description = self.description, _describe_store(study)
        for name, new_value in new_description["identity"].items():
            old_value = old_description["identity"].get(name)
            if old_value != new_value:
                raise _store_error(
                    f"must hold this study: {name} is another there", _first_difference(old_value, new_value)
                )
        for name in ("identity", "columns", "sizes", "chunk"):
            if old_description[name] != new_description[name]:
                raise _store_error(f"must hold this study: its {name} are others", old_description[name])
        self._require_versions()

    def _require_versions(self):
        old_versions = self.description["versions"]
        for name, new_version in _current_versions().items():
            if old_versions.get(name) != new_version:
                rule = "must be gone on with by the versions that began it, whose bits it has"
                raise _store_error(rule, f"{name} {old_versions.get(name)}, here {new_version}")

    def remove_unfinished(self) -> None:
        """Remove what a killed worker left unfinished, unless another process is writing a chunk at this moment."""
        with exclusive_lock(Path(self.path, METADATA_FILE)) as has_lock:
            for partial_file in Path(self.path).rglob(f"*{PARTIAL_SUFFIX}") if has_lock else ():
                partial_file.unlink(missing_ok=True)

    def undecided_counts(self) -> dict[int, int]:
        """{number: undecided cells} of the chunks that are done."""
        done_numbers, counts = (
            np.flatnonzero(self._read_entries(DONE_ARRAY) != NOT_DONE),
            self._read_entries(UNDECIDED_ARRAY),
        )
        return {number: int(counts[number]) for number in done_numbers.tolist()}

    def _read_entries(self, name):
        """An array with an entry a chunk, looked for where there is a file; what cannot be read is not there either."""
        array, folder = self.arrays[name], Path(self.path, name, CHUNK_FOLDER)
        entries = np.full(array.shape, NOT_DONE, array.dtype)
        file_numbers = [int(file) for file in os.listdir(folder) if file.isdecimal()] if folder.is_dir() else []
        readable_numbers = sorted(number for number in file_numbers if number < len(entries))
        try:
            entries[readable_numbers] = array.get_orthogonal_selection(readable_numbers) if readable_numbers else []
        except Exception:  # a damaged file, whatever Zarr's codecs fall over
            entries[readable_numbers] = [self._read_entry(name, number) for number in readable_numbers]
        return entries

    def _read_entry(self, name, number):
        try:
            return np.asarray(self.arrays[name][number : number + 1])[0]
        except Exception:  # as above
            return NOT_DONE

    def undecided_count(self, number: int) -> int | None:
        """Undecided cells of a chunk that is done, None of another."""
        return (
            int(self._read_entry(UNDECIDED_ARRAY, number)) if self._read_entry(DONE_ARRAY, number) != NOT_DONE else None
        )

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        """Keeps a chunk; its entry in `done` is written last. Raises ArgumentError in a process of other versions."""
        self._require_versions()
        chunk_slices = self.grid.chunk_slices(number)
        with shared_lock(Path(self.path, METADATA_FILE)):
            for name in self.description["columns"]:
                self.arrays[name][chunk_slices] = parts[name]
            self.arrays[UNDECIDED_ARRAY][number : number + 1] = n_undecided
            self.arrays[DONE_ARRAY][number : number + 1] = self._chunk_digest(number)

    def mark_not_done(self, number: int) -> None:
        """The chunk is not done."""
        with shared_lock(Path(self.path, METADATA_FILE)):
            self.arrays[DONE_ARRAY][number : number + 1] = NOT_DONE

    @cached_property
    def grid(self) -> Grid:
        """The cells."""
        return Grid(self.description["sizes"], tuple(self.description["chunk"]))

    def damaged_chunks(self) -> list[int]:
        """Which of the chunks that are said to be done are not what was written."""
        digests = self._read_entries(DONE_ARRAY)
        return [number for number in np.flatnonzero(digests).tolist() if self._chunk_digest(number) != digests[number]]

    def _chunk_digest(self, number):
        """Of a chunk's files, those that there are."""
        indices, sha = np.unravel_index(number, self.grid.chunk_counts), hashlib.sha256()
        for name, n_extra_axes in self.description["columns"].items():
            path = Path(self.path, name, CHUNK_FOLDER, *map(str, indices), *["0"] * n_extra_axes)
            content = path.read_bytes() if path.exists() else b""
            sha.update(f"{name} {number} {len(content)} ".encode() + content)
        sha.update(f"{self._read_entry(UNDECIDED_ARRAY, number)}".encode())
        return np.frombuffer(sha.digest()[:8], "<u8")[0] | np.uint64(1)

    def data(self) -> xr.Dataset:
        """The frame, and the columns of all cells: blank where they are not done. Raises ArgumentError for damage."""
        bad_chunks = self.damaged_chunks()
        if bad_chunks:
            count_text = f" and {len(bad_chunks) - 1} more" if len(bad_chunks) > 1 else ""
            rule = "must be as it was written; run it again, and what is damaged is done anew"
            raise _store_error(rule, f"chunk {bad_chunks[0]}{count_text} of {self.path}")
        data = self._open_dataset()[list(self.description["columns"])].load()
        return self.frame.assign({name: data[name].variable for name in self.description["columns"]})


@check.host_only("use what was loaded before")
def load_store(path: str | PathLike[str]) -> xr.Dataset:
    """What a study's store holds, once its checksums are right: an xarray.Dataset, of a study half done too.

    path: of the folder. Cells that are not done are blank: -1 in whole numbers, nan in others. Attributes: what the
    study tells, and chunks_done of chunks. What is larger than memory, or on its way, xarray opens as it is:
    `xarray.open_zarr(path, consolidated=False)`.

    Raises ArgumentError for what is no such store, or damaged, OSError where it cannot be read.
    """
    store = OpenStore(str(path))
    return store.data().assign_attrs(chunks=store.grid.n_chunks, chunks_done=len(store.undecided_counts()))


def _describe_store(study):
    """What a store of a study says of itself."""
    columns = {name: len(column.more) for name, column in study.columns.items()}
    description = {"format": FORMAT_NUMBER, "identity": dict(study.identity), "columns": columns}
    description |= {
        "versions": _current_versions(),
        "sizes": dict(study.grid.sizes),
        "chunk": list(study.grid.chunk_shape),
    }
    return description | {"coords": [str(name) for name in study.frame.coords]}


@lru_cache
def _current_versions():
    return {"jaxvibro": __version__} | {name: version(name) for name in VERSIONED_PACKAGES}


def _create_store(path, study):
    """A store in which nothing is done, put into its place when it is whole."""
    if not path.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path.parent))
    size, free_bytes = study_bytes(study), shutil.disk_usage(path.parent).free
    if size > free_bytes:
        description = f"no room for up to {size / 2**30:.3g} GiB, {free_bytes / 2**30:.3g} GiB are free"
        raise OSError(errno.ENOSPC, description, str(path))
    with complete_folder(path) as temporary:
        encoding = {name: {"_FillValue": None} for name in study.frame.variables}
        study.frame.to_zarr(temporary, mode="w-", consolidated=False, zarr_format=3, encoding=encoding)
        group, grid = zarr.open_group(str(temporary), mode="r+", zarr_format=3), study.grid
        for name, column in study.columns.items():
            group.create_array(
                name,
                shape=(*grid.shape, *column.more.values()),
                chunks=(*grid.chunk_shape, *column.more.values()),
                dtype=column.dtype,
                fill_value=column.blank,
                dimension_names=(*grid.sizes, *column.more),
                attributes=dict(column.attrs),
            )
        for name, dtype in ((DONE_ARRAY, np.uint64), (UNDECIDED_ARRAY, np.int32)):
            array_options = {"shape": (grid.n_chunks,), "chunks": (1,), "dimension_names": (CHUNK_DIMENSION,)}
            group.create_array(name, dtype=dtype, fill_value=NOT_DONE, compressors=None, **array_options)
        description = _describe_store(study)
        group.attrs.update(
            {
                STORE_ATTRIBUTE: json.dumps(description),
                DIGEST_ATTRIBUTE: _constant_files_digest(temporary, description["columns"]),
                CHECKSUM_ATTRIBUTE: BLANK_CHECKSUM,
            }
        )
        (temporary / METADATA_FILE).write_bytes(seal((temporary / METADATA_FILE).read_bytes()))


def _constant_files_digest(folder, columns):
    """A digest of the files in a store that do not change."""
    sha, mutable_arrays = hashlib.sha256(), {*columns, DONE_ARRAY, UNDECIDED_ARRAY}
    for subfolder in sorted(entry for entry in folder.iterdir() if entry.is_dir()):
        all_files = sorted(entry for entry in subfolder.rglob("*") if entry.is_file())
        for file in [subfolder / METADATA_FILE] if subfolder.name in mutable_arrays else all_files:
            sha.update(f"{file.relative_to(folder)} {file.stat().st_size} ".encode() + file.read_bytes())
    return sha.hexdigest()


def _first_difference(old_text, new_text):
    """The first line in which two texts differ, for a complaint."""
    pairs = zip_longest(str(old_text).splitlines(), str(new_text).splitlines())
    old_line, new_line = next((pair for pair in pairs if pair[0] != pair[1]), (old_text, new_text))
    return f"{check.shorten(old_line)} there, {check.shorten(new_line)} here"


def _store_error(rule, value):
    return check.ArgumentError("store", rule, check.shorten(value))
