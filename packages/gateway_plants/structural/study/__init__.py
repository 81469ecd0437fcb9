"""A structural analysis as a whole: every figure of a model, and the pictures of them."""
