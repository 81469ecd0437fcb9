"""What ``gateway learn`` claims of a virtual car whose truth is known, and what it says of healthy drives."""
