"""What each fault's test depends on, derived: bus -> ECU -> message -> signal -> what a monitor knows of it.

`parts` names the components and how they hang together, `communication` says it of checks of messages and of the health
of buses, `monitors` of monitors, `derive` of all faults of an engine.
"""
