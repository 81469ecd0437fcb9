"""From a database and healthy logs to a configuration: what each message and signal does, as limits with their evidence."""
