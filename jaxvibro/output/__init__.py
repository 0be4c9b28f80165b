"""What is written: columns of text, and files that are whole or not there.

In: numbers, texts, datasets. Out: tables in columns; files written beside their place and renamed into it; a
checksum in every saved file, and its refusal where it is wrong. Start with `atomic_write`.
"""
