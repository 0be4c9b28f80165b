"""Divide the test files into parts for several machines: `python -m tests.shard 1/3` prints those of the first part."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def files(shard):
    """Return the test files of part "k/n": the files in order of size, dealt out one by one."""
    number, count = map(int, shard.split("/"))
    if not 1 <= number <= count:
        raise ValueError(f"shard must be a number of 1 to n, '/' and n; got {shard!r}")
    paths = sorted((ROOT / "tests").rglob("test_*.py"), key=lambda path: (-path.stat().st_size, path))
    return [str(path.relative_to(ROOT)) for path in paths[number - 1 :: count]]


if __name__ == "__main__":
    print(*files(*sys.argv[1:]))
