"""A steering of other make: another motor, integrated in the rotor's frame, with a controller and a road of its own."""
