"""Who does the work of a long run: this process, several, or a Ray cluster."""
