"""Differences between Linux, macOS and Windows: locks of files, sockets of this machine, users, processors.

Other rooms ask this one, and name no system themselves. A function that a system does not have ends in one error that
says so, or is left out where that costs nothing but speed.
"""
