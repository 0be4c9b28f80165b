"""What an array is in annotations: jax's in compiled code, numpy's on the host."""

import jax
import numpy as np

Array = jax.Array | np.ndarray
