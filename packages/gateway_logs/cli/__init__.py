"""Work of the commands on logs."""
