"""The tracking voter: follows the quantity itself, and judges every channel against it and against the others.

The paper's detector knows nothing but how much the output changed last. Here the quantity is followed by a Kalman
filter of level and slope (:mod:`.motion`), the slow disagreement of the channels is learned (:mod:`.mismatch`),
and what each channel does by itself is watched (:mod:`.channel_activity`): whether it is frozen, or moves smoothly.
:mod:`.vote` decides.
"""
