"""Work of the commands that ask a car."""
