"""A workshop's tools for the gateway."""
