"""The running daemon: supervised buses in, one gateway, frames out. The only reader of the wall clock."""
