"""Write and read results: tables, units, labels, and files that are complete or absent.

The input is numbers, texts and datasets. The output is aligned tables and files. Each file is written under a temporary
name in its folder and then renamed. Saved data contain a checksum, which is checked on reading. Start with
`atomic_files`.
"""
