"""`python -m jaxvibro` is the command `jaxvibro`."""

import sys

from .studies.command import main

sys.exit(main())
