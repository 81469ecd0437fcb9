"""What redundant sensors are like, learned from their readings in the first seconds.

:mod:`.noise`: the noise and the resolution of each; :mod:`.lag`: by how much a filter delays one behind another. A data
sheet tells of a sensor, not of the filters, the wiring and the ADC behind it.
"""
