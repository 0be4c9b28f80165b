"""Describe versions, processor, settings and compiler hints for problem reports (`jaxvibro report`)."""

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
OPTIONAL_PACKAGES = ("distributed", "tornado")
INSTRUCTION_PREFIXES = ("sse4_2", "avx", "avx2", "fma", "f16c", "avx512", "avx_vnni", "amx", "asimd", "sve", "neon")
JAX_SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_default_matmul_precision",
)
UNKNOWN = "unknown"


def describe_environment() -> dict[str, Any]:
    """Describe everything besides the calling program that the results of this process depend on.

    Returns
    -------
    dict
        Plain values only, ready for JSON: ``versions``, ``system``, ``processor``, ``jax``, ``hints`` and ``cache``.
    """
    return {
        "versions": _versions(),
        "system": platform.platform(),
        "processor": _processor_info(),
        "jax": _jax_info(),
        "hints": describe_hints(),
        "cache": _cache_info(),
    }


def format_environment(environment: dict[str, Any]) -> str:
    """Lay out the result of `describe_environment` as lines of text, one heading per group."""
    lines: list[str] = []
    for group, values in environment.items():
        if not isinstance(values, dict):
            lines.append(f"{group}: {_value_text(values)}")
            continue
        lines.append(f"{group}:")
        width = max(map(len, values))
        lines += [f"  {name:{width}}  {_value_text(value)}" for name, value in values.items()]
    return "\n".join(lines)


def _value_text(value):
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_value_text(item)}" for name, item in value.items()) or "-"
    if isinstance(value, list):
        return " ".join(map(str, value)) or "-"
    return str(value)


def _versions():
    versions = {"jaxvibro": __version__, "python": f"{platform.python_version()} ({platform.python_implementation()})"}
    return versions | {name: _installed_version(name) for name in (*PACKAGES, *OPTIONAL_PACKAGES)}


def _installed_version(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor_info():
    """Return the properties of the first core; the cores do not differ in these."""
    fields, cores = _read_cpuinfo()
    flags = (fields.get("flags") or fields.get("Features") or "").split()
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "model": fields.get("model name") or platform.processor() or platform.machine() or UNKNOWN,
        "architecture": platform.machine(),
        "instruction_sets": [flag for flag in sorted(flags) if flag.startswith(INSTRUCTION_PREFIXES)],
        "cores": cores,
        "logical_cores": os.cpu_count(),
        "usable_logical_cores": len(affinity(0)) if affinity else os.cpu_count(),
        "kind": jax_settings.processor_fingerprint(),
    }


def _read_cpuinfo():
    """(fields of the first processor in /proc/cpuinfo, number of physical cores or None)."""
    try:
        blocks = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").strip().split("\n\n")
    except OSError:
        return {}, None
    key_values = [[line.partition(":") for line in block.splitlines()] for block in blocks]
    fields = [{name.strip(): value.strip() for name, _, value in block} for block in key_values]
    cores = {(record.get("physical id"), record["core id"]) for record in fields if "core id" in record}
    return fields[0], len(cores) or None


def _jax_info():
    environment = {name: value for name, value in sorted(os.environ.items()) if name.startswith(("JAX_", "XLA_"))}
    info: dict[str, Any] = {"platform": jax.default_backend()}
    info["devices"] = [f"{device} ({device.device_kind})" for device in jax.devices()]
    info["x64"] = bool(jax.config.jax_enable_x64)
    return info | {name: getattr(jax.config, name) for name in JAX_SETTINGS} | {"environment": environment}


def _cache_info():
    """Return the cache folder, its use by JAX for compiled code, and its use by this package for traced functions."""
    folder, reason = cache_folder() or None, reason_without_cache()
    return {
        "folder": folder,
        "writable": None if folder is None else _is_writable(Path(folder)),
        "used_by_jax": folder is not None and bool(jax.config.jax_enable_compilation_cache),
        "used_for_traced_functions": reason is None,
        "reason_if_not": reason,
    }


def _is_writable(folder):
    """Return True if files can be written into a folder, which need not exist yet."""
    ancestor = next(candidate for candidate in (folder, *folder.absolute().parents) if os.path.lexists(candidate))
    return ancestor.is_dir() and os.access(ancestor, os.W_OK | os.X_OK)
