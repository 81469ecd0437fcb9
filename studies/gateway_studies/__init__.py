"""How good the methods are: the papers' figures and tables from our own data, beside named peers."""
