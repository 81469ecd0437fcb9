"""Readers of logs: bytes into batches of frames, by compiled kernels; other formats lie in ``gateway_logs.formats``.

``text`` feeds the formats of lines (candump, ASC, TRC, CSV) a block at a time, ``scan`` has what their kernels share.
``gateway.bus.logs`` opens the file, maps channels to buses and counts. All give what python-can's readers give, frame
by frame, but for stamps: integers here, that keep the nanoseconds which python-can's floats lose
(tests/bus/test_readers.py).
"""
