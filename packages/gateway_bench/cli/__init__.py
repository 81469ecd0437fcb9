"""Work of the bench's commands."""
