"""A fleet that is on the road: cars tell events, a collector keeps them, limits of many cars come back."""
