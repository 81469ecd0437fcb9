"""When a gateway is due, as the live loop reckons it."""


def due_ns(gateway):
    """Return when time alone has something to do; while it waits for a write or the like: the past."""
    quiet = gateway.quiet()
    return min(gateway.engine.due_ns, quiet.due_ns, gateway.engine.pause_ns) if quiet.idle else -1
