"""Study of who is on the bus: frames of another sender put into healthy drives, and healthy drives."""
