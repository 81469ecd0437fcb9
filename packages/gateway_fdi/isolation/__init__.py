"""From tests that have fired to the fault: a signature table and one state machine, for every plant.

A plant supplies the table and the times; :mod:`.table` says which faults explain what has fired, :mod:`.machine` when
one of them is told. docs/isolation.md has both with a picture. :mod:`.fault_size` is for plants that estimate the size
of a fault instead.
"""
