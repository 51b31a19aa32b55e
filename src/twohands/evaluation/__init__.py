"""How good predictions are: metrics, protocols, the files of predictions, and reports."""
