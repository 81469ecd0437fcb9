"""A pedal of other make: a mass on a spring under a leg's force, sensors with filters of their own."""
