"""Logs into Parquet tables, one per message."""
