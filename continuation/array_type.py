"""Define the array type of annotations: JAX arrays in compiled code, NumPy arrays on the host."""

import jax
import numpy as np

Array = jax.Array | np.ndarray
