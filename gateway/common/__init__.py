"""Tools for every room: settings files, logging, progress, plug-ins, shipped files. It imports no other room."""
