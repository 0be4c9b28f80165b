"""`python -m jaxvibro` is the command `jaxvibro`."""

import sys

from .command import main

sys.exit(main())
