"""Tracking the teeth of a trigger wheel by their pulse times, through missed and added pulses.

`acquisition` finds the place on the wheel to begin at. From there `hypotheses` takes each pulse: `motion` predicts and
corrects a hypothesis, `branching` makes its successors, `reduction` merges and prunes them; `tracker` is what they are
kept in. `profile` learns the wheel's pitches.
"""
