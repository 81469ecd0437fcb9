"""How good learning is, and how well causes are named."""
