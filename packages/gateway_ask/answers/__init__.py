"""Answers of other ECUs: layouts of their bytes from the files that people have, and their values."""
