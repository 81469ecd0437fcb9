"""Commands that no running gateway needs: they check files, read a fault memory, look at a machine."""
