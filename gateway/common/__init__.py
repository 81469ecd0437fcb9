"""What every room may use: settings files, logging, progress, plug-ins, shipped files. It imports no other room."""
