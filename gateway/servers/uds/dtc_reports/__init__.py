"""What 0x19 ReadDTCInformation reports (ISO 14229-1, 12.3), by kind; each handler is named by its sub-function."""
