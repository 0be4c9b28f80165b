"""Store programs and lowered modules of traced functions for later processes, in a folder inside JAX's cache.

A file consists of a line that describes the tree of the results, and of a program or a lowered module (jax.export),
which is called in place of the function. Programs and modules are executed. `trusted_cache_file` therefore reads them
only from a folder to which only the user can write, and only if their digest is correct. JAX trusts its own cache in
the same folder.
"""

import hashlib
import importlib.util
import shutil
import sys
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

from . import tree_description, trusted_cache_file
from .tree_description import NUMBER, NotPersistentError, qualified_name, tree_of_text, tree_text

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
    content = trusted_cache_file.read(path)
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
    trusted_cache_file.write(path, result_text.encode() + b"\n" + item)


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
    return _setup_problem() or trusted_cache_file.reason_for_distrust(*_cache_folders())


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
    if trusted_cache_file.is_distrusted(cache_root, cache_root):
        return None
    is_new = not folder.is_dir()
    for path in cache_folders if is_new else ():
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if trusted_cache_file.is_distrusted(cache_root, *cache_folders):
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
