"""Write and read results: tables, units, labels, and files that are complete or absent.

In: numbers, texts, datasets. Out: aligned tables; files written beside their place and renamed into it; a checksum in
every saved file, which is checked on reading. Start with `atomic_write`.
"""
