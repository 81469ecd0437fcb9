"""The gateway asks: clients of other ECUs, by schedule. They read, and change nothing."""
