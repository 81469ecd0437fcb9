"""A method of the arena as a monitor, without rewriting: ``type = "method"``.

``params`` are its keys, ``fit`` makes the file that ``kept`` reads, ``runner`` steps the method in Python, and
``monitor`` brings it to the engine. ``folder`` is ``gateway new-monitor --from``.
"""
