"""What every test stands on: double precision, pictures without a screen, and the same examples each time."""

import jax
import matplotlib
from hypothesis import settings

jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("same")
