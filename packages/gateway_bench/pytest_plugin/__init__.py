"""Scenarios as tests of pytest, and fixtures for tests of one's own; ``gateway_pytest`` is the door to it.

``bench``, ``dtcs``, ``uds`` and ``can_log`` do the work and know nothing of pytest; ``plugin``, ``fixtures`` and
``scenarios`` are what pytest sees.
"""
