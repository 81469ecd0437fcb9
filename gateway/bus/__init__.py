"""CAN frames in and out: frame batches, buses named by URIs, log files."""
