"""Protected frames: checksums, alive counters and AUTOSAR E2E profiles, checked and made by the same kernels.

``crc`` has the polynomials, ``checksum`` what is computed over a payload, ``cmac`` and ``freshness`` what SecOC adds,
``rules`` what carmakers do, ``e2e`` what AUTOSAR's profiles do, ``protection`` all of it for one message.
"""
