"""Claims of ``gateway learn`` about a virtual car whose truth is known, and its alarms on healthy drives."""
