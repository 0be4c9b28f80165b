"""Error against cost of the strobe: ours and its rivals on the same work, timed in turn on one core."""
