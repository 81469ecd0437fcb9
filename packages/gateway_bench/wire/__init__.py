"""From columns of values to what the gateway says of them: frames by a database, and its replay."""
