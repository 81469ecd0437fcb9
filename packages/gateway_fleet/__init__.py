"""Many cars: learning from logs of healthy drives, and faults in the logs of a fleet."""
