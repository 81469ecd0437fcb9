"""In the test kernel there is no asammdf: python-can would load it at each start, 12 s there, for no test's files."""

raise ImportError("no asammdf in the test kernel")
