"""Work of the commands that replay logs."""
