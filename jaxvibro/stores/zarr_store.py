"""Store studies in a folder, a Zarr store (format 3) that xarray opens, from which the next run resumes.

A run may be killed at any moment. Each chunk is written by one worker, its files beside their places and renamed into
them. Then follows the chunk's entry in `done`, a digest of these files, which shows that the chunk is complete and
unchanged. A chunk of blanks has no files, so files alone would not show this. The store itself is also made beside its
place, complete or not at all, and a checksum covers its constant files.

Processes may share a store. If several create it at the same time, the first to finish wins, and the others use its
store once they have checked that it belongs to the same study. A process that writes a chunk holds a shared lock on the
store's metadata file, so that unfinished files are removed only while no chunk is being written.
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
DONE_ARRAY, UNDECIDED_ARRAY = "done", "undecided"  # arrays beside the columns, one entry per chunk
NOT_DONE = 0
CHUNK_DIMENSION = "chunk"  # dimension of these arrays
STORE_ATTRIBUTE = "jaxvibro_store"  # attribute that identifies such a store
CHECKSUM_ATTRIBUTE, DIGEST_ATTRIBUTE = (
    "checksum",
    "base",
)  # attributes: checksum of the file that holds them, digest of all other constant files
METADATA_FILE, CHUNK_FOLDER = "zarr.json", "c"  # Zarr's names of an array's description and of the folder of its chunks
PARTIAL_SUFFIX = ".partial"  # suffix of Zarr's unfinished files
VERSIONED_PACKAGES = ("jax", "numpy", "scipy")  # results may differ by rounding between versions


@dataclass(frozen=True)
class Store:
    """Folder that keeps a study chunk by chunk, with the engine that computes the chunks.

    Parameters
    ----------
    path : path_like
        Folder of a Zarr store (format 3). It is created if it is missing. If it exists, the missing chunks are added; a
        store of another study is refused.
    engine : LocalEngine or DaskEngine, optional
        Execution engine.

    See Also
    --------
    load_store : Load the results of a store.

    Notes
    -----
    The bits of a store do not depend on the engine, on the number of workers, or on interruptions. A damaged chunk is
    reported and recomputed. A partial store can be loaded with `load_store`, or opened with
    ``xarray.open_zarr(path, consolidated=False)``.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = jv.Store(f"{folder}/map.zarr")
    ...     data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]}, quantities="label", store=store)
    >>> data["label"].values.tolist()
    [1000000, 1001001]
    """

    path: str | PathLike[str]
    engine: Engine = field(default_factory=LocalEngine)

    def open(self, study: Study) -> "OpenStore":
        """Open the store for a study, and create it if it is missing.

        Damaged chunks are reported by a warning and marked as not done.

        Parameters
        ----------
        study : Study
            Study.

        Returns
        -------
        OpenStore
            Store that is open for the study.

        Raises
        ------
        ArgumentError
            If the folder is not a store of this study, is damaged, or was begun with other versions.
        OSError
            If the folder cannot be created or read.
        """
        path = Path(self.path)
        remove_abandoned(path)
        if not os.path.lexists(path):
            _create_store(path, study)
        store = OpenStore(str(path))
        store.require_study(study)
        store.remove_unfinished()
        for number in store.damaged_chunks():
            warnings.warn(f"{path}: chunk {number} is damaged and is recomputed", stacklevel=2)
            store.mark_not_done(number)
        return store


@dataclass(frozen=True)
class OpenStore:
    """Existing store, as any process opens it.

    Parameters
    ----------
    path : str
        Folder.
    """

    path: str

    def __reduce__(self):
        return OpenStore, (self.path,)

    @cached_property
    def group(self) -> zarr.Group:
        """Group of Zarr, for reading and writing.

        Raises ArgumentError if the folder is not a store of jaxvibro or is damaged, OSError if it cannot be read.
        """
        folder = Path(self.path)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), self.path)
        os.listdir(folder)
        try:
            group = zarr.open_group(self.path, mode="r+", zarr_format=3)
            description = json.loads(str(group.attrs[STORE_ATTRIBUTE]))
            format_number, digest = description["format"], group.attrs[DIGEST_ATTRIBUTE]
        except Exception as error:  # Zarr raises many kinds of error
            raise _store_error(f"must be a store of jaxvibro ({type(error).__name__})", folder) from None
        if format_number != FORMAT_NUMBER:
            raise _store_error(f"must be of format {FORMAT_NUMBER}", f"format {format_number} in {folder}")
        if not has_valid_checksum((folder / METADATA_FILE).read_bytes(), folder) or digest != _constant_files_digest(
            folder, description["columns"]
        ):
            raise _store_error("must be unchanged since it was written; its checksum does not match", folder)
        return group

    @cached_property
    def arrays(self) -> dict[str, zarr.Array]:
        """Arrays that are filled, by name."""
        return {
            name: array
            for name, array in self.group.arrays()
            if name in (*self.description["columns"], DONE_ARRAY, UNDECIDED_ARRAY)
        }

    @cached_property
    def description(self) -> dict[str, Any]:
        """Description in the store: format, identity, versions, columns, sizes, chunk."""
        return json.loads(str(self.group.attrs[STORE_ATTRIBUTE]))

    @cached_property
    def frame(self) -> xr.Dataset:
        """Frame of the study, from the creation of the store."""
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
        """Raise ArgumentError for the store of another study or of other versions."""
        old_description, new_description = self.description, _describe_store(study)
        for name, new_value in new_description["identity"].items():
            old_value = old_description["identity"].get(name)
            if old_value != new_value:
                raise _store_error(f"must hold this study: {name} differs", _first_difference(old_value, new_value))
        for name in ("identity", "columns", "sizes", "chunk"):
            if old_description[name] != new_description[name]:
                raise _store_error(f"must hold this study: {name} differs", old_description[name])
        self._require_versions()

    def _require_versions(self):
        """Raise ArgumentError if the store was begun with other versions."""
        old_versions = self.description["versions"]
        for name, new_version in _current_versions().items():
            if old_versions.get(name) != new_version:
                rule = "must be resumed with the versions that began it, since results differ by rounding"
                raise _store_error(rule, f"{name} {old_versions.get(name)}, now {new_version}")

    def remove_unfinished(self) -> None:
        """Remove the unfinished files of killed workers, unless another process is writing a chunk."""
        with exclusive_lock(Path(self.path, METADATA_FILE)) as has_lock:
            for partial_file in Path(self.path).rglob(f"*{PARTIAL_SUFFIX}") if has_lock else ():
                partial_file.unlink(missing_ok=True)

    def undecided_counts(self) -> dict[int, int]:
        """Return {number: undecided cells} of the chunks that are done."""
        done_numbers, counts = (
            np.flatnonzero(self._read_entries(DONE_ARRAY) != NOT_DONE),
            self._read_entries(UNDECIDED_ARRAY),
        )
        return {number: int(counts[number]) for number in done_numbers.tolist()}

    def _read_entries(self, name):
        """Return an array with one entry per chunk, read where a file exists; unreadable entries count as missing."""
        array, folder = self.arrays[name], Path(self.path, name, CHUNK_FOLDER)
        entries = np.full(array.shape, NOT_DONE, array.dtype)
        file_numbers = [int(file) for file in os.listdir(folder) if file.isdecimal()] if folder.is_dir() else []
        readable_numbers = sorted(number for number in file_numbers if number < len(entries))
        try:
            entries[readable_numbers] = array.get_orthogonal_selection(readable_numbers) if readable_numbers else []
        except Exception:  # a damaged file; Zarr's codecs raise many kinds of error
            entries[readable_numbers] = [self._read_entry(name, number) for number in readable_numbers]
        return entries

    def _read_entry(self, name, number):
        """Return the entry of one chunk; an unreadable one counts as missing."""
        try:
            return np.asarray(self.arrays[name][number : number + 1])[0]
        except Exception:  # as above
            return NOT_DONE

    def undecided_count(self, number: int) -> int | None:
        """Return the number of undecided cells of a chunk that is done, None for another."""
        return (
            int(self._read_entry(UNDECIDED_ARRAY, number)) if self._read_entry(DONE_ARRAY, number) != NOT_DONE else None
        )

    def put(self, number: int, parts: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store a chunk; its entry in `done` is written last. Raises ArgumentError in a process of other versions."""
        self._require_versions()
        chunk_slices = self.grid.chunk_slices(number)
        with shared_lock(Path(self.path, METADATA_FILE)):
            for name in self.description["columns"]:
                self.arrays[name][chunk_slices] = parts[name]
            self.arrays[UNDECIDED_ARRAY][number : number + 1] = n_undecided
            self.arrays[DONE_ARRAY][number : number + 1] = self._chunk_digest(number)

    def mark_not_done(self, number: int) -> None:
        """Mark a chunk as not done."""
        with shared_lock(Path(self.path, METADATA_FILE)):
            self.arrays[DONE_ARRAY][number : number + 1] = NOT_DONE

    @cached_property
    def grid(self) -> Grid:
        """Grid of the cells."""
        return Grid(self.description["sizes"], tuple(self.description["chunk"]))

    def damaged_chunks(self) -> list[int]:
        """Return the numbers of the chunks that are marked as done and have changed since."""
        digests = self._read_entries(DONE_ARRAY)
        return [number for number in np.flatnonzero(digests).tolist() if self._chunk_digest(number) != digests[number]]

    def _chunk_digest(self, number):
        """Return the digest of the existing files of a chunk."""
        indices, sha = np.unravel_index(number, self.grid.chunk_counts), hashlib.sha256()
        for name, n_extra_axes in self.description["columns"].items():
            path = Path(self.path, name, CHUNK_FOLDER, *map(str, indices), *["0"] * n_extra_axes)
            content = path.read_bytes() if path.exists() else b""
            sha.update(f"{name} {number} {len(content)} ".encode() + content)
        sha.update(f"{self._read_entry(UNDECIDED_ARRAY, number)}".encode())
        return np.frombuffer(sha.digest()[:8], "<u8")[0] | np.uint64(1)

    def data(self) -> xr.Dataset:
        """Return the frame and the columns of all cells, blank where not done; raise ArgumentError for damage."""
        bad_chunks = self.damaged_chunks()
        if bad_chunks:
            count_text = f" and {len(bad_chunks) - 1} more" if len(bad_chunks) > 1 else ""
            rule = "must be undamaged; run the study again to recompute damaged chunks"
            raise _store_error(rule, f"chunk {bad_chunks[0]}{count_text} of {self.path}")
        data = self._open_dataset()[list(self.description["columns"])].load()
        return self.frame.assign({name: data[name].variable for name in self.description["columns"]})


@check.host_only("use data that were loaded before")
def load_store(path: str | PathLike[str]) -> xr.Dataset:
    """Load the results of a store, complete or partial, after checking its checksums.

    Parameters
    ----------
    path : path_like
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        Results of the study. Cells that are not done are blank: -1 for integers, nan for other numbers. Its attributes
        are those of the study, ``chunks`` and ``chunks_done``.

    Raises
    ------
    ArgumentError
        If the folder is not such a store, or is damaged.
    OSError
        If the folder cannot be read.

    See Also
    --------
    Store : Folder that keeps a study.

    Notes
    -----
    Open a store that is larger than memory, or is being filled, with ``xarray.open_zarr(path, consolidated=False)``.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = jv.Store(f"{folder}/map.zarr")
    ...     data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]}, quantities="label", store=store)
    ...     loaded = jv.load_store(store.path)
    >>> loaded["label"].values.tolist(), loaded.attrs["chunks_done"] == loaded.attrs["chunks"]
    ([1000000, 1001001], True)
    """
    store = OpenStore(str(path))
    return store.data().assign_attrs(chunks=store.grid.n_chunks, chunks_done=len(store.undecided_counts()))


def _describe_store(study):
    """Return the description of a study's store."""
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
    """Return the versions of jaxvibro and of the packages on which the bits depend."""
    return {"jaxvibro": __version__} | {name: version(name) for name in VERSIONED_PACKAGES}


def _create_store(path, study):
    """Create a store in which nothing is done, and move it into its place once it is complete."""
    if not path.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path.parent))
    size, free_bytes = study_bytes(study), shutil.disk_usage(path.parent).free
    if size > free_bytes:
        description = f"not enough space for up to {size / 2**30:.3g} GiB; {free_bytes / 2**30:.3g} GiB are free"
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
    """Return a digest of the constant files of a store."""
    sha, mutable_arrays = hashlib.sha256(), {*columns, DONE_ARRAY, UNDECIDED_ARRAY}
    for subfolder in sorted(entry for entry in folder.iterdir() if entry.is_dir()):
        all_files = sorted(entry for entry in subfolder.rglob("*") if entry.is_file())
        for file in [subfolder / METADATA_FILE] if subfolder.name in mutable_arrays else all_files:
            sha.update(f"{file.relative_to(folder)} {file.stat().st_size} ".encode() + file.read_bytes())
    return sha.hexdigest()


def _first_difference(old_text, new_text):
    """Return the first line in which two texts differ, for a message."""
    pairs = zip_longest(str(old_text).splitlines(), str(new_text).splitlines())
    old_line, new_line = next((pair for pair in pairs if pair[0] != pair[1]), (old_text, new_text))
    return f"{check.shorten(old_line)} stored, {check.shorten(new_line)} requested"


def _store_error(rule, value):
    """Return the ArgumentError of a store."""
    return check.ArgumentError("store", rule, check.shorten(value))
