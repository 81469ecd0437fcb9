"""Small things that all packages use: errors of input files, logging, progress."""
