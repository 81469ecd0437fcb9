"""What differs between Linux, macOS and Windows: locks of files, sockets of this machine, users, processors.

Other rooms ask this one, and name no system themselves. What a system does not have is told by one error that says so,
or left out where that costs nothing but speed.
"""
