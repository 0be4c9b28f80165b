"""Store programs and lowered modules of traced functions, in files that no other user can have changed.

A file consists of a line that describes the tree of the results, and of a program or a lowered module (jax.export),
which is called in place of the function. A person who can write to the cache folder can therefore execute code as the
user of the cache. The folder and its files must belong to the user or to root, and no one else may have permission to
write to them. JAX trusts its own cache in the same folder. A digest in the file detects damage. It includes the names
of the file and its folder, so that a copy of another file is rejected.
"""

import hashlib
import importlib.util
import os
import shutil
import stat
import sys
import tempfile
import warnings
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jaxlib
import numpy as np
from jax import export
from jax.api_util import shaped_abstractify
from jax.core import Tracer

from . import tree_description
from .tree_description import NUMBER, NotPersistentError, qualified_name, tree_of_text, tree_text

grp: Any
pwd: Any
try:
    import grp
    import pwd
except ImportError:  # absent on this system
    grp = pwd = None

DIGEST = hashlib.sha256().digest_size
_warned: set[tuple[Path, str]] = set()


def read(path: Path) -> bytes | None:
    """Return the content that `write` stored in a file; None if the file is missing, damaged or not trusted."""
    try:
        with open(path, "rb") as file:
            if distrust_from_status(os.fstat(file.fileno())):
                return None
            content = file.read()
    except OSError:
        return None
    return content[DIGEST:] if _integrity_digest(path, content[DIGEST:]) == content[:DIGEST] else None


def write(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it.

    The file is either complete or absent. It begins with a digest of its content. If the system reports an OSError, no
    file is written and the error is ignored.
    """
    with suppress(OSError):
        descriptor, temporary_path = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_integrity_digest(path, content) + content)
            os.replace(temporary_path, path)
        except BaseException:
            os.unlink(temporary_path)
            raise


def _integrity_digest(path, content):
    return hashlib.sha256(f"{path.parent.name}/{path.name}\n".encode() + content).digest()


def reason_for_distrust(*folders: Path) -> str | None:
    """Explain why files in folders cannot be trusted.

    Parameters
    ----------
    *folders : Path
        Folders to examine. Missing folders are skipped.

    Returns
    -------
    str or None
        The reason; None if the folders can be trusted.

    Notes
    -----
    Each folder must belong to the user or to root. Nobody else may have permission to write to it, except the private
    group of the user, which has the name of the user and no other members. A parent folder must not be writable by
    everyone, unless its sticky bit protects its contents. On systems without users and modes all folders are trusted.
    """
    if not hasattr(os, "geteuid"):
        return None
    resolved_folders = [Path(os.path.realpath(folder)) for folder in folders]
    for folder in resolved_folders:
        try:
            reason = distrust_from_status(os.stat(folder))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            reason = f"cannot be examined ({error.strerror})"
        if reason:
            return f"{folder} {reason}"
    for parent in sorted(
        {parent_folder for folder in resolved_folders for parent_folder in folder.parents} - set(resolved_folders)
    ):
        with suppress(OSError):
            permissions = os.stat(parent).st_mode
            if permissions & stat.S_IWOTH and not permissions & stat.S_ISVTX:
                return f"everyone can write to {parent}"
    return None


def distrust_from_status(file_status: os.stat_result) -> str | None:
    """Explain why a file or folder with an `os.stat` status cannot be trusted; return None if it can be trusted."""
    if not hasattr(os, "geteuid"):
        return None
    if file_status.st_uid not in (os.geteuid(), 0):
        return f"belongs to another user, number {file_status.st_uid}"
    if file_status.st_mode & stat.S_IWOTH:
        return "can be written to by everyone"
    if file_status.st_mode & stat.S_IWGRP and not _is_private_group(file_status.st_gid):
        return f"can be written to by a group, number {file_status.st_gid}"
    return None


def _is_private_group(group_id):
    """Return True for the private group of the user, which has the name of the user and no other members."""
    try:
        user_name, group_entry = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group_id)
    except (KeyError, AttributeError):
        return False
    return group_entry.gr_name == user_name and set(group_entry.gr_mem) <= {user_name}


def warn_once(folder: Path, reason: str) -> None:
    """Warn that a cache folder is not used, once per process, folder and reason."""
    if (folder, reason) not in _warned:
        _warned.add((folder, reason))
        warnings.warn(
            f"{folder}: traced functions are neither kept in this cache folder nor read from it, because {reason}. "
            "Anyone who can write to it can have code run as you, as JAX itself executes what it finds there: "
            "use a folder of your own with mode 700.",
            stacklevel=2,
        )


def is_distrusted(cache_root: Path, *folders: Path) -> bool:
    """Return True, with a warning, if folders of a cache must not be used."""
    reason = reason_for_distrust(*folders)
    if reason is not None:
        warn_once(cache_root, reason)
    return reason is not None


FOLDER = "modules"  # folder inside JAX's cache
MAX_GENERATIONS = 3  # number of versions of the sources whose items are kept
PROGRAM_SUFFIX = ".code"  # suffix of programs; modules have none


def tracer_leaves(pytree):
    """Return the leaves of a tree that are tracers."""
    return [leaf for leaf in jax.tree.leaves(pytree) if isinstance(leaf, Tracer)]


def item_path(function, args, kwargs, suffix=""):
    """Return the path of the item of a function for arguments of these types; None if nothing is stored."""
    folder = _prepare_folder()
    if folder is None:
        return None
    config = f"{jax.config.jax_enable_x64} {jax.config.jax_default_matmul_precision}"
    key = "\n".join((qualified_name(function), tree_text((args, kwargs)), config))
    return folder / (hashlib.sha256(key.encode()).hexdigest() + suffix)


def read_item(path: Path) -> Any:
    """Return the pair (result tree, bytes) of a file; None if it is missing, damaged or not trusted."""
    content = read(path)
    if content is None:
        return None
    result_text, item = content.split(b"\n", 1)
    return tree_of_text(result_text), item


def write_item(path: Path, result: Any, item: bytes) -> None:
    """Write the tree of a result and bytes. Raises NotPersistentError for a tree that cannot be described."""
    result_text = tree_text(jax.tree.map(lambda _: NUMBER, result))
    described_tree: Any = jax.tree.structure(tree_of_text(result_text))
    if described_tree != jax.tree.structure(result):
        raise NotPersistentError(result_text)
    write(path, result_text.encode() + b"\n" + item)


def program_path(function, static_indices, args) -> Path | None:
    """Return the path of a program for arguments of these types; None if nothing is stored."""
    with suppress(Exception):  # a function or an argument that exists only in this process
        pairs = enumerate(args)
        types = [arg if k in static_indices else jax.tree.map(shaped_abstractify, arg) for k, arg in pairs]
        return item_path(function, types, {}, PROGRAM_SUFFIX)
    return None


def load_or_export_module(function, args, kwargs):
    """Return a function of tracers that calls the stored or newly exported module; None if neither is possible."""
    try:
        path = item_path(function, args, kwargs)
        if path is None:
            return None
        result, module_bytes = read_item(path) or _export_module(function, args, kwargs, path)
        module, result_treedef = export.deserialize(bytearray(module_bytes)), jax.tree.structure(result)
    except Exception:  # a full disk, a foreign file, or a function that JAX cannot export: call the function itself
        return None
    return lambda *tracers: result_treedef.unflatten(module.call(*tracers))


def _export_module(function, args, kwargs, path):
    """Export a function and write its module; return (result tree, module)."""
    leaves, treedef = jax.tree.flatten((args, kwargs))
    results = []

    def flat_function(*tracers):
        values = iter(tracers)
        args, kwargs = treedef.unflatten([next(values) if isinstance(leaf, Tracer) else leaf for leaf in leaves])
        results[:] = [function(*args, **kwargs)]
        return jax.tree.leaves(results)

    flat_function.__name__ = function.__name__
    avals = (jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type) for aval in tracer_leaves(leaves))
    module = export.export(jax.jit(flat_function))(*avals)
    if any(aval.weak_type for aval in module.out_avals):
        raise NotPersistentError("weakly typed results are not stored")
    module_bytes = bytes(module.serialize())
    write_item(path, results[0], module_bytes)
    return results[0], module_bytes


def jax_cache_folder():
    """Return the folder of JAX's compilation cache as text; None or an empty text if the cache is not set."""
    return jax.config.jax_compilation_cache_dir


def reason_without_cache() -> str | None:
    """Explain why traced functions are not stored in this process.

    Returns
    -------
    str or None
        The reason; None if they are stored.
    """
    return _setup_problem() or reason_for_distrust(*_cache_folders())


def _setup_problem():
    """Explain why functions cannot be stored in any folder; return None if they can."""
    folder = jax_cache_folder()
    if not folder:
        return "no cache folder is set (JAX_COMPILATION_CACHE_DIR)"
    if "://" in folder:
        return "the cache is not a folder of the file system"
    if jax.default_backend() != "cpu":
        return f"functions are compiled for {jax.default_backend()}, not for the CPU"
    return "there are several devices" if jax.device_count() > 1 else None


def _cache_folders():
    """Return (JAX's cache folder, its subfolder of items, the subfolder of items of the present sources)."""
    cache_root = Path(jax_cache_folder())
    source_stamp = _source_stamp(tuple(sorted(tree_description.own_packages)))
    return cache_root, cache_root / FOLDER, cache_root / FOLDER / source_stamp


def _prepare_folder():
    """Return the folder of items of the present sources; None if nothing is stored.

    A missing folder is created. The folders of old sources are then removed, except the newest `MAX_GENERATIONS` - 1.
    """
    if _setup_problem():
        return None
    cache_root, all_items_folder, folder = cache_folders = _cache_folders()
    if is_distrusted(cache_root, cache_root):
        return None
    is_new = not folder.is_dir()
    for path in cache_folders if is_new else ():
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if is_distrusted(cache_root, *cache_folders):
        return None
    if is_new:
        outdated_folders = [path for path in all_items_folder.iterdir() if path != folder]
        for path in sorted(outdated_folders, key=lambda path: -path.stat().st_mtime)[MAX_GENERATIONS - 1 :]:
            shutil.rmtree(path, ignore_errors=True)
    return folder


@lru_cache
def _source_stamp(package_names):
    """Return a digest of the sources and versions on which items depend."""
    versions = (sys.version_info[:2], jax.__version__, jaxlib.__version__, np.__version__)
    digest = hashlib.sha256(repr((*versions, sys.implementation.name, importlib.util.MAGIC_NUMBER)).encode())
    for package_name in package_names:
        package_file = Path(sys.modules[package_name].__file__)
        for path in sorted(package_file.parent.rglob("*.py")) if package_file.name == "__init__.py" else [package_file]:
            content = path.read_bytes()
            header = f"\n{package_name} {path.relative_to(package_file.parent)} {len(content)}\n"
            digest.update(header.encode() + content)
    return digest.hexdigest()[:32]
