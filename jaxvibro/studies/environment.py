"""`jaxvibro report`: versions, processor, settings and compiler hints, for reports of faults."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from continuation.persistent_jit import cache_folder, reason_without_cache

from .. import __version__
from ..compiled.hints_in_use import describe_hints
from . import jax_settings

PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "xarray", "zarr", "matplotlib", "msgspec", "optax", "diffrax")
EXTRAS = ("distributed", "tornado")
INSTRUCTIONS = ("sse4_2", "avx", "avx2", "fma", "f16c", "avx512", "avx_vnni", "amx", "asimd", "sve", "neon")
SETTINGS = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs", "jax_default_matmul_precision")
UNKNOWN = "unknown"


def describe_environment() -> dict[str, Any]:
    """Describe what the results of this process depend on besides the program that calls it.

    Returns
    -------
    dict
        Plain values only, ready for JSON: ``versions``, ``system``, ``processor``, ``jax``, ``hints`` and ``cache``.
    """
    return {
        "versions": _versions(),
        "system": platform.platform(),
        "processor": _processor(),
        "jax": _jax(),
        "hints": describe_hints(),
        "cache": _cache(),
    }


def format_environment(found: dict[str, Any]) -> str:
    """Lay out the result of `describe_environment` as lines of text, a heading for each group."""
    lines: list[str] = []
    for group, values in found.items():
        if not isinstance(values, dict):
            lines.append(f"{group}: {_text(values)}")
            continue
        lines.append(f"{group}:")
        width = max(map(len, values))
        lines += [f"  {name:{width}}  {_text(value)}" for name, value in values.items()]
    return "\n".join(lines)


def _text(value):
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(each)}" for name, each in value.items()) or "-"
    if isinstance(value, list):
        return " ".join(map(str, value)) or "-"
    return str(value)


def _versions():
    found = {"jaxvibro": __version__, "python": f"{platform.python_version()} ({platform.python_implementation()})"}
    return found | {name: _version_of(name) for name in (*PACKAGES, *EXTRAS)}


def _version_of(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor():
    """Of the first core: all are alike in what matters here."""
    first, cores = _cpuinfo()
    flags = (first.get("flags") or first.get("Features") or "").split()
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "model": first.get("model name") or platform.processor() or platform.machine() or UNKNOWN,
        "architecture": platform.machine(),
        "instruction_sets": [one for one in sorted(flags) if one.startswith(INSTRUCTIONS)],
        "cores": cores,
        "logical_cores": os.cpu_count(),
        "usable_logical_cores": len(affinity(0)) if affinity else os.cpu_count(),
        "kind": jax_settings.processor(),
    }


def _cpuinfo():
    """(fields of the first processor in /proc/cpuinfo, number of physical cores or None)."""
    try:
        blocks = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").strip().split("\n\n")
    except OSError:
        return {}, None
    pairs = [[line.partition(":") for line in block.splitlines()] for block in blocks]
    fields = [{name.strip(): value.strip() for name, _, value in block} for block in pairs]
    cores = {(one.get("physical id"), one["core id"]) for one in fields if "core id" in one}
    return fields[0], len(cores) or None


def _jax():
    environment = {name: each for name, each in sorted(os.environ.items()) if name.startswith(("JAX_", "XLA_"))}
    found: dict[str, Any] = {"platform": jax.default_backend()}
    found["devices"] = [f"{one} ({one.device_kind})" for one in jax.devices()]
    found["x64"] = bool(jax.config.jax_enable_x64)
    return found | {name: getattr(jax.config, name) for name in SETTINGS} | {"environment": environment}


def _cache():
    """The cache folder, and whether JAX keeps compiled code in it and this package traced functions."""
    place, reason = cache_folder() or None, reason_without_cache()
    return {
        "folder": place,
        "writable": None if place is None else _is_writable(Path(place)),
        "used_by_jax": place is not None and bool(jax.config.jax_enable_compilation_cache),
        "used_for_traced_functions": reason is None,
        "reason_if_not": reason,
    }


def _is_writable(folder):
    """Return True if files can be put into a folder, which may be still to be made."""
    nearest = next(one for one in (folder, *folder.absolute().parents) if os.path.lexists(one))
    return nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)
