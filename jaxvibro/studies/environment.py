"""Describe versions, processor, settings and compiler hints for `jaxvibro report`."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from continuation.hostcall import RULES_VERSION, fallback_counts, jax_cache_folder, reason_without_cache

from .. import __version__
from ..compiled.lane_arithmetic import describe_hints
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
    """Describe the environment on which the results of this process depend.

    Returns
    -------
    dict
        Values that can be written as JSON: ``versions``, ``system``, ``processor``, ``jax``, ``hints``, ``cache`` and
        ``evaluation``.
    """
    return {
        "versions": _installed_versions(),
        "system": platform.platform(),
        "processor": _processor_info(),
        "jax": _jax_info(),
        "hints": describe_hints(),
        "cache": _cache_info(),
        "evaluation": _evaluation_info(),
    }


def format_environment(environment: dict[str, Any]) -> str:
    """Format the result of `describe_environment` as lines of text with a heading for each group."""
    text_lines: list[str] = []
    for group_name, group_values in environment.items():
        if not isinstance(group_values, dict):
            text_lines.append(f"{group_name}: {_value_text(group_values)}")
            continue
        text_lines.append(f"{group_name}:")
        name_width = max(map(len, group_values))
        text_lines += [
            f"  {field_name:{name_width}}  {_value_text(field_value)}"
            for field_name, field_value in group_values.items()
        ]
    return "\n".join(text_lines)


def _value_text(value):
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_value_text(nested_value)}" for name, nested_value in value.items()) or "-"
    if isinstance(value, list):
        return " ".join(map(str, value)) or "-"
    return str(value)


def _installed_versions():
    base_versions = {
        "jaxvibro": __version__,
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
    }
    return base_versions | {
        package_name: _installed_version(package_name) for package_name in (*PACKAGES, *OPTIONAL_PACKAGES)
    }


def _installed_version(package_name):
    try:
        return version(package_name)
    except PackageNotFoundError:
        return None


def _processor_info():
    """Return the properties of the processor, taken from the first core."""
    cpuinfo_fields, n_physical_cores = _read_cpuinfo()
    cpu_flags = (cpuinfo_fields.get("flags") or cpuinfo_fields.get("Features") or "").split()
    get_affinity = getattr(os, "sched_getaffinity", None)
    return {
        "model": cpuinfo_fields.get("model name") or platform.processor() or platform.machine() or UNKNOWN,
        "architecture": platform.machine(),
        "instruction_sets": [cpu_flag for cpu_flag in sorted(cpu_flags) if cpu_flag.startswith(INSTRUCTION_PREFIXES)],
        "cores": n_physical_cores,
        "logical_cores": os.cpu_count(),
        "usable_logical_cores": len(get_affinity(0)) if get_affinity else os.cpu_count(),
        "kind": jax_settings.processor_fingerprint(),
    }


def _read_cpuinfo():
    """Return (fields of the first processor in /proc/cpuinfo, number of physical cores or None)."""
    processor_blocks = jax_settings.read_cpuinfo().strip().split("\n\n")
    block_fields = [[line.partition(":") for line in block.splitlines()] for block in processor_blocks]
    fields_by_processor = [{name.strip(): value.strip() for name, _, value in fields} for fields in block_fields]
    physical_cores = {
        (processor.get("physical id"), processor["core id"])
        for processor in fields_by_processor
        if "core id" in processor
    }
    return fields_by_processor[0], len(physical_cores) or None


def _jax_info():
    environment_variables = {
        name: value for name, value in sorted(os.environ.items()) if name.startswith(("JAX_", "XLA_"))
    }
    jax_info: dict[str, Any] = {"platform": jax.default_backend()}
    jax_info["devices"] = [f"{device} ({device.device_kind})" for device in jax.devices()]
    jax_info["x64"] = bool(jax.config.jax_enable_x64)
    return (
        jax_info | {name: getattr(jax.config, name) for name in JAX_SETTINGS} | {"environment": environment_variables}
    )


def _evaluation_info():
    """Return the version of the rules in NumPy and the functions that were compiled instead, with their reasons."""
    fallbacks = {f"{function} ({reason})": count for (function, reason), count in fallback_counts().items()}
    return {"rule_table": RULES_VERSION, "fallbacks": fallbacks}


def _cache_info():
    """Return the cache folder and its use by JAX for compiled code and by this package for traced functions."""
    cache_path, reason_unused = jax_cache_folder() or None, reason_without_cache()
    return {
        "folder": cache_path,
        "writable": None if cache_path is None else _is_folder_writable(Path(cache_path)),
        "used_by_jax": cache_path is not None and bool(jax.config.jax_enable_compilation_cache),
        "used_for_traced_functions": reason_unused is None,
        "reason_if_not": reason_unused,
    }


def _is_folder_writable(folder):
    """Return True if files can be written to a folder, whether it exists or has to be created."""
    existing_path = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    return existing_path.is_dir() and os.access(existing_path, os.W_OK | os.X_OK)
