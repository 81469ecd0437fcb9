"""A run as one file of HTML: the faults found, their evidence, and how near the rest came. It needs no network.

The same log, configuration and version give the same bytes: nothing of this machine, this time and this folder is in
it.
"""
