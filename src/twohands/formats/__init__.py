"""Files that users bring, read strictly; what is accepted is listed in docs/inputs.md."""
