"""An ODX database of this gateway for testers, in a PDX file (ISO 22901-1, version 2.2)."""
