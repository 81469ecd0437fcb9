"""Reports of 0x19 ReadDTCInformation (ISO 14229-1, 12.3), by kind; each handler is named by its sub-function."""
