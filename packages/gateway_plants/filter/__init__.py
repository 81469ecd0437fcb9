"""A filter of filterpy's as a monitor: ``type = "filter"``.

``params`` are its keys, ``author`` has the filter made and checks it, ``kernel`` steps a linear one and tests the
innovations of any, ``python`` steps those that are not linear, and ``monitor`` brings them to the engine.
"""
