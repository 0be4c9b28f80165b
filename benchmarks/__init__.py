"""Error against cost of the stroboscopic map: this package and other methods, timed in turn on one core."""
