"""Frames and transport protocol of J1939 (SAE J1939-21), for servers and clients. It knows neither."""
