"""``gateway evaluate``: the papers' figures and tables, from our own data."""
