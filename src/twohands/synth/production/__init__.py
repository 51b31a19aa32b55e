"""Long runs that may be killed at any moment: who does the work, and where it is written."""
