"""Work on logs that no daemon needs: tables of signals."""
