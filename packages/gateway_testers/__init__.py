"""Testers of other makes: what they are given, to ask this gateway."""
