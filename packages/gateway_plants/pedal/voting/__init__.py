"""Voters: one value out of two or three redundant readings of the same quantity.

Each voter is a kernel ``vote(s, c, y)`` over its state, its constants and the readings of one sample, in any
unit; the tracking voter also takes the time since the last sample. All leave ``s.value``, the voted value, and
``s.used``, a bit for each channel whose reading is in it (0: none was believed).
"""
