"""Call traced functions from the host: evaluate them by Python and NumPy first, and compile them when that pays.

Other files import names of this package, never of its files. `host_jit` is the file to read first.
"""

from .host_jit import FAST_COMPILE, CompilationQueue, compile_at_once, fallback_counts, persistent_jit
from .module_store import jax_cache_folder, reason_for_distrust, reason_without_cache
from .rules import RULES_VERSION

__all__ = [
    "FAST_COMPILE",
    "RULES_VERSION",
    "CompilationQueue",
    "compile_at_once",
    "fallback_counts",
    "jax_cache_folder",
    "persistent_jit",
    "reason_for_distrust",
    "reason_without_cache",
]
