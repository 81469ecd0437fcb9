"""For processes of tests that read no MF4 log: python-can would load asammdf at each start, with pandas and sympy.

That is more than half of a start's processor time; in the test kernel it is 12 s.
"""

raise ImportError("no asammdf in this process")
