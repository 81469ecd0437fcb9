"""A configuration that was learned of one drive, on other drives of the vehicle: healthy, and with everyday faults."""
