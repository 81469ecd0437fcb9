"""What the commands of the bench do."""
