"""Many cars: what logs of healthy drives teach, and what the logs of a fleet show."""
