"""What is in a dataset: checks, distributions, contact sheets."""
