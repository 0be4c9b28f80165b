"""Numerics of solution sets of F(u, p) = 0: no oscillator is known here."""
