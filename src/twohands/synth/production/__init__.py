"""Long runs that may be killed at any moment: what is made, and where it is written."""
