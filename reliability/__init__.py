"""Where methods fail, ours and others': a file for each part of docs/reliability.md."""
