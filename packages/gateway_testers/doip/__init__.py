"""Diagnostics over IP (ISO 13400-2:2019): the gateway as a DoIP entity, without its sockets."""
