"""Where methods fail: every hard case, ours and others', counted and drawn. `python -m reliability.run`."""
