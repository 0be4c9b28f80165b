"""Run the command line of jaxvibro as `python -m jaxvibro`."""

import sys

from .studies.command import main

sys.exit(main())
