"""What the commands of many cars do."""
