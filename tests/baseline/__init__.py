"""Reference values of an earlier commit: numbers, saved files and public signatures, held against the present code."""
