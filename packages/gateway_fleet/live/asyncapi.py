"""The channels of a fleet as an AsyncAPI document: what cars send, what they are answered, what their owner sends."""

from __future__ import annotations

from typing import Any

from gateway.faults.fleet import NAME
from gateway.runtime.contract import CONTRACT, schema
from gateway_fleet.live.batch import batch_schema


def document() -> dict[str, Any]:
    """Return the document, AsyncAPI 3.0."""
    compressed = "JSON by bzip2 (it begins with BZh) or zlib (RFC 1950); the schema is of what is in it"
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Events of a fleet",
            "version": f"{CONTRACT}.0.0",
            "description": "Cars tell their collector, by MQTT (QoS 1) or HTTP POST. A batch without an answer is"
            " sent again; events are told apart by their ids.",
        },
        "defaultContentType": "application/json",
        "channels": {
            "events": _channel("fleet/{fleet}/car/{car}/events", "batch", "A car's events."),
            "arrived": _channel("fleet/{fleet}/car/{car}/arrived", "arrived", "All of a batch is on the disk."),
            "campaign": _channel("fleet/{fleet}/campaign/{campaign}", "signed", "A campaign, retained.", "campaign"),
            "keys": _channel("fleet/{fleet}/keys", "signed", "Which keys sign campaigns, retained.", ""),
        },
        "operations": {
            "tell": _operation("send", "events"),
            "answer": _operation("receive", "arrived"),
            "change": _operation("receive", "campaign"),
            "rotate": _operation("receive", "keys"),
        },
        "components": {
            "messages": {
                "batch": {"contentType": "application/octet-stream", "summary": compressed, "payload": batch_schema()},
                "arrived": {
                    "payload": {
                        "type": "object",
                        "required": ["arrived"],
                        "properties": {
                            "arrived": {
                                "type": "string",
                                "description": "first 32 hex digits of the SHA-256 of the batch as it was sent",
                            }
                        },
                    }
                },
                "signed": {
                    "contentType": "application/toml",
                    "summary": "a line of signature, then TOML; docs/fleet.md has its keys",
                    "payload": {"type": "string"},
                },
            },
            "schemas": {"event": schema()},
        },
    }


def _channel(address: str, message: str, about: str, more: str = "car") -> dict[str, Any]:
    names = ["fleet", *([more] if more else [])]
    return {
        "address": address,
        "description": about,
        "parameters": {name: {"description": f"a name by the pattern {NAME}"} for name in names},
        "messages": {message: {"$ref": f"#/components/messages/{message}"}},
    }


def _operation(action: str, channel: str) -> dict[str, Any]:
    return {"action": action, "channel": {"$ref": f"#/channels/{channel}"}}
