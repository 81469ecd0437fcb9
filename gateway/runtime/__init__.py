"""A gateway as a whole: put together from a configuration, fed with frames, live or from a log."""
