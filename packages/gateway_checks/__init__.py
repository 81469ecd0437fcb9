"""Monitors that know no plant: of single signals, of rules in text, of the clocks of senders."""
