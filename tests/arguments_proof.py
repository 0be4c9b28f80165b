"""Invalid calls of all public functions: `python -m tests.arguments_proof [COUNT] [SEED] [FUNCTION]`.

Draws COUNT calls (2,000) of `invalid_calls.table` and makes each. Prints every call that raises anything but
ArgumentError, whose message lacks the argument, the rule or the value, or that takes more than 10 s.
"""

import os
import sys
import tempfile

import jax
import matplotlib

from . import invalid_calls


def main(count=2000, seed=0, only=""):
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("Agg")
    os.chdir(tempfile.mkdtemp())
    calls = invalid_calls.drawn(count if not only else 10**9, seed)
    calls = [call for call in calls if not only or call.function in only.split(",")][:count]
    faults, refused, slowest = 0, 0, 0.0
    for call in calls:
        found = invalid_calls.outcome(call)
        faults, refused, slowest = faults + bool(found.fault), refused + found.refused, max(slowest, found.seconds)
        if found.fault:
            print(f"{call}: {found.fault}", flush=True)
    print(f"{len(calls)} calls: {refused} refused, {faults} at fault; slowest {slowest:.1f} s")
    return faults


if __name__ == "__main__":
    numbers = [int(each) for each in sys.argv[1:3]]
    sys.exit(main(*numbers, *sys.argv[3:4]) > 0)
