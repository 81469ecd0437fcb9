"""From a database and healthy logs to a configuration: limits of messages and signals, with their evidence."""
