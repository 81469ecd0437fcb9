"""The interrupt-style loop: vector table, timers, jitted step over a batch of frames, event ring."""
