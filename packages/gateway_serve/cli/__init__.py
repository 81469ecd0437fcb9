"""Work of the commands beside a running gateway."""
