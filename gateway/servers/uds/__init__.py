"""UDS server (ISO 14229-1): a handler for each service, over one fault memory."""
