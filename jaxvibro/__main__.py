"""Run the command `jaxvibro` as `python -m jaxvibro`."""

import sys

from .studies.command import main

sys.exit(main())
