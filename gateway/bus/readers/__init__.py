"""Readers of logs, one file a format: bytes into batches of frames, by compiled kernels.

``text`` feeds the formats of lines (candump, ASC, TRC, CSV) a block at a time, ``scan`` has what their kernels share;
``blf`` walks over the objects of unpacked containers, ``mf4`` takes groups of channels in bulk from asammdf.
``gateway.bus.logs`` opens the file, maps channels to buses and counts. All give what python-can's readers give, frame
by frame, but for stamps: integers here, that keep the nanoseconds which python-can's floats lose
(tests/bus/test_readers.py).
"""
