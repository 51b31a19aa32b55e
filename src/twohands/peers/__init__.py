"""Other systems on the same pictures, scored by the same rules."""
