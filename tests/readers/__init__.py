"""Samples of names and sentences, and what readers who do not know the code make of them."""
