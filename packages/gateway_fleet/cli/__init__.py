"""Work of the commands of many cars."""
