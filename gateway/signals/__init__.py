"""CAN databases to decode tables, and the kernels that walk them."""
